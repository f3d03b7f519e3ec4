"""Records to bytes: one writer per format, chosen by the suffix of the report's name."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from importlib import import_module

from msal_cli.errors import UsageError

_WRITERS = {
    ".json": ("data", "render_json"),
    ".jsonl": ("data", "render_lines"),
    ".csv": ("data", "render_csv"),
    ".md": ("markdown", "render"),
    ".xml": ("junit", "render"),
    ".html": ("html", "render"),
}


def writer(name: str, *, has_all_columns: bool = False) -> Callable[..., bytes]:
    """The function of a run and its records that makes the bytes of a report of this name;
    UsageError for another suffix.

    ``has_all_columns`` is for CSV, which else has ``data.COMMON_COLUMNS``.
    """
    suffix = os.path.splitext(name)[1].lower()
    if suffix not in _WRITERS:
        raise UsageError(
            f"unknown report format: {name!r}", hint=f"known are {', '.join(_WRITERS)}"
        )
    module, function = _WRITERS[suffix]
    render: Callable[..., bytes] = getattr(import_module(f"{__name__}.{module}"), function)
    return partial(render, has_all=True) if has_all_columns and suffix == ".csv" else render
