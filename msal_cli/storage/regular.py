"""Regular files, opened for reading without waiting, and how much of one may be in memory.

Opening a FIFO waits for a writer, reading a terminal waits for a key, and some devices never end.
A folder of scans may hold all of them under the name of a mesh, so every file of the disk whose
name comes from outside is opened here.  Symbolic links are followed; what counts is the file at
their end.
"""

import errno
import os
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

from msal_cli.errors import TooLargeError

_KINDS = (
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a character device"),
    (stat.S_ISBLK, "a block device"),
)

# Windows would translate line ends and hand the handle down to children.
_FLAGS = 0
for _name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY", "O_NOINHERIT"):
    _FLAGS |= getattr(os, _name, 0)


class NotRegularError(OSError):
    """What has the name of a file is a pipe, a socket or a device."""


def open_regular(path: str | os.PathLike[str], buffering: int = -1) -> BinaryIO:
    """Open a regular file for reading; ``buffering`` as of ``open``.

    Raises NotRegularError for a pipe, a socket or a device, which is not opened; OSError if the
    system cannot open it, or it is a folder.
    """
    # Asked before, because opening alone sets some devices in motion, and after, because the name
    # may have got another file in between.
    _require_regular(os.stat(path).st_mode)
    return open(_open(path, os.O_RDONLY), "rb", buffering=buffering)


def open_own(path: str | os.PathLike[str], flags: int = 0) -> int:
    """The handle of a file of msal's own, to read and write it; OSError for a link, which may lead
    anywhere, and for what is no regular file."""
    return _open(path, flags | os.O_RDWR | getattr(os, "O_NOFOLLOW", 0))


def _open(path: str | os.PathLike[str], flags: int) -> int:
    handle = os.open(path, flags | _FLAGS, 0o644)
    try:
        _require_regular(os.fstat(handle).st_mode)
    except OSError:
        os.close(handle)
        raise
    return handle


def _require_regular(mode: int) -> None:
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        kind = next((word for is_kind, word in _KINDS if is_kind(mode)), "a special file")
        raise NotRegularError(errno.EINVAL, f"it is {kind}, not a regular file")


LOOKED_AT = 1 << 16
"""Bytes of a file's beginning that show its format and its counts."""

LARGE_BYTES = 4 << 20
"""Bytes from which on the system may give large pages of memory."""


def memory_bytes() -> int:
    """Physical memory of this machine; more than any machine has where it is not known."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 1 << 62


_is_large_allowed = False


@contextmanager
def large_files_allowed() -> Iterator[None]:
    """Have files of any size be read, because large arrays are not kept in memory."""
    global _is_large_allowed
    before, _is_large_allowed = _is_large_allowed, True
    try:
        yield
    finally:
        _is_large_allowed = before


def largest_bytes() -> int:
    """The most bytes that a file may have to be kept in memory: half of the machine's."""
    return sys.maxsize if _is_large_allowed else memory_bytes() // 2


def too_large(size: int) -> TooLargeError:
    """The error for a file of ``size`` bytes that is beyond ``largest_bytes``."""
    return TooLargeError(
        f"the file has {size:,} bytes, and more than {largest_bytes():,} cannot be loaded into the "
        "memory of this machine",
        hint="cut the mesh into parts, or use a machine with more memory",
    )


Buffer = bytes | bytearray | memoryview
