"""Cutting a mesh into tiles, one chunk of its vertices or faces at a time.

Vertices get the leaf of a k-d tree that their position falls to, and are sorted by it; faces go to
every tile that owns one of their corners.  Both sorts are by counting, and stable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.parallel import over_ranges

Numbers = NDArray[np.uint32]

RECORD_WORDS = 4
"""Numbers in the record of a face: that of the triangle, and its three vertices."""

_ZERO, _ONE, _TWO, _THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)
_HINTS = 1 << 14


@compiled
def _label(start, stop, positions, split_axis, split_at, labels):
    n_inner = np.uint64(len(split_axis))
    for i in range(np.uint64(start), np.uint64(stop)):
        node = _ZERO
        while node < n_inner:
            is_right = positions[i, split_axis[node]] >= split_at[node]
            node = _TWO * node + (_TWO if is_right else _ONE)
        labels[i] = node - n_inner


def label_positions(
    positions: NDArray[np.floating[Any]], split_axis: NDArray[np.uint64], split_at: Floats
) -> Numbers:
    """The leaf (n,), counted from the left, of the positions (n, 3) in a full k-d tree.

    The tree is a heap: inner node i sends those with ``x[split_axis[i]] < split_at[i]`` to node
    2 i + 1 and others to 2 i + 2.  Minus zero is zero.
    """
    labels = np.empty(len(positions), dtype=np.uint32)
    over_ranges(_label, len(positions), positions, split_axis, split_at, labels)
    return labels


@compiled
def _count(labels, counts):
    for i in range(np.uint64(len(labels))):
        counts[np.uint64(labels[i])] += 1


def count_labels(labels: Numbers, n_labels: int) -> Longs:
    """How many items have each of the labels, (n_labels,)."""
    counts = np.zeros(n_labels, dtype=np.int64)
    _count(labels, counts)
    return counts


@compiled
def _sort(labels, positions, first, shifts, places, numbers, order, ordered):
    for i in range(np.uint64(len(labels))):
        label = np.uint64(labels[i])
        at = np.uint64(places[label])
        places[label] += 1
        numbers[i] = np.uint32(np.int64(at) + shifts[label])
        order[at] = np.uint32(first + i)
        ordered[at, 0] = positions[i, 0]
        ordered[at, 1] = positions[i, 1]
        ordered[at, 2] = positions[i, 2]


def sort_by_label(
    labels: Numbers, positions: NDArray[np.floating[Any]], first: int, counts: Longs, bases: Longs
) -> tuple[Numbers, Numbers, NDArray[np.floating[Any]]]:
    """Sort a chunk of vertices by label, those of one label as they stand.

    Parameters
    ----------
    labels, positions : (n,) and (n, 3).
    first : number of the first vertex of the chunk.
    counts : (k,) how many of the chunk have each label.
    bases : (k,) new number of the first of them; others of the label follow.

    Returns
    -------
    numbers : (n,) new numbers, in the order of the chunk.
    order : (n,) old numbers, sorted by label.
    ordered : (n, 3) positions, sorted by label.
    """
    places = np.cumsum(counts) - counts
    numbers, order = np.empty(len(labels), np.uint32), np.empty(len(labels), np.uint32)
    ordered = np.empty_like(positions)
    shifts = bases - places
    _sort(labels, positions, np.uint64(first), shifts, places, numbers, order, ordered)
    return numbers, order, ordered


@dataclass(frozen=True, eq=False)
class TileRanges:
    """Which tile owns a vertex, where every tile owns a range of numbers.

    Attributes
    ----------
    starts : (k + 1,) uint64, first number of each tile, and the number of vertices.
    hints : (h,) uint32, the tile of every 2 ** ``shift``-th number.
    """

    starts: NDArray[np.uint64]
    hints: Numbers
    shift: np.uint64

    @staticmethod
    def build(starts: list[int]) -> TileRanges:
        """From ``starts`` (k + 1,), ascending; tiles may be empty."""
        ends = np.array(starts, dtype=np.uint64)
        shift = max(0, int(ends[-1]).bit_length() - _HINTS.bit_length() + 1)
        numbers = np.arange(0, max(1, int(ends[-1])), 1 << shift, dtype=np.uint64)
        hints = np.searchsorted(ends[1:-1], numbers, side="right").astype(np.uint32)
        return TileRanges(ends, hints, np.uint64(shift))


@compiled
def _tile_of(number, starts, hints, shift):
    tile = np.uint64(hints[np.uint64(number) >> shift])
    while number >= starts[tile + _ONE]:
        tile += _ONE
    return tile


@compiled
def _renumber(start, stop, triangles, numbers, ids):
    for f in range(np.uint64(start), np.uint64(stop)):
        ids[f, 0] = numbers[np.uint64(triangles[f, 0])]
        ids[f, 1] = numbers[np.uint64(triangles[f, 1])]
        ids[f, 2] = numbers[np.uint64(triangles[f, 2])]


def renumber(triangles: Numbers, numbers: Numbers) -> Numbers:
    """The triangles (m, 3) with ``numbers`` (n,) in place of their corners."""
    ids = np.empty_like(triangles)
    over_ranges(_renumber, len(triangles), triangles, numbers, ids)
    return ids


@compiled
def _count_faces(ids, starts, hints, shift, counts):
    # Most faces lie in one tile, and in that of the face before: its range is kept.
    tile, low, size, here = _ZERO, starts[0], starts[1] - starts[0], 0
    for f in range(np.uint64(len(ids))):
        i, j, k = np.uint64(ids[f, 0]), np.uint64(ids[f, 1]), np.uint64(ids[f, 2])
        if i - low >= size:
            counts[tile] += here
            tile, here = _tile_of(i, starts, hints, shift), 0
            low, size = starts[tile], starts[tile + _ONE] - starts[tile]
        here += 1
        # Below the first is far above the last.
        if j - low < size and k - low < size:
            continue
        b, c = _tile_of(j, starts, hints, shift), _tile_of(k, starts, hints, shift)
        if b != tile:
            counts[b] += 1
        if c != tile and c != b:
            counts[c] += 1
    counts[tile] += here


@compiled
def _write_record(records, place, number, i, j, k):
    at = np.uint64(place)
    records[at, 0] = number
    records[at, 1] = i
    records[at, 2] = j
    records[at, 3] = k


@compiled
def _group_faces(ids, first, starts, hints, shift, places, records):
    tile, low, size, here = _ZERO, starts[0], starts[1] - starts[0], places[0]
    for f in range(np.uint64(len(ids))):
        i, j, k = np.uint64(ids[f, 0]), np.uint64(ids[f, 1]), np.uint64(ids[f, 2])
        if i - low >= size:
            places[tile] = here
            tile = _tile_of(i, starts, hints, shift)
            here = places[tile]
            low, size = starts[tile], starts[tile + _ONE] - starts[tile]
        _write_record(records, here, first + f, i, j, k)
        here += 1
        if j - low < size and k - low < size:
            continue
        b, c = _tile_of(j, starts, hints, shift), _tile_of(k, starts, hints, shift)
        if b != tile:
            _write_record(records, places[b], first + f, i, j, k)
            places[b] += 1
        if c != tile and c != b:
            _write_record(records, places[c], first + f, i, j, k)
            places[c] += 1


def group_faces(ids: Numbers, first: int, tiles: TileRanges) -> tuple[Numbers, Longs]:
    """Records of faces, sorted by tile; a face is in those of all its corners, in each once.

    Parameters
    ----------
    ids : (m, 3) new numbers of the corners.
    first : number of the first triangle; others follow.

    Returns
    -------
    records : (r, ``RECORD_WORDS``), ascending in the number of the triangle within a tile.
    offsets : (k + 1,) where each tile's begin.
    """
    ranges = tiles.starts, tiles.hints, tiles.shift
    counts = np.zeros(len(tiles.starts) - 1, dtype=np.int64)
    _count_faces(ids, *ranges, counts)
    offsets = np.concatenate(([0], np.cumsum(counts)))
    records = np.empty((int(offsets[-1]), RECORD_WORDS), dtype=np.uint32)
    _group_faces(ids, np.uint64(first), *ranges, offsets[:-1].copy(), records)
    return records, offsets


@compiled
def _mark_own(records, first, used):
    n = np.uint64(len(used))
    for f in range(np.uint64(len(records))):
        for corner in range(_ONE, _THREE + _ONE):
            # Below the first is far above the last.
            own = np.uint64(records[f, corner]) - first
            if own < n:
                used[own] = True


def mark_own(records: Numbers, first: int, n_own: int) -> Flags:
    """(n_own,) which of the vertices from number ``first`` on are corners in ``records``."""
    used = np.zeros(n_own, dtype=bool)
    _mark_own(records, np.uint64(first), used)
    return used
