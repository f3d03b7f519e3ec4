"""The CSV report: one row per file, for spreadsheets.

RFC 4180 in UTF-8 without a byte order mark: commas, line ends CR LF, cells quoted where they need
it, a header row.  Nested fields have dotted names such as ``volume.change_percent``; the columns
are those of ``COMMON``, or all of the record, in its order; these depend on the run only in the
method's parameters and in what was wished of --auto, which are sorted.  What is not known is
empty; several texts in one cell are joined by ``"; "``.  A gate is such a text: ``broken:
abs(volume_change) > 1% (volume_change is -2.1%)``, or ``held: ...``; so is what was nearly chosen,
with its risk: ``AL, 3 sweeps (0.0724)``; and a reading of the noise, with level and probability:
``noise 0.08 (0.6)``.

Text, but never a number, that a spreadsheet would take for a formula (it begins with ``=``, ``+``,
``-``, ``@``, tab, CR or LF) gets an apostrophe in front.  So does text that begins with an
apostrophe: taking one away from every cell that has one gives the text back.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import typing
from collections.abc import Iterator, Sequence
from typing import Any

from msal_cli.job.plain_data import reported_fields
from msal_cli.job.records import MeshRecord
from msal_cli.report.document import Run, plain_record

_TAKEN_FOR_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "'")
_FREE_FORM = ("method.parameters", "choice.wishes")


COMMON = (
    "input",
    "status",
    "output",
    "format",
    "vertices",
    "faces",
    "components",
    "boundary_edges",
    "non_manifold_edges",
    "degenerate_faces",
    "inside_out",
    "mean_edge_length",
    "noise_estimate.mean_edges",
    "noise_estimate.negligible",
    "noise_estimate.unsure",
    "noise_estimate.words",
    "method.name",
    "choice.reason",
    "left_alone",
    "despiked",
    "displacement.mean_edges",
    "displacement.p95_edges",
    "displacement.max_edges",
    "displacement.max",
    "normal_change.mean_deg",
    "flipped_faces",
    "volume.valid",
    "volume.before",
    "volume.after",
    "volume.change_percent",
    "area.change_percent",
    "reference.mean_angular_error_deg",
    "reference.vertex_error_percent",
    "reference.error.message",
    "gates",
    "warnings",
    "warning_codes",
    "seconds.total",
    "error.code",
    "error.message",
    "error.where",
    "error.hint",
)
"""The columns that people sort and filter by."""


def render(run: Run, records: Sequence[MeshRecord], *, has_all: bool = False) -> bytes:
    """The records as CSV, with the columns of ``COMMON`` or with all; see the module's
    description."""
    rows = [dict(_flatten(plain_record(record), "")) for record in records]
    names = tuple(_columns(rows)) if has_all else COMMON
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\r\n")
    writer.writerow(names)
    writer.writerows([_cell(row.get(name)) for name in names] for row in rows)
    return text.getvalue().encode()


def _columns(rows: Sequence[dict[str, Any]]) -> Iterator[str]:
    for name in _field_names(MeshRecord, ""):
        if name in _FREE_FORM:
            yield from sorted({key for row in rows for key in row if key.startswith(f"{name}.")})
        else:
            yield name


def _field_names(kind: type[Any], prefix: str) -> Iterator[str]:
    hints = typing.get_type_hints(kind)
    for one in reported_fields(kind):
        hint = hints[one.name]
        inner = [part for part in typing.get_args(hint) if dataclasses.is_dataclass(part)]
        if inner and typing.get_origin(hint) is not tuple:
            yield from _field_names(typing.cast("type[Any]", inner[0]), f"{prefix}{one.name}.")
        else:
            yield prefix + one.name


def _flatten(data: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


def _text(value: Any) -> str:
    """One of several texts; the only records of which there are several are those of gates, of
    runners-up and of readings of the noise."""
    if not isinstance(value, dict):
        return str(value)
    if "label" in value:
        return f"{value['label']} ({_figure(value['risk_edges'])})"
    if "probability" in value:
        level, probability = _figure(value["level_edges"]), _figure(value["probability"])
        return f"{value['kind']} {level} ({probability})"
    word = "broken" if value["broken"] else "held"
    return f"{word}: {value['expression']} ({value['reason']})"


def _figure(value: float | None) -> str:
    return "?" if value is None else f"{value:.4g}"


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    text = value if isinstance(value, str) else "; ".join(map(_text, value))
    return f"'{text}" if text.startswith(_TAKEN_FOR_FORMULA) else text
