"""The JSON Lines report: one record a line, in the order of the inputs, and nothing else."""

from __future__ import annotations

import json
from collections.abc import Sequence

from msal_cli.job.records import MeshRecord
from msal_cli.report.document import Run, plain_record


def encoded(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The records as UTF-8; each line is a ``MeshRecord`` of the schema ``msal.report/1``.

    Only ASCII is used, because some readers of lines also break at U+2028.
    """
    return b"".join(
        json.dumps(plain_record(record), allow_nan=False, separators=(",", ":")).encode() + b"\n"
        for record in records
    )
