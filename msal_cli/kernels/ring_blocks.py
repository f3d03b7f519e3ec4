"""Blocks of vertices whose one-rings are turned: lanes are vertices, rows are neighbours.

A loop over the five to seven neighbours of one vertex is too short for vector code.  So a sweep
takes vertices by blocks that stay in the first-level cache, and groups those of a block by their
number of neighbours m.  A group has a lane for every vertex, filled up to whole vectors, and what
belongs to the k-th neighbour of all its lanes is side by side: a row as wide as the group.
Then every loop over lanes is vector code, and every sum over neighbours still runs from the first
to the last, so that no bit depends on the block, the lane or the thread that a vertex falls to.

All counts and indices here are uint64, which need no look at their sign: an index that might count
from the end would keep loops from becoming vector code.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled

ZERO, ONE, TWO, THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)

BLOCK = np.uint64(256)
"""Vertices in a block at most: with 6 neighbours each their heights take 12 KiB."""

BLOCK_EDGES = np.uint64(2048)
"""Edges in a block at most, but for a single vertex that has more."""

VECTOR = np.uint64(8)
"""Lanes come in multiples of this: the numbers in a vector of 512 bits."""

LANES = np.uint64(2048)
"""Lanes of a block at most: every vertex may be alone in its group."""

PARTS = (np.uint64(0), LANES, TWO * LANES, THREE * LANES, TWO * TWO * LANES)
"""Where the scratch memory of a kernel has sigma, sum(g h) and sum(g) by lane, and two more."""

ROWS = (TWO + THREE) * LANES
"""Where the rows begin in it."""

_FILL, _SHIFT = np.uint64(7), np.uint64(3)


@compiled
def most_neighbours(start, stop, ring_start):
    """The largest number of neighbours in a range of vertices; ``ring_start`` as uint32."""
    widest = ZERO
    for i in range(np.uint64(start), np.uint64(stop)):
        widest = max(widest, ring_start[i + ONE] - ring_start[i])
    return widest


@compiled
def longest_row(start, stop, row_start):
    """The same for rows whose starts are signed."""
    longest = 0
    for i in range(start, stop):
        longest = max(longest, row_start[i + 1] - row_start[i])
    return longest


@compiled
def block(first, stop, ring_start, widest, origin, table):
    """Lay out the block that starts at vertex ``first``: (last + 1, fewest and most neighbours).

    ``table`` gets, for every m in use, the width of its group at m, the group's first lane at
    widest + 1 + m, and at 2 (widest + 1) + m what to add to a lane for its place in the first row,
    where rows begin at ``origin``.
    """
    edges = max(BLOCK_EDGES, widest)
    last = min(first + BLOCK, np.uint64(stop))
    while ring_start[last] - ring_start[first] > edges:
        last -= ONE
    fewest, most = widest, ZERO
    for i in range(first, last):
        m = ring_start[i + ONE] - ring_start[i]
        fewest = min(fewest, m)
        most = max(most, m)
    for m in range(fewest, most + ONE):
        table[m] = ZERO
    if fewest == most:
        table[most] = last - first
    else:
        for i in range(first, last):
            table[np.uint64(ring_start[i + ONE] - ring_start[i])] += ONE
    lane = ZERO
    place = origin
    lanes, shifts = widest + ONE, TWO * (widest + ONE)
    for m in range(fewest, most + ONE):
        width = (table[m] + _FILL) >> _SHIFT << _SHIFT
        table[m] = width
        table[lanes + m] = lane
        table[shifts + m] = place - lane
        lane += width
        place += width * m
    return last, fewest, most
