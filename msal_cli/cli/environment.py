"""The machine and the libraries that a run has, in words for its reports."""

from __future__ import annotations

import os
import platform


def described() -> dict[str, str]:
    """System, cores and versions by name; nothing that tells who the user or the host is."""
    from importlib import metadata

    from msal_cli.machine import usable_cores

    told = {
        "system": f"{platform.system()} {platform.release()}".strip(),
        "processor": platform.machine(),
        "cores": f"{usable_cores()} of {os.cpu_count() or 1}",
        "python": platform.python_version(),
    }
    for name in ("numpy", "trimesh", "meshio"):
        try:
            told[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return {name: value for name, value in told.items() if value}
