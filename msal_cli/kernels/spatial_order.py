"""Renumbering of meshes in random order, so that neighbours in space are near in memory.

Each access to a neighbour waits for memory, or for a disk if arrays are in files, unless vertices
and faces are ordered along the surface.  In most files they are.  For the others sorting costs less
than one pass of a filter.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges

BLOCK_BYTES = 1 << 27
"""Size of the part of an array that is read in random order in one pass."""

# The order is tested on groups of consecutive faces: along a surface they touch a page or two for
# each row of it, in random order nearly three pages each.
_PLACES, _TOGETHER, _PER_PAGE = 64, 64, 4096 // 24

_CELLS = 1024
_LANES = 64  # points in a row of the array that ``bounds`` reduces
LOW_BITS = np.uint64(0xFFFFFFFF)
"""The bits of a key that are the number of a vertex or a face."""
_HIGH = np.uint64(32)


@compiled
def _spread_bits(x):
    """Ten bits with two zeros before each."""
    x = (x | (x << np.uint64(16))) & np.uint64(0x030000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x0300F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x030C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x09249249)


@compiled
def _key_vertices(start, stop, vertices, low, cells_per_unit, keys):
    """Morton code of the cell of each vertex, and in the low half the number of the vertex."""
    for i in range(start, stop):
        code = np.uint64(0)
        for axis in range(3):
            cell = (vertices[i, axis] - low[axis]) * cells_per_unit
            bits = _spread_bits(np.uint64(min(max(cell, 0.0), 1023.0)))
            code |= bits << np.uint64(axis)
        keys[i] = (code << _HIGH) | np.uint64(i)


@compiled
def _rank(start, stop, keys, first, last, ranks):
    """The ranks of the keys of the vertices from ``first`` to ``last``."""
    for at in range(start, stop):
        i = np.int64(keys[at] & LOW_BITS)
        if first <= i < last:
            ranks[i] = at


@compiled
def _gather(start, stop, rows, order, first, last, ordered):
    """Gather rows by the low halves of ``order``, those from ``first`` to ``last``."""
    for at in range(start, stop):
        i = np.int64(np.uint64(order[at]) & LOW_BITS)
        if first <= i < last:
            for column in range(rows.shape[1]):
                ordered[at, column] = rows[i, column]


def is_random(faces: Ints) -> bool:
    """Whether consecutive faces mostly have vertices far from one another in memory."""
    firsts = np.linspace(0, max(len(faces) - _TOGETHER, 0), _PLACES).astype(np.int64)
    pages = [len(np.unique(faces[at : at + _TOGETHER] // _PER_PAGE)) for at in firsts]
    return float(np.median(pages)) > _TOGETHER


def blocks(count: int, row_bytes: int) -> list[tuple[int, int]]:
    """Ranges of the blocks in which ``count`` rows are read in random order."""
    step = max(BLOCK_BYTES // row_bytes, 1)
    return [(first, min(first + step, count)) for first in range(0, count, step)]


def bounds(points: Floats) -> tuple[Floats, Floats]:
    """Minimum and maximum of each coordinate, (3,) each; NaN and infinities propagate."""
    # numpy is slow to reduce the first axis of an array with short rows, so rows are made longer.
    whole = len(points) // _LANES * _LANES
    rows = points[:whole].reshape(-1, 3 * _LANES)
    ends = []
    for extremum in (np.minimum, np.maximum):
        parts = [points[whole:]]
        if whole:
            parts.append(extremum.reduce(rows, axis=0).reshape(-1, 3))
        ends.append(extremum.reduce(np.concatenate(parts), axis=0))
    return ends[0], ends[1]


def morton_keys(points: Floats) -> NDArray[np.uint64]:
    """Keys (n,): the Morton code of the cell of each point (n, 3), along a curve through their
    bounding box, in the upper 32 bits, and the number of the point below."""
    low, high = bounds(points)
    extent = max(float((high - low).max()), np.finfo(float).tiny * _CELLS)
    keys = np.empty(len(points), dtype=np.uint64)
    over_ranges(_key_vertices, len(points), points, low, _CELLS / extent, keys)
    return keys


def order_in_space(points: Floats) -> Longs:
    """The indices (n,) of points (n, 3) along a Morton curve through their bounding box."""
    keys = morton_keys(points)
    keys.sort()
    return (keys & LOW_BITS).astype(np.int64)


def sort_in_space(vertices: Floats, faces: Ints) -> tuple[Floats, Ints, Ints]:
    """Vertices (n, 3) along a Morton curve through their bounding box, faces (m, 3) by their first
    vertex, and the new number (n,) of each vertex."""
    vertices, faces, ranks = order_vertices(vertices, faces, morton_keys(vertices))
    # The lowest vertex number of each face, and in the low half the number of the face.
    a, b, c = faces.T
    least = np.minimum(np.minimum(a, b), c).astype(np.uint64)
    keys = least << _HIGH | np.arange(len(faces), dtype=np.uint64)
    keys.sort()
    return vertices, gather_rows(faces, keys), ranks


def order_vertices(
    vertices: Floats, faces: Ints, keys: NDArray[np.uint64]
) -> tuple[Floats, Ints, Ints]:
    """Vertices (n, 3) in the order of ``keys`` (n,), whose low halves are the numbers of vertices;
    faces (m, 3) with the new numbers, and the new number (n,) of each vertex.

    ``keys`` are sorted in place.
    """
    n = len(vertices)
    # All keys differ, so the order is unique.
    keys.sort()
    ranks = np.empty(n, dtype=np.int32)
    for block in blocks(n, ranks.itemsize):
        over_ranges(_rank, n, keys, *block, ranks)
    renumbered = gather_rows(ranks[:, None], faces.reshape(-1)).reshape(-1, 3)
    return gather_rows(vertices, keys), renumbered, ranks


def gather_rows(rows: NDArray[Any], order: NDArray[np.uint64] | Ints) -> NDArray[Any]:
    """The rows (n, k) at the indices ``order`` (m,), which are its low halves if it is 64-bit."""
    ordered = np.empty((len(order), rows.shape[1]), dtype=rows.dtype)
    for block in blocks(len(rows), rows.itemsize * rows.shape[1]):
        over_ranges(_gather, len(order), rows, order, *block, ordered)
    return ordered
