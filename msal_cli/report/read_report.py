"""Reports read back: .json and .jsonl, as ``json_report`` wrote them."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

from msal_cli.errors import FormatError
from msal_cli.job.display_names import restore_name
from msal_cli.job.plain_data import from_data
from msal_cli.job.records import SCHEMA, MeshRecord
from msal_cli.report.document import Run

Refusal = Callable[..., FormatError]
"""Makes an error of a file's name, a reason, and a place in the file."""


def document(data: bytes, name: str) -> tuple[Run, list[MeshRecord]]:
    """The run and the records of a JSON report; ``name`` is for errors.

    Raises
    ------
    FormatError
        if it is no report of this schema.
    """
    content = parse_json(data, name, not_a_report)
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise not_a_report(name, f"it does not say that its schema is {SCHEMA}")
    run: Run = read_record(Run, content, name, "", not_a_report)
    records = content.get("records")
    if not isinstance(records, list):
        raise not_a_report(name, "it has no list of records")
    return run, [_read_mesh_record(one, name, f"record {at}") for at, one in enumerate(records, 1)]


def lines(data: bytes, name: str) -> list[MeshRecord]:
    """The records of a JSON Lines report; the errors are those of ``document``."""
    return [
        _read_mesh_record(parse_json(line, name, not_a_report, where), name, where)
        for where, line in ((f"line {at}", one) for at, one in enumerate(data.split(b"\n"), 1))
        if line.strip()
    ]


def parse_json(data: bytes, name: str, refuse: Refusal, where: str = "") -> Any:
    """JSON, with the bytes in names that JSON cannot hold; ``refuse`` makes the error."""
    try:
        return _restore_names(json.loads(data))
    except (ValueError, RecursionError) as error:
        reason = "it is nested too deep" if isinstance(error, RecursionError) else str(error)
        raise refuse(name, f"it is not JSON: {reason}", where) from None


def read_record(kind: type[Any], data: Any, name: str, where: str, refuse: Refusal) -> Any:
    """A record of one kind; ``refuse`` makes the error."""
    try:
        return from_data(kind, data)
    except TypeError as error:
        raise refuse(name, str(error), where) from None


def _read_mesh_record(data: Any, name: str, where: str) -> MeshRecord:
    record: MeshRecord = read_record(MeshRecord, data, name, where, not_a_report)
    if record.schema != SCHEMA or (record.status == "failed") != (record.error is not None):
        raise not_a_report(name, "it is no record of what became of a file", where)
    return record


def _restore_names(value: Any) -> Any:
    if isinstance(value, str):
        return restore_name(value)
    if isinstance(value, list):
        return [_restore_names(one) for one in value]
    if isinstance(value, dict):
        return {restore_name(key): _restore_names(one) for key, one in value.items()}
    return value


def not_a_report(name: str, reason: str, where: str = "") -> FormatError:
    """The error for what is no report."""
    return FormatError(
        f"this is no report of msal denoise: {reason}",
        where=where,
        hint="name an output folder, a manifest in it, or a report in .json or .jsonl",
        path=name,
    )
