"""The JSON report: one document (schema ``msal.report/1``) with the run, totals and records."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from msal_cli.records import MeshRecord
from msal_cli.report.document import Run, document


def encoded(run: Run, records: Sequence[MeshRecord]) -> bytes:
    """The report as UTF-8.

    The order of keys is fixed; numbers that are not finite are null; names that are not valid
    Unicode are written as ``names.portable`` says.
    """
    return json_bytes(document(run, records))


def json_bytes(data: Any) -> bytes:
    """Plain data as strict, indented JSON in UTF-8, with a line end."""
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, indent=2)
    return text.encode() + b"\n"
