"""Comparisons read back, from what ``msal compare --json`` or a report of ``msal denoise`` says."""

from __future__ import annotations

from msal_cli.errors import FormatError
from msal_cli.job.comparison_record import ComparisonRecord
from msal_cli.job.records import SCHEMA, Reference
from msal_cli.report import read_report as reading


def comparisons(data: bytes, name: str) -> dict[str, ComparisonRecord | Reference]:
    """What was measured, by the path of the mesh that was measured; failures are left out.

    Of a report of ``msal denoise`` that is what ``--reference`` gave.

    Raises
    ------
    FormatError
        if it is neither; ``name`` is for the error.
    """
    content = reading.parse_json(data, name, _not_a_comparison)
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema == SCHEMA:
        return _references(data, name)
    if schema != ComparisonRecord.schema:
        wanted = ComparisonRecord.schema
        raise _not_a_comparison(name, f"it does not say that its schema is {wanted}")
    records = content.get("records", [content])
    if not isinstance(records, list):
        raise _not_a_comparison(name, "it has no list of records")
    found: dict[str, ComparisonRecord | Reference] = {}
    for at, one in enumerate(records, 1):
        where = f"record {at}"
        record = reading.read_record(ComparisonRecord, one, name, where, _not_a_comparison)
        if record.error is None:
            found[record.after] = record
    return found


def _references(data: bytes, name: str) -> dict[str, ComparisonRecord | Reference]:
    found: dict[str, ComparisonRecord | Reference] = {}
    for record in reading.document(data, name)[1]:
        reference = record.reference
        if record.output is not None and reference is not None and reference.error is None:
            found[record.output] = reference
    if not found:
        raise _not_a_comparison(name, "no file in it was measured against a reference")
    return found


def _not_a_comparison(name: str, reason: str, where: str = "") -> FormatError:
    return FormatError(
        f"this is no baseline: {reason}",
        where=where,
        hint="keep what msal compare --json prints, or a report of msal denoise --reference",
        path=name,
    )
