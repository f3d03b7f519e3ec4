"""Reports read back: .json and .jsonl, as ``as_json`` and ``as_jsonl`` wrote them."""

from __future__ import annotations

import json
from typing import Any

from msal_cli.errors import FormatError
from msal_cli.job.display_names import restored
from msal_cli.job.plain_data import from_data
from msal_cli.job.records import SCHEMA, MeshRecord
from msal_cli.report.document import Run


def document(data: bytes, name: str) -> tuple[Run, list[MeshRecord]]:
    """The run and the records of a JSON report; ``name`` is for errors.

    Raises
    ------
    FormatError
        if it is no report of this schema.
    """
    content = _parsed(data, name, "")
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise _not_a_report(name, f"it does not say that its schema is {SCHEMA}")
    try:
        run: Run = from_data(Run, content)
    except TypeError as error:
        raise _not_a_report(name, str(error)) from None
    records = content.get("records")
    if not isinstance(records, list):
        raise _not_a_report(name, "it has no list of records")
    return run, [_record(one, name, f"record {at}") for at, one in enumerate(records, 1)]


def lines(data: bytes, name: str) -> list[MeshRecord]:
    """The records of a JSON Lines report; the errors are those of ``document``."""
    return [
        _record(_parsed(line, name, f"line {at}"), name, f"line {at}")
        for at, line in enumerate(data.split(b"\n"), 1)
        if line.strip()
    ]


def _parsed(data: bytes, name: str, where: str) -> Any:
    try:
        return restored_names(json.loads(data))
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
        raise _not_a_report(name, f"it is not JSON: {reason}", where) from None


def _record(data: Any, name: str, where: str) -> MeshRecord:
    try:
        record: MeshRecord = from_data(MeshRecord, data)
    except TypeError as error:
        raise _not_a_report(name, str(error), where) from None
    if record.schema != SCHEMA or (record.status == "failed") != (record.error is not None):
        raise _not_a_report(name, "it is no record of what became of a file", where)
    return record


def restored_names(value: Any) -> Any:
    """Names with the bytes that JSON could not hold."""
    if isinstance(value, str):
        return restored(value)
    if isinstance(value, list):
        return [restored_names(one) for one in value]
    if isinstance(value, dict):
        return {restored(key): restored_names(one) for key, one in value.items()}
    return value


def _not_a_report(name: str, reason: str, where: str = "") -> FormatError:
    return FormatError(
        f"this is no report of msal denoise: {reason}",
        where=where,
        hint="name an output folder, a manifest in it, or a report in .json or .jsonl",
        path=name,
    )
