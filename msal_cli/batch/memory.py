"""How much memory this process may still use, and whether the system has killed for want of it."""

from __future__ import annotations

import functools
from pathlib import Path

from msal_cli import control_groups

_PROC = Path("/proc")


def available_bytes(
    proc: Path = _PROC,
    groups: Path = control_groups.GROUPS,
) -> int | None:
    """Memory that may be taken without anything being killed or swapped; None if nobody tells.

    The least of what the machine has left and what every control group leaves.  Cached files
    count as free: the system drops them when memory is asked for.
    """
    told = [_of_machine(proc / "meminfo")]
    told += [
        _of_group(folder)
        for folder in control_groups.folders("memory", groups, proc / "self" / "cgroup")
    ]
    return min((one for one in told if one is not None), default=None)


def oom_kills(proc: Path = _PROC, groups: Path = control_groups.GROUPS) -> int:
    """Processes of this one's groups that the system has killed for want of memory so far.

    Where no group counts them, those of the whole machine; 0 where nobody counts.
    """
    counter = _counter(proc, groups)
    kills = None if counter is None else _entry(counter, "oom_kill")
    return (_entry(proc / "vmstat", "oom_kill") or 0) if kills is None else kills


# It is asked before every file, and looking for it takes longer than reading it.
@functools.cache
def _counter(proc: Path, groups: Path) -> Path | None:
    """The file in which the innermost group that does so counts its kills."""
    for folder in control_groups.folders("memory", groups, proc / "self" / "cgroup"):
        for name in ("memory.events", "memory.oom_control"):
            if _entry(folder / name, "oom_kill") is not None:
                return folder / name
    return None


def _of_machine(meminfo: Path) -> int | None:
    kilobytes = _entry(meminfo, "MemAvailable:")
    return None if kilobytes is None else 1024 * kilobytes


def _of_group(folder: Path) -> int | None:
    for most, used, cached in (
        ("memory.max", "memory.current", "inactive_file"),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"),
    ):
        limit, usage = _number(folder / most), _number(folder / used)
        if limit is not None and usage is not None:
            free = limit - usage + (_entry(folder / "memory.stat", cached) or 0)
            return max(0, min(limit, free))
    return None


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text())
    except (OSError, ValueError):
        # "max" is no limit.
        return None


def _entry(path: Path, name: str) -> int | None:
    """The number behind ``name`` in a file of names and numbers."""
    try:
        lines = path.read_text(errors="replace").splitlines()
    except OSError:
        return None
    for line in lines:
        words = line.split()
        if len(words) >= 2 and words[0] == name and words[1].isdigit():
            return int(words[1])
    return None
