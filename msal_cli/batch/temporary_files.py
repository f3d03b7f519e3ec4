"""Temporary files: who owns them, and the removal of those that dead processes left.

Every temporary file of msal is named ``.<anything>.msal-<process>-<machine><random>.tmp``, machine
and random part being eight hexadecimal digits each.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from msal_cli.batch.process_status import is_alive, start_time
from msal_cli.storage.atomic import machine_tag

_OWN_FILES = ".msal-"
_TEMPORARY = re.compile(
    r"\..*\.msal-(?P<pid>\d{1,10})-(?P<machine>[0-9a-f]{8})[0-9a-f]{8}\.tmp", re.DOTALL
)

# A process id may have been given to another process meanwhile, and the processes of other machines
# are not known here; but nothing is written for so long without the file's time changing.
_SURELY_STALE_S = 24 * 3600.0

# A process that began so much later than a file cannot have made it; clocks are set by less.
_SURELY_LATER_S = 60.0


def is_own(name: str) -> bool:
    """Whether a file of this name is msal's own (manifest, lock, temporary), never an input."""
    return name.startswith(_OWN_FILES) or _TEMPORARY.fullmatch(name) is not None


def sweep(folders: Iterable[str | Path]) -> int:
    """Remove what dead processes left in these folders (not below them); how many files."""

    def is_stale(match: re.Match[str], path: Path) -> bool:
        written = path.lstat().st_mtime
        is_ours = match["machine"] == machine_tag()
        is_dead = is_ours and not _may_be_writing(int(match["pid"]), written)
        return is_dead or time.time() - written > _SURELY_STALE_S

    return sum(_remove_matching(Path(folder), is_stale) for folder in folders)


def sweep_after(pid: int, folder: str | Path) -> int:
    """Remove what process ``pid``, which has ended, left in a folder; how many files."""

    def is_its(match: re.Match[str], path: Path) -> bool:
        return match["machine"] == machine_tag() and int(match["pid"]) == pid

    return _remove_matching(Path(folder), is_its)


def _may_be_writing(pid: int, written: float) -> bool:
    """Whether process ``pid`` lives and is old enough to have changed a file at that time."""
    if not is_alive(pid):
        return False
    began = start_time(pid)
    return began is None or began < written + _SURELY_LATER_S


def _remove_matching(folder: Path, is_to_go: Callable[[re.Match[str], Path], bool]) -> int:
    count = 0
    try:
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries if entry.name.startswith(".")]
    except OSError:
        return 0
    for name in names:
        match = _TEMPORARY.fullmatch(name)
        if match is None:
            continue
        path = folder / name
        try:
            if is_to_go(match, path):
                path.unlink()
                count += 1
        except OSError:
            # Another process was faster, or the file is locked; it does no harm.
            continue
    return count
