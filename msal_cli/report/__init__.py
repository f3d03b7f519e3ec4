"""Records to bytes: one writer per format, chosen by the suffix of the report's name."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

from msal_cli.errors import UsageError

if TYPE_CHECKING:
    from msal_cli.job.records import MeshRecord
    from msal_cli.report.document import Run

    Writer = Callable[[Run, Sequence[MeshRecord]], bytes]

_MODULES = {
    ".json": "json_report",
    ".jsonl": "json_report",
    ".csv": "csv_report",
    ".md": "markdown",
    ".xml": "junit",
    ".html": "html",
}


def suffixes() -> tuple[str, ...]:
    """The suffixes of reports that can be written."""
    return tuple(_MODULES)


def writer(name: str, *, has_all_columns: bool = False) -> Writer:
    """The function that makes the bytes of a report of this name.

    ``has_all_columns`` is for CSV, which else has those of ``csv_report.COMMON``.

    Raises
    ------
    UsageError
        if the suffix is none of ``suffixes``.
    """
    suffix = os.path.splitext(name)[1].lower()
    if suffix not in _MODULES:
        raise UsageError(
            f"the suffix of the report {name!r} says no known format",
            hint=f"known are {', '.join(_MODULES)}",
        )
    module = import_module(f"{__name__}.{_MODULES[suffix]}")
    if suffix == ".csv":
        return partial(module.render, has_all=has_all_columns)
    made: Writer = module.render_lines if suffix == ".jsonl" else module.render
    return made
