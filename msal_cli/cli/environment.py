"""When a command runs and on what: its times, the machine and the libraries, for reports."""

from __future__ import annotations

import os
import platform
import time
from datetime import UTC, datetime


class Clock:
    """Started when it is made; ``started`` is UTC, ISO 8601, to the millisecond."""

    def __init__(self) -> None:
        self.started = self.now()
        self._start = time.perf_counter()

    @staticmethod
    def now() -> str:
        """The time in the form of ``started``."""
        return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")

    def seconds(self) -> float:
        """Wall-clock seconds since the start, by a monotonic clock."""
        return time.perf_counter() - self._start


def describe_machine() -> dict[str, str]:
    """System, cores and versions by name; nothing that identifies the user or the host."""
    from importlib import metadata

    from msal_cli.machine import usable_cores

    facts = {
        "system": f"{platform.system()} {platform.release()}".strip(),
        "processor": platform.machine(),
        "cores": f"{usable_cores()} of {os.cpu_count() or 1}",
        "python": platform.python_version(),
    }
    for name in ("numpy", "trimesh", "meshio"):
        try:
            facts[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {name: value for name, value in facts.items() if value}
