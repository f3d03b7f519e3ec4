"""The machine and the versions that a benchmark's figures belong to.

    python -m benchmarks.machine

Figures without these are worth little, so every benchmark prints ``line()`` above its table.
"""

from __future__ import annotations

import importlib.metadata
import os
import platform
import subprocess
import sys
from pathlib import Path

from msal_cli.version import __version__

# What takes part in the work of the command itself.
_PACKAGES = ("numpy",)


def processor() -> str:
    """The processor as it names itself, with family and model where the name says too little."""
    if sys.platform == "darwin":
        completed = subprocess.run(
            ["sysctl", "-n", "machdep.cpu.brand_string"],
            capture_output=True,
            text=True,
            check=False,
        )
        return completed.stdout.strip() or platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").split("\n\n")[0].splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    split = (line.partition(":")[::2] for line in lines)
    known = {key.strip(): value.strip() for key, value in split}
    name = known.get("model name", "") or platform.processor() or platform.machine()
    if "cpu family" in known and "model" in known:
        name += f" (family {known['cpu family']}, model {known['model']})"
    return name


def n_cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def memory_bytes() -> int:
    """Memory of the machine; 0 where the system does not tell."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 0


def system() -> str:
    """The system with its release, and the distribution where there is one."""
    name = f"{platform.system()} {platform.release()}"
    try:
        return f"{name} ({platform.freedesktop_os_release()['PRETTY_NAME']})"
    except (OSError, KeyError):
        return name


def version(package: str) -> str:
    """The version of an installed package, or "none"."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def load() -> float:
    """Processes that ran or waited to run in the last minute; far above 0 the figures are noise."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0


def line() -> str:
    """One line of Markdown: processor, cores, memory, system, versions and the load before."""
    packages = ", ".join(f"{package} {version(package)}" for package in _PACKAGES)
    n = n_cores()
    return (
        f"{processor()}, {n} core{'s' if n != 1 else ''}, {memory_bytes() / 2**30:.0f} GiB; "
        f"{system()}; Python {platform.python_version()}, {packages}, msal {__version__}; "
        f"load {load():.1f} at the start."
    )


if __name__ == "__main__":
    print(line())
