"""The JSON report: one document (schema ``msal.report/1``) with the run, totals and records; and
the JSON Lines report, one record a line in the order of the inputs, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from msal_cli.job.records import MeshRecord
from msal_cli.report.document import Run, heading, plain_record


def render(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The report as UTF-8.

    The order of keys is fixed; numbers that are not finite are null; names that are not valid
    Unicode are written as ``display_names.portable`` says.
    """
    # Record by record: the plain data of ten thousand would take several times the text's memory.
    empty = json_bytes({**heading(run, records), "records": []})
    if not records:
        return empty
    end = b"[]\n}\n"
    inner = b",\n    ".join(
        _text(plain_record(record)).replace("\n", "\n    ").encode() for record in records
    )
    return empty.removesuffix(end) + b"[\n    " + inner + b"\n  ]\n}\n"


def render_lines(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The records as UTF-8; each line is a ``MeshRecord`` of the schema ``msal.report/1``.

    Only ASCII is used, because some readers of lines also break at U+2028.
    """
    return b"".join(
        json.dumps(plain_record(record), allow_nan=False, separators=(",", ":")).encode() + b"\n"
        for record in records
    )


def json_bytes(data: Any) -> bytes:
    """Plain data as strict, indented JSON in UTF-8, with a line end."""
    return _text(data).encode() + b"\n"


def _text(data: Any) -> str:
    # No line break of a string is among these: it is escaped.
    return json.dumps(data, ensure_ascii=False, allow_nan=False, indent=2)
