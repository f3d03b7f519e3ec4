"""How the C library keeps memory that has been let go of."""

from __future__ import annotations

import functools
import os
import sys

_MMAP_THRESHOLD = -3
_TRIM_THRESHOLD = -1
_ARENA_MAX = -8

LARGE_BYTES = 2 << 20
"""Arrays from this size on go back to the system as soon as they are let go of."""

KEPT_BYTES = 32 << 20
"""Memory of small arrays that is kept for the next ones."""


@functools.cache
def give_back_large_arrays() -> None:
    """Have large arrays in mappings of their own, which end with them; once for a process.

    Of its own accord glibc puts arrays of up to 32 MB among small ones as soon as one such array
    has been let go of; what is let go of later then stays with the process, or keeps others from
    being given back.  Where the C library is another, or the environment says how it shall keep
    memory, nothing is done.
    """
    if not sys.platform.startswith("linux") or any(name in os.environ for name in _OWN_WORDS):
        return
    import ctypes

    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):
        return  # not glibc
    mallopt(_MMAP_THRESHOLD, LARGE_BYTES)
    mallopt(_TRIM_THRESHOLD, KEPT_BYTES)
    # Threads come and go, and each would leave memory of its own behind.
    mallopt(_ARENA_MAX, 1)


_OWN_WORDS = (
    "MALLOC_MMAP_THRESHOLD_",
    "MALLOC_TRIM_THRESHOLD_",
    "MALLOC_ARENA_MAX",
    "GLIBC_TUNABLES",
)
