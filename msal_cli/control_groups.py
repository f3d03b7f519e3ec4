"""The control groups (containers, slices, jobs of a scheduler) that this process belongs to."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

GROUPS = Path("/sys/fs/cgroup")
MEMBERSHIP = Path("/proc/self/cgroup")


def folders(
    controller: str, groups: Path = GROUPS, membership: Path = MEMBERSHIP
) -> Iterator[Path]:
    """The folders of the groups that ``controller`` (``"cpu"``, ``"memory"``) holds this process
    to, innermost first; both versions of control groups, and nothing where there are none."""
    try:
        lines = membership.read_text(errors="replace").splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = (line.split(":", 2) + ["", ""])[:3]
        base = groups if not controllers else groups / controllers
        if controllers and controller not in controllers.split(","):
            continue
        inner = base / path.lstrip("/")
        # A container often sees its own group at the top although it is told the host's path.
        for folder in [inner, *inner.parents]:
            if not folder.is_relative_to(base):
                break
            yield folder
