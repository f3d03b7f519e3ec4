"""Regular files, opened for reading without waiting.

Opening a FIFO waits for a writer, reading a terminal waits for a key, and some devices never end.
A folder of scans may hold all of them under the name of a mesh, so every file of the disk whose
name comes from outside is opened here.  Symbolic links are followed; what counts is the file at
their end.
"""

from __future__ import annotations

import errno
import os
import stat
from typing import BinaryIO

_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
)

# Windows would translate line ends and hand the handle down to children.
_FLAGS = os.O_RDONLY
for _name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY", "O_NOINHERIT"):
    _FLAGS |= getattr(os, _name, 0)


class NotRegularError(OSError):
    """What has the name of a file is a pipe, a socket or a device."""


def open_regular(path: str | os.PathLike[str], buffering: int = -1) -> BinaryIO:
    """Open a regular file for reading; ``buffering`` as of ``open``.

    Raises
    ------
    NotRegularError
        for a pipe, a socket or a device, which is not opened.
    OSError
        if the system cannot open it, or it is a folder.
    """
    # Asked before, because opening alone sets some devices in motion, and after, because the name
    # may have got another file in between.
    _require_regular(os.stat(path).st_mode)
    handle = os.open(path, _FLAGS)
    try:
        _require_regular(os.fstat(handle).st_mode)
        return open(handle, "rb", buffering=buffering)
    except BaseException:
        os.close(handle)
        raise


def is_regular(path: str | os.PathLike[str]) -> bool:
    """Whether a name, links followed, is that of a regular file."""
    try:
        return stat.S_ISREG(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


def _require_regular(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        kind = next((word for is_kind, word in _KINDS if is_kind(mode)), "a special file")
        raise NotRegularError(errno.EINVAL, f"it is {kind}, not a regular file")
