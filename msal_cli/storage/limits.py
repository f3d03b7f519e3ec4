"""How much of a file may be kept in memory, and from what size on it is read in another way."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from msal_cli.errors import TooLargeError

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
