"""Folders and files that only the user and root can have written, for code that is to be run.

As ssh's StrictModes: a folder, every folder above it, and each file must belong to the user or to
root, and neither the group nor others may write it.  A folder in which only owners may remove
names (the sticky bit, as ``/tmp`` has) counts as safe for what lies in it, but not by itself.
Where the system has no owners, on Windows, everything is trusted that can be opened.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable
from pathlib import Path

_FOR_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_HAS_OWNERS = hasattr(os, "geteuid")


def only_trusted(folders: Iterable[Path], refusals: list[str]) -> list[Path]:
    """The real paths of those folders that are trusted, or could be made in trusted ones.

    For every other folder ``refusals`` gets a reason, which names what is at fault.
    """
    kept = []
    for folder in folders:
        try:
            place = folder.resolve()
            reason = _objection(place)
        except (OSError, RuntimeError, ValueError):
            continue
        if reason:
            refusals.append(reason)
        else:
            kept.append(place)
    return kept


def make_folder(folder: Path) -> None:
    """Make a folder, and those above it that are missing, which others cannot write."""
    missing = []
    while not folder.is_dir():
        missing.append(folder)
        folder = folder.parent
    for one in reversed(missing):
        one.mkdir(mode=0o755, exist_ok=True)


def open_file(path: Path, flags: int) -> int:
    """A handle of a regular file that is trusted; what ``flags`` create others cannot write.

    Raises
    ------
    PermissionError
        if it is a pipe or a device, belongs to another user, or others may write it.
    OSError
        if it cannot be opened, or is a link.
    """
    for name in ("O_NONBLOCK", "O_NOFOLLOW", "O_CLOEXEC", "O_BINARY", "O_NOINHERIT"):
        flags |= getattr(os, name, 0)
    handle = os.open(path, flags, 0o644)
    try:
        status = os.fstat(handle)
        if flags & os.O_CREAT and _HAS_OWNERS and status.st_uid == os.geteuid():
            # As made under an open umask, by an earlier version.
            os.fchmod(handle, stat.S_IMODE(status.st_mode) & ~_FOR_OTHERS)
            status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode) or _is_others(status):
            raise PermissionError(errno.EPERM, "others may write it", str(path))
    except BaseException:
        os.close(handle)
        raise
    return handle


def _objection(place: Path) -> str:
    """Why a folder, by its real path, is not trusted; empty if it is."""
    if not _HAS_OWNERS:
        return ""
    for one in (place, *place.parents):
        try:
            status = os.lstat(one)
        except FileNotFoundError:
            continue
        if not stat.S_ISDIR(status.st_mode):
            return ""  # nothing can be kept there, which is found out soon enough
        if not _is_ours(status):
            return f"the folder {str(one)!r} belongs to another user"
        is_sticky = bool(status.st_mode & stat.S_ISVTX) and one != place
        if status.st_mode & _FOR_OTHERS and not is_sticky:
            return f"others may write the folder {str(one)!r}"
    return ""


def _is_ours(status: os.stat_result) -> bool:
    return not _HAS_OWNERS or status.st_uid in (0, os.geteuid())


def _is_others(status: os.stat_result) -> bool:
    if not _HAS_OWNERS:
        return False
    return not _is_ours(status) or bool(status.st_mode & _FOR_OTHERS)
