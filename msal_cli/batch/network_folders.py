"""Folders in which the system does not report what other machines change."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

_MOUNTS = "/proc/self/mountinfo"

_NETWORK_TYPES = frozenset(
    (
        "nfs",
        "nfs4",
        "cifs",
        "smb",
        "smb2",
        "smb3",
        "smbfs",
        "ncpfs",
        "afs",
        "ceph",
        "glusterfs",
        "lustre",
        "gpfs",
        "beegfs",
        "orangefs",
        "9p",
        "virtiofs",
        "vboxsf",
        "prl_fs",
        "vmhgfs",
        "fuse",
        "davfs",
        "ocfs2",
        "gfs2",
    )
)
"""Types of file systems, also those of shared folders of virtual machines; beside them ``fuse.*``,
which may be anything."""

# What GetDriveType says of a drive that is on another machine.
_DRIVE_REMOTE = 4


def is_on_network(folder: str) -> bool:
    """Whether a folder must be polled; False where the system does not say what it is."""
    if sys.platform == "win32":
        return _is_remote_drive(os.path.abspath(folder))
    try:
        # Names in it are bytes of any encoding.
        lines = os.fsdecode(Path(_MOUNTS).read_bytes()).split("\n")
    except OSError:
        return False
    file_system = find_type(os.path.realpath(folder), lines)
    return file_system in _NETWORK_TYPES or file_system.startswith("fuse.")


def find_type(path: str, mounts: list[str]) -> str:
    """The type of the file system of a real path, from the lines of ``mountinfo``; "" if none."""
    longest, found = -1, ""
    for line in mounts:
        before, _, after = line.partition(" - ")
        fields = before.split(" ")
        if len(fields) < 5 or not after:
            continue
        point = re.sub(r"\\([0-7]{3})", lambda match: chr(int(match[1], 8)), fields[4])
        is_above = path == point or path.startswith(point.rstrip("/") + "/")
        # Of two mounts at one place the later one hides the other.
        if is_above and len(point) >= longest:
            longest, found = len(point), after.split(" ")[0]
    return found


def _is_remote_drive(path: str) -> bool:
    drive = os.path.splitdrive(path)[0]
    if drive.startswith(("\\\\", "//")):
        return True
    import ctypes

    windll = getattr(ctypes, "windll")  # noqa: B009 - type checkers of other systems lack it
    return bool(windll.kernel32.GetDriveTypeW(drive + "\\") == _DRIVE_REMOTE)
