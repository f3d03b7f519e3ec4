"""How many cores this process may really use."""

from __future__ import annotations

import os
from pathlib import Path

_GROUPS = Path("/sys/fs/cgroup")


def usable_cores() -> int:
    """Cores by affinity and by the quota of the control group (containers), at least 1."""
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    quota = _quota(_GROUPS, Path("/proc/self/cgroup"))
    # A quota of 1.5 cores is used up better by two workers than by one.
    return max(1, cores if quota is None else min(cores, -(-quota // 1000)))


def _quota(groups: Path, membership: Path) -> int | None:
    """The tightest quota of this process's control groups in thousandths of a core, if any."""
    quotas: list[int] = []
    try:
        lines = membership.read_text(errors="replace").splitlines()
    except OSError:
        return None
    for line in lines:
        _, controllers, path = (line.split(":", 2) + ["", ""])[:3]
        base = groups if not controllers else groups / controllers
        if controllers and "cpu" not in controllers.split(","):
            continue
        inner = base / path.lstrip("/")
        # A container often sees its own group at the top although it is told the host's path.
        for folder in [inner, *inner.parents]:
            if not folder.is_relative_to(base):
                break
            quota = _quota_of(folder)
            if quota is not None:
                quotas.append(quota)
    return min(quotas, default=None)


def _quota_of(folder: Path) -> int | None:
    try:
        if (folder / "cpu.max").exists():
            quota, period = (folder / "cpu.max").read_text().split()
        else:
            quota = (folder / "cpu.cfs_quota_us").read_text()
            period = (folder / "cpu.cfs_period_us").read_text()
        microseconds, per = int(quota), int(period)
    except (OSError, ValueError):
        return None
    return 1000 * microseconds // per if microseconds > 0 and per > 0 else None
