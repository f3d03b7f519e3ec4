"""The CSV report: one row per file, for spreadsheets.

RFC 4180 in UTF-8 without a byte order mark: commas, line ends CR LF, cells quoted where they need
it, a header row.  Nested fields have dotted names such as ``volume.change_percent``; the columns
are those of the record, in its order, and depend on the run only in the method's parameters and in
what was wished of --auto, which are sorted.  What is not known is empty; several texts in one cell
are joined by ``"; "``.  A gate is such a text: ``broken: abs(volume_change) > 1% (volume_change is
-2.1%)``, or ``held: ...``; so is what was nearly chosen, with its risk: ``AL, 3 sweeps (0.0724)``.

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

from msal_cli.job.records import MeshRecord
from msal_cli.report.document import Run, plain_record

_TAKEN_FOR_FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n", "'")
_FREE_FORM = ("method.parameters", "choice.wishes")


def render(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The records as CSV; see the module's description."""
    rows = [dict(_flatten(plain_record(record), "")) for record in records]
    names = tuple(_columns(rows))
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
    for one in dataclasses.fields(kind):
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
    """One of several texts; the only records of which there are several are those of gates and of
    runners-up."""
    if not isinstance(value, dict):
        return str(value)
    if "label" in value:
        risk = value["risk_edges"]
        return f"{value['label']} ({'?' if risk is None else f'{risk:.4g}'})"
    word = "broken" if value["broken"] else "held"
    return f"{word}: {value['expression']} ({value['reason']})"


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    text = value if isinstance(value, str) else "; ".join(map(_text, value))
    return f"'{text}" if text.startswith(_TAKEN_FOR_FORMULA) else text
