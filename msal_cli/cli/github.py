"""What GitHub Actions offers to a step: annotations in the log, and a summary of its own."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli.cli import console
from msal_cli.errors import OutputError

if TYPE_CHECKING:
    from msal_cli.job.records import MeshRecord

_SUMMARY = "GITHUB_STEP_SUMMARY"
# A summary of more than 1 MiB is refused as a whole.
_MOST_SUMMARY_BYTES = 1_000_000


def annotate(records: Sequence[MeshRecord]) -> None:
    """Mark the worst files that failed or broke a gate, if this runs in GitHub Actions."""
    if os.environ.get("GITHUB_ACTIONS") != "true":
        return
    from msal_cli.report import github_annotations as as_annotations

    # The runner reads both streams; standard output is for data.
    for command in as_annotations.commands(records, _here()):
        console.say(command)


def is_step_summary(name: str) -> bool:
    """Whether a report of this name is the summary of the step, which has no suffix."""
    summary = os.environ.get(_SUMMARY)
    return bool(summary) and os.path.realpath(name) == os.path.realpath(str(summary))


def room_in_summary(name: str) -> int:
    """Bytes that may be added to the summary of the step."""
    try:
        return max(0, _MOST_SUMMARY_BYTES - Path(name).stat().st_size)
    except OSError:
        return _MOST_SUMMARY_BYTES


def append_to_summary(name: str, data: bytes) -> None:
    """Add to what earlier commands of the step have put there.

    Raises
    ------
    OutputError
        if that cannot be done.
    """
    try:
        with Path(name).open("ab") as file:
            file.write(b"\n" + data if file.tell() else data)
    except OSError as error:
        raise OutputError(
            f"the summary {name!r} cannot be written: {error.strerror}", path=name
        ) from None


def _here() -> str:
    """The current folder as a path from the root of the repository; empty outside of it."""
    root = os.environ.get("GITHUB_WORKSPACE")
    if not root:
        return ""
    try:
        here = os.path.relpath(os.path.realpath("."), os.path.realpath(root)).replace(os.sep, "/")
    except (OSError, ValueError):
        return ""
    return "" if here == "." or here.startswith("..") else here
