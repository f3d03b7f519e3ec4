"""Open regular files for reading without blocking, and limit how much of one is kept in memory.

Opening a FIFO blocks until there is a writer, reading a terminal blocks until a key is pressed, and
some devices never end.  A folder of scans may contain all of these under the names of meshes, so
every local file whose name comes from outside is opened here.  Symbolic links are followed; their
targets must be regular files.
"""

import errno
import os
import stat
import sys
import threading
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

# Windows would translate line ends and let child processes inherit the handle.
_FLAGS = 0
for _name in ("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_BINARY", "O_NOINHERIT"):
    _FLAGS |= getattr(os, _name, 0)


class NotRegularError(OSError):
    """A pipe, a socket or a device has the place of a regular file."""


def open_regular(path: str | os.PathLike[str], buffering: int = -1) -> BinaryIO:
    """Open a regular file for reading; ``buffering`` as of ``open``.

    Raises NotRegularError for a pipe, a socket or a device, which is not opened; OSError if the
    system cannot open it, or it is a folder.
    """
    # Checked before, because opening alone can start a device, and again after, because the name
    # may lead to another file by then.
    _require_regular(os.stat(path).st_mode)
    return open(_open(path, os.O_RDONLY), "rb", buffering=buffering)


def open_own(path: str | os.PathLike[str], flags: int = 0) -> int:
    """Open a file of msal's own to read and write it, and return the handle; OSError for a link,
    which could lead anywhere, and for anything but a regular file."""
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
"""Bytes at the beginning of a file that show its format and its counts."""

LARGE_BYTES = 4 << 20
"""From this size on, the system may give large pages of memory."""


def memory_bytes() -> int:
    """Bytes of physical memory of this machine; if unknown, more than any machine has."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return 1 << 62


_lock, _n_allowing = threading.Lock(), 0


@contextmanager
def large_files_allowed() -> Iterator[None]:
    """Within the block, allow files of any size, because large arrays are not kept in memory."""
    global _n_allowing
    with _lock:
        _n_allowing += 1
    try:
        yield
    finally:
        with _lock:
            _n_allowing -= 1


def largest_bytes() -> int:
    """The largest file that is kept in memory: half of the machine's memory, in bytes."""
    return sys.maxsize if _n_allowing else memory_bytes() // 2


def too_large(size: int) -> TooLargeError:
    """The error for a file of ``size`` bytes, more than ``largest_bytes``."""
    return TooLargeError(
        f"the file has {size:,} bytes, and more than {largest_bytes():,} cannot be loaded into the "
        "memory of this machine",
        hint="cut the mesh into parts, or use a machine with more memory",
    )


Buffer = bytes | bytearray | memoryview
