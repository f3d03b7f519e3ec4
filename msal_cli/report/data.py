"""Reports for programs: records as JSON, JSON Lines and CSV.

JSON is one document (schema ``msal.report/1``) with the run, totals and records; JSON Lines are
the records alone, in the order of the inputs.  Both can be read back.

CSV has one row per file, for spreadsheets: RFC 4180 in UTF-8 without a byte order mark, line ends
CR LF, a header row.  Nested fields have dotted names such as ``volume.change_percent``; unknown
values are empty; several texts in one cell are joined by ``"; "``.  Text that a spreadsheet would
take for a formula (it begins with ``=``, ``+``, ``-``, ``@``, tab, CR or LF) gets an apostrophe in
front, and so does text that begins with an apostrophe: removing one apostrophe from every cell that
begins with one restores the text.
"""

import dataclasses
import functools
import json
import types
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from msal_cli.errors import FormatError
from msal_cli.job.display_names import figure, map_texts, portable, restore_name
from msal_cli.job.records import SCHEMA, MeshRecord, Run, as_data, from_data
from msal_cli.report import facts

REPORT, BASELINE = "report of msal denoise", "baseline"
_HINTS = {
    REPORT: "name an output folder, a manifest in it, or a report in .json or .jsonl",
    BASELINE: "keep what msal compare --json prints, or a report of msal denoise --reference",
}
"""Names for what a file is read as, and hints for a file that is not that."""

_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "'")
_FREE_FORM = ("method.parameters", "choice.wishes")

COMMON_COLUMNS = (
    *("input", "status", "output", "format"),
    *("vertices", "faces", "components", "boundary_edges", "non_manifold_edges"),
    *("degenerate_faces", "inside_out", "mean_edge_length"),
    *("noise_estimate.mean_edges", "noise_estimate.negligible", "noise_estimate.unsure"),
    *("noise_estimate.words", "method.name", "choice.reason", "left_alone", "despiked"),
    *("displacement.mean_edges", "displacement.p95_edges", "displacement.max_edges"),
    *("displacement.max", "normal_change.mean_deg", "flipped_faces"),
    *("volume.valid", "volume.before", "volume.after", "volume.change_percent"),
    *("area.change_percent", "reference.mean_angular_error_deg"),
    *("reference.vertex_error_percent", "reference.error.message"),
    *("gates", "warnings", "warning_codes", "seconds.total"),
    *("error.code", "error.message", "error.where", "error.hint"),
)
"""The columns that people sort and filter by."""


# Plain data


def plain(value: Any) -> Any:
    """A record, or ``value``, as plain data that strict JSON can represent.

    A number that is not finite becomes None, text becomes ``portable``, a tuple a list, and a
    number of another library a number; TypeError for anything else.
    """
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str):
        return portable(value)
    if isinstance(value, float):
        return float(value) if value - value == 0.0 else None
    if isinstance(value, Mapping):
        return {portable(str(key)): plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [plain(inner) for inner in value]
    if dataclasses.is_dataclass(value):
        return plain(as_data(value))
    if hasattr(value, "item"):
        return plain(value.item())
    raise TypeError(f"a report cannot hold {type(value).__name__}")


def setting_texts(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Settings by their dotted names, as text (``true``, ``false``); unset ones are left out."""
    for name, value in flatten(plain(data)):
        if value is not None and value not in ("", []):
            items = value if isinstance(value, list) else [value]
            texts = (item if isinstance(item, str) else json.dumps(item) for item in items)
            yield name, ", ".join(texts)


# JSON and JSON Lines


def render_json(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The report as UTF-8; the order of keys is fixed."""
    # Record by record: the plain data of ten thousand need several times the memory of the text.
    head = {"schema": SCHEMA, **plain(run), "totals": plain(facts.totals(records))}
    empty = json_bytes({**head, "records": []})
    if not records:
        return empty
    end = b"[]\n}\n"
    # Line breaks within strings are escaped, so all line breaks are those of the layout.
    inner = b",\n    ".join(
        json_bytes(plain(record))[:-1].replace(b"\n", b"\n    ") for record in records
    )
    return empty.removesuffix(end) + b"[\n    " + inner + b"\n  ]\n}\n"


def render_lines(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The records, one per line, in ASCII, because some readers also break lines at U+2028."""
    return b"".join(
        json.dumps(plain(record), allow_nan=False, separators=(",", ":")).encode() + b"\n"
        for record in records
    )


def json_bytes(data: Any) -> bytes:
    """Plain data as strict, indented JSON in UTF-8, with a final line end."""
    return json.dumps(data, ensure_ascii=False, allow_nan=False, indent=2).encode() + b"\n"


def read_json(data: bytes, name: str) -> tuple[Run, list[MeshRecord]]:
    """The run and the records of a JSON report; FormatError, with ``name``, if it is not one."""
    content = parse_json(data, name, REPORT)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise not_a(REPORT, name, f"missing or unsupported schema (expected {SCHEMA})")
    run: Run = read_record(Run, content, name, "", REPORT)
    records = content.get("records")
    if not isinstance(records, list):
        raise not_a(REPORT, name, "it has no list of records")
    return run, [_read_mesh_record(row, name, f"record {at}") for at, row in enumerate(records, 1)]


def read_lines(data: bytes, name: str) -> list[MeshRecord]:
    """The records of a JSON Lines report; raises as ``read_json`` does."""
    places = ((f"line {at}", line) for at, line in enumerate(data.split(b"\n"), 1) if line.strip())
    return [
        _read_mesh_record(parse_json(line, name, REPORT, where), name, where)
        for where, line in places
    ]


def parse_json(data: bytes, name: str, what: str, where: str = "") -> Any:
    """Parse JSON, and restore names that are not valid Unicode; FormatError if it is not JSON."""
    try:
        return map_texts(json.loads(data), restore_name)
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
        raise not_a(what, name, f"it is not JSON: {reason}", where) from None


def read_record(kind: type[Any], data: Any, name: str, where: str, what: str) -> Any:
    try:
        return from_data(kind, data)
    except TypeError as error:
        raise not_a(what, name, str(error), where) from None


def _read_mesh_record(data: Any, name: str, where: str) -> MeshRecord:
    record: MeshRecord = read_record(MeshRecord, data, name, where, REPORT)
    if record.schema != SCHEMA or (record.status == "failed") != (record.error is not None):
        raise not_a(REPORT, name, "it is no record of what became of a file", where)
    return record


def not_a(what: str, name: str, reason: str, where: str = "") -> FormatError:
    """The error for a file that is not a ``REPORT`` or ``BASELINE``."""
    return FormatError(f"this is no {what}: {reason}", where=where, hint=_HINTS[what], path=name)


# CSV


def render_csv(run: Run, records: Sequence[MeshRecord], *, has_all: bool = False) -> bytes:
    """The records as CSV, with ``COMMON_COLUMNS`` or with all fields in the order of the record.

    All columns are fixed, except the method's parameters and the wishes of --auto.
    """
    import csv
    import io

    rows = [dict(flatten(plain(record))) for record in records]
    names = list(COMMON_COLUMNS)
    if has_all:
        keys = {key for row in rows for key in row}
        free = {
            name: sorted(key for key in keys if key.startswith(f"{name}.")) for name in _FREE_FORM
        }
        names = [key for name, _ in leaf_fields(MeshRecord) for key in free.get(name, [name])]
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(names)
    writer.writerows([_cell(row.get(name)) for name in names] for row in rows)
    return text.getvalue().encode()


def leaf_fields(kind: type[Any], prefix: str = "") -> Iterator[tuple[str, tuple[Any, ...]]]:
    """The dotted names and types of the fields of a record, including nested records."""
    hints = typing.get_type_hints(kind)
    for item in dataclasses.fields(kind):
        hint, path = hints[item.name], prefix + item.name
        is_union = typing.get_origin(hint) in (typing.Union, types.UnionType)
        parts = typing.get_args(hint) if is_union else (hint,)
        inner = [part for part in parts if dataclasses.is_dataclass(part)]
        if inner:
            yield from leaf_fields(typing.cast("type[Any]", inner[0]), f"{path}.")
        else:
            yield path, parts


def flatten(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """The values in nested data by their dotted names."""
    for key, value in data.items():
        if isinstance(value, dict):
            yield from flatten(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    text = value if isinstance(value, str) else "; ".join(map(_item_text, value))
    return f"'{text}" if text.startswith(_FORMULA_STARTS) else text


def _item_text(value: Any) -> str:
    """The text of one item of a list: ``broken: abs(volume_change) > 1% (volume_change is -2.1%)``,
    ``AL, 3 sweeps (0.0724)`` with its risk, ``noise 0.08 (0.6)`` with level and probability."""
    if not isinstance(value, dict):
        return str(value)
    number = functools.partial(figure, form=".4g", unknown="?")
    if "label" in value:
        return f"{value['label']} ({number(value['risk_edges'])})"
    if "probability" in value:
        level, probability = map(number, (value["level_edges"], value["probability"]))
        return f"{value['kind']} {level} ({probability})"
    word = "broken" if value["broken"] else "held"
    return f"{word}: {value['expression']} ({value['reason']})"
