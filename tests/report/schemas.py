"""The published JSON Schemas; ``test_schema`` shows that they are current."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[2] / "docs"


def report_schema() -> dict[str, Any]:
    return load("report.schema.json")


def info_schema() -> dict[str, Any]:
    return load("info.schema.json")


def compare_schema() -> dict[str, Any]:
    return load("compare.schema.json")


def load(name: str) -> dict[str, Any]:
    schema: dict[str, Any] = json.loads((DOCS / name).read_bytes())
    return schema
