"""Temporary files: who owns them, and the removal of those that dead processes left.

Every temporary file of msal is named ``.<anything>.msal-<process>-<machine><random>.tmp``, machine
and random part being eight hexadecimal digits each.
"""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from msal_cli.job.settings import Task
from msal_cli.storage.atomic import machine_tag
from msal_cli.storage.urls import is_url

_OWN_FILES = ".msal-"
_TEMPORARY = re.compile(
    r"\..*\.msal-(?P<pid>\d{1,10})-(?P<machine>[0-9a-f]{8})[0-9a-f]{8}\.tmp", re.DOTALL
)

# A process id may have been given to another process meanwhile, and the processes of other machines
# are not known here; but nothing is written for so long without the file's time changing.
_STALE_AFTER_S = 24 * 3600.0

# A process that began so much later than a file cannot have made it; clocks are set by less.
_CLOCK_TOLERANCE_S = 60.0


def is_own(name: str) -> bool:
    """Whether a file of this name is msal's own (manifest, lock, temporary), never an input."""
    return name.startswith(_OWN_FILES) or _TEMPORARY.fullmatch(name) is not None


def sweep(folders: Iterable[str | Path]) -> int:
    """Remove what dead processes left in these folders (not below them); how many files."""

    def is_stale(match: re.Match[str], path: Path) -> bool:
        written = path.lstat().st_mtime
        is_ours = match["machine"] == machine_tag()
        is_dead = is_ours and not _may_be_writing(int(match["pid"]), written)
        return is_dead or time.time() - written > _STALE_AFTER_S

    return sum(_remove_matching(Path(folder), is_stale) for folder in folders)


def sweep_after(pid: int, folders: Iterable[str | Path]) -> int:
    """Remove what process ``pid``, which has ended, left in these folders; how many files."""

    def is_its(match: re.Match[str], path: Path) -> bool:
        return match["machine"] == machine_tag() and int(match["pid"]) == pid

    return sum(_remove_matching(Path(folder), is_its) for folder in folders)


def _may_be_writing(pid: int, written: float) -> bool:
    """Whether a process lives and is old enough to have changed a file at that time."""
    if not is_alive(pid):
        return False
    began = start_time(pid)
    return began is None or began < written + _CLOCK_TOLERANCE_S


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


def output_folders(tasks: Iterable[Task]) -> set[Path]:
    """The folders of this machine that tasks write to."""
    return {Path(task.output).parent for task in tasks if not is_url(task.output)}


# Processes


def is_alive(pid: int) -> bool:
    """Whether a process of this machine has this id, be it ours or not.

    One that has ended and waits for its parent to ask how does not count: where the first process
    of a container never asks, it would wait for ever.
    """
    if pid <= 0:
        return False
    if sys.platform == "win32":
        return _is_alive_on_windows(pid)
    if (fields := _linux_status(pid)) is not None:
        return fields[0] not in "ZX"
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def start_time(pid: int) -> float | None:
    """When a process began, in seconds as of ``time.time``; None where that is not known."""
    fields = _linux_status(pid)
    if fields is None or len(fields) < 20:
        return None
    try:
        ran_s = time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / os.sysconf("SC_CLK_TCK")
    except (AttributeError, OSError, ValueError):
        return None
    return time.time() - ran_s


def _linux_status(pid: int) -> list[str] | None:
    """The fields of ``/proc/PID/stat`` from the state on; None if there are none."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(errors="replace")
    except OSError:
        return None
    return text.rpartition(")")[2].split() or None


def _is_alive_on_windows(pid: int) -> bool:
    # os.kill would end the process there, whatever the signal.
    import ctypes

    query_limited_information, still_active = 0x1000, 259
    kernel = ctypes.windll.kernel32  # type: ignore[attr-defined,unused-ignore]
    handle = kernel.OpenProcess(query_limited_information, False, pid)
    if not handle:
        return False
    code = ctypes.c_ulong()
    is_known = kernel.GetExitCodeProcess(handle, ctypes.byref(code))
    kernel.CloseHandle(handle)
    return bool(is_known) and code.value == still_active
