"""Pairs of triangles whose boxes overlap, found by a tree of boxes.

A box has twelve sides more than usual, across the diagonals of the faces of a cube: long triangles
that are not along an axis fill it better.  Boxes are put in an order in which neighbours are near
each other: by size, in classes of eight, so that a few large ones do not widen the nodes of all
small ones, and within a class along a Morton curve.  A binary tree over this order is gone through
level by level, many pairs of nodes at once.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs

Bounds = tuple[Floats, Floats]

AT_ONCE = 1 << 18
"""Pairs that are expanded at a time; it bounds the memory, however many overlap."""

_MORTON_BITS = 20
_SIZES_PER_CLASS = 3  # powers of two


def near_pairs(triangles: Floats) -> Iterator[tuple[Longs, Longs]]:
    """Longs of every two of the ``triangles`` (n, 3, 3) whose boxes have a point in common.

    Yields arrays i, j of the same length, each pair once; which is i, and the order, is the same on
    every run.
    """
    if len(triangles) < 2:
        return
    low, high = _bounds(triangles)
    order = _spatial_order(low[:3], high[:3])
    levels = _levels(low[:, order], high[:, order])
    for level in range(1, len(levels)):
        left = np.arange(0, levels[level][0].shape[1], 2, dtype=np.int64)
        siblings = _overlapping(levels[level], left, left + 1)
        for i, j in _leaf_pairs(levels, level, *siblings):
            yield order[i], order[j]


def _bounds(triangles: Floats) -> Bounds:
    """Least and greatest place along nine directions, (9, n) each.

    A sum of two coordinates is rounded, but never past the rounded sum of others, so that boxes
    with a point in common overlap.
    """
    x, y, z = triangles.transpose(2, 1, 0)
    low, high = np.empty((9, len(triangles))), np.empty((9, len(triangles)))
    for k, along in enumerate((x, y, z, x + y, x - y, y + z, y - z, z + x, z - x)):
        low[k], high[k] = along.min(axis=0), along.max(axis=0)
    return low, high


def _spatial_order(low: Floats, high: Floats) -> Longs:
    centres = 0.5 * low + 0.5 * high
    least = centres.min(axis=1, keepdims=True)
    extent = float(np.ptp(centres, axis=1).max())
    cells = ((centres - least) / (extent or 1.0) * (2**_MORTON_BITS - 1)).astype(np.uint64)
    code = np.zeros(cells.shape[1], dtype=np.uint64)
    for axis in range(3):
        code |= _spread(cells[axis]) << np.uint64(axis)
    # Of a box without any extent the exponent is 0, which puts it with those of size 1.
    sizes = np.frexp((high - low).max(axis=0))[1] // _SIZES_PER_CLASS
    return np.lexsort((code, -sizes))


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Each of the lowest 21 bits at three times its place."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        bits = (bits | bits << np.uint64(shift)) & np.uint64(mask)
    return bits


def _levels(low: Floats, high: Floats) -> list[Bounds]:
    """Bounds (9, nodes) of all nodes by level, the root first; nodes beyond the last box are empty
    and overlap nothing."""
    n_axes, n = low.shape
    size = 1 << (n - 1).bit_length()
    lows, highs = np.full((n_axes, size), np.inf), np.full((n_axes, size), -np.inf)
    lows[:, :n], highs[:, :n] = low, high
    levels = [(lows, highs)]
    while size > 1:
        size //= 2
        lows = lows.reshape(n_axes, size, 2).min(axis=2)
        highs = highs.reshape(n_axes, size, 2).max(axis=2)
        levels.append((lows, highs))
    return levels[::-1]


def _leaf_pairs(
    levels: list[Bounds], level: int, i: Longs, j: Longs
) -> Iterator[tuple[Longs, Longs]]:
    """The pairs of overlapping boxes below pairs of nodes i, j of a level."""
    for start in range(0, len(i), AT_ONCE):
        first, second = i[start : start + AT_ONCE], j[start : start + AT_ONCE]
        if level == len(levels) - 1:
            yield first, second
            continue
        children = [(2 * first + a, 2 * second + b) for a in (0, 1) for b in (0, 1)]
        below = _overlapping(
            levels[level + 1],
            np.concatenate([one for one, _ in children]),
            np.concatenate([one for _, one in children]),
        )
        yield from _leaf_pairs(levels, level + 1, *below)


def _overlapping(bounds: Bounds, i: Longs, j: Longs) -> tuple[Longs, Longs]:
    """Of pairs of nodes those that overlap."""
    for low, high in zip(*bounds, strict=True):
        keep = (low[i] <= high[j]) & (low[j] <= high[i])
        i, j = i[keep], j[keep]
    return i, j
