"""How many cores this process may really use."""

from __future__ import annotations

import functools
import os
from pathlib import Path

from msal_cli import control_groups


def usable_cores() -> int:
    """Cores by affinity and by the quota of the control group (containers), at least 1."""
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    else:
        cores = os.cpu_count() or 1
    quota = _quota(control_groups.GROUPS, control_groups.MEMBERSHIP)
    # A quota of 1.5 cores is used up better by two workers than by one.
    return max(1, cores if quota is None else min(cores, -(-quota // 1000)))


# Every large kernel asks for it, and a quota is not changed while a process runs.
@functools.cache
def _quota(groups: Path, membership: Path) -> int | None:
    """The tightest quota of this process's control groups in thousandths of a core, if any."""
    quotas = (_quota_of(folder) for folder in control_groups.folders("cpu", groups, membership))
    return min((one for one in quotas if one is not None), default=None)


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
