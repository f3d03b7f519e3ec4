"""Rows of indices whose lengths are not known before they are found.

To find them twice, once for their lengths, would cost twice the time.  So a kernel writes them into
room for the longest rows, a part of the items after the other, and they are put together then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from msal_cli.arrays import Ints
from msal_cli.kernels.parallel import MARKING_THREADS, over_ranges

PARTS = 8
"""Parts of the items, at most: the rows of one are in memory twice."""

SMALLEST_PART = 1 << 17
"""Items in a part, at least, unless their rows may be very long."""

MOST_ROOM = 1 << 26
"""Indices that there is room for in a part: a limit on memory counts it, even if unused."""


def found_rows(
    kernel: Callable[..., Any], count: int, most: int, *known: object
) -> tuple[Ints, Ints]:
    """Sizes (count,) of the rows of all items, and the rows one behind the other.

    ``kernel(start, stop, first, *known, sizes, found)`` finds the rows of the items from
    ``first + start`` to ``first + stop``, ``most`` indices at most in each.  It writes their
    ``sizes``, and the rows, one behind the other, into ``found`` (uint32) from start * most on, and
    returns the places where they begin and end.
    """
    sizes = np.empty(count, dtype=np.int32)
    part = max(SMALLEST_PART, -(-count // PARTS))
    part = max(1, min(part, MOST_ROOM // max(most, 1)))
    pieces = []
    for first in range(0, count, part):
        items = min(part, count - first)
        # What is not written to takes no memory.
        found = np.empty(items * most, dtype=np.uint32)
        ends = over_ranges(kernel, items, first, *known, sizes, found, most=MARKING_THREADS)
        pieces += [found[start:end] for start, end in ends]
        del found
    if len(pieces) == 1:
        return sizes, pieces[0].view(np.int32).copy()
    filled = sum(map(len, pieces))
    rows = np.empty(filled, dtype=np.int32)
    while pieces:
        # Each part is let go of as soon as it is copied.
        last = pieces.pop().view(np.int32)
        rows[filled - len(last) : filled] = last
        filled -= len(last)
        del last
    return sizes, rows
