"""Tiles of a mesh and the rings around them: depths below a border, rings outside it, numbering.

Throughout: ``records`` (m, 4) uint32 are triangles as (number of the triangle, three vertices), and
a tile owns the vertices from ``first`` on, as many as its arrays are long.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.geometry import DEGENERATE
from msal_cli.kernels.vectors import edges_and_normal, longest_square

FAR = 65535
"""Rings of a vertex that is further away than was looked at."""

Records = NDArray[np.uint32]
Rings = NDArray[np.uint16]


@compiled
def _deepen(records, f, first, most, depths):
    """Lower the depths of a triangle's own corners where another corner allows it; whether any
    changed."""
    count = np.uint64(len(depths))
    nearest = np.uint16(65535)
    for corner in range(1, 4):
        # Below the first is far above the last.
        own = np.uint64(records[f, corner]) - first
        nearest = min(nearest, depths[own] if own < count else np.uint16(0))
    if nearest >= most:
        return False
    changes = False
    depth = np.uint16(nearest + 1)
    for corner in range(1, 4):
        own = np.uint64(records[f, corner]) - first
        if own < count and depths[own] > depth:
            depths[own] = depth
            changes = True
    return changes


@compiled
def _border_depths(records, first, most, depths):
    # Depths spread along the order of the triangles: there and back they need few passes.
    last = len(records) - 1
    changes = True
    while changes:
        changes = False
        for f in range(len(records)):
            changes |= _deepen(records, np.uint64(f), first, most, depths)
        if changes:
            changes = False
            for f in range(len(records)):
                changes |= _deepen(records, np.uint64(last - f), first, most, depths)


@compiled
def _near_border(records, first, below, depths, chosen):
    found = 0
    for f in range(len(records)):
        chosen[found] = f
        is_near = False
        for corner in range(1, 4):
            own = np.int64(records[f, corner]) - first
            if 0 <= own < len(depths):
                is_near |= depths[own] < below
        found += is_near
    return found


def border_records(records: Records, first: int, count: int, rings: int) -> Ints:
    """Which of a tile's triangles other tiles may need for ``rings`` rings around them, (k,).

    They have an own vertex, among the ``count`` from ``first`` on, that is less than ``rings``
    edges away from the vertices of others.
    """
    depths = np.full(count, FAR, dtype=np.uint16)
    _border_depths(records, np.uint64(first), np.uint16(rings - 1), depths)
    chosen = np.empty(len(records) + 1, dtype=np.int32)
    found = _near_border(records, first, rings, depths, chosen)
    near: Ints = chosen[:found]
    return near


@compiled
def _crossing(records, first, count, chosen):
    found = 0
    for f in range(len(records)):
        chosen[found] = f
        crosses = False
        for corner in range(1, 4):
            own = np.int64(records[f, corner]) - first
            crosses |= own < 0 or own >= count
        found += crosses
    return found


def crossing_records(records: Records, first: int, count: int) -> Records:
    """The triangles that have a vertex outside the tile."""
    chosen = np.empty(len(records) + 1, dtype=np.int32)
    found = _crossing(records, first, count, chosen)
    crossing: Records = records[chosen[:found]]
    return crossing


@compiled
def _spread_rings(corners, most, rings):
    changes = True
    while changes:
        changes = False
        for f in range(len(corners)):
            nearest = np.int64(
                min(rings[corners[f, 0]], rings[corners[f, 1]], rings[corners[f, 2]])
            )
            if nearest >= most:
                continue
            for corner in range(3):
                if rings[corners[f, corner]] > nearest + 1:
                    rings[corners[f, corner]] = nearest + 1
                    changes = True


def spread_rings(corners: Ints, is_own: Flags, most: int) -> Rings:
    """Edges (n,) from each vertex to the nearest one of its own, ``FAR`` for more than ``most``.

    ``corners`` (m, 3) are triangles, ``is_own`` (n,) the vertices to start from.
    """
    rings = np.where(is_own, np.uint16(0), np.uint16(FAR))
    _spread_rings(corners, most, rings)
    return rings


@compiled
def _merge(one, other, merged):
    at = 0
    for f in range(len(one)):
        while at < len(other) and other[at, 0] < one[f, 0]:
            for column in range(4):
                merged[f + at, column] = other[at, column]
            at += 1
        for column in range(4):
            merged[f + at, column] = one[f, column]
    for f in range(at, len(other)):
        for column in range(4):
            merged[len(one) + f, column] = other[f, column]


def merge_records(one: Records, other: Records) -> Records:
    """Two lists of different triangles, each in the order of the file, as one."""
    if not len(other):
        return one
    merged = np.empty((len(one) + len(other), 4), dtype=np.uint32)
    _merge(one, other, merged)
    return merged


@compiled
def _drop_repeated(records, is_kept):
    dropped = 0
    for f in range(len(records)):
        a, b, c = records[f, 1], records[f, 2], records[f, 3]
        is_kept[f] = (a != b) & (b != c) & (c != a)
        dropped += not is_kept[f]
    return dropped


def drop_repeated(records: Records) -> Records:
    """The triangles with three different vertices; the very array where all are such."""
    is_kept = np.empty(len(records), dtype=bool)
    dropped = _drop_repeated(records, is_kept)
    return records[is_kept] if dropped else records


@compiled
def _shared(faces, own, chosen):
    found = 0
    for f in range(len(faces)):
        chosen[found] = f
        a, b, c = own[faces[f, 0]], own[faces[f, 1]], own[faces[f, 2]]
        found += (a | b | c) & (not (a & b & c))
    return found


def shared_faces(faces: Ints, own: Flags) -> Ints:
    """Which faces (k,) of (m, 3) have both vertices of the tile, ``own`` (n,), and others."""
    chosen = np.empty(len(faces) + 1, dtype=np.int32)
    shared: Ints = chosen[: _shared(faces, own, chosen)]
    return shared


@compiled
def _count_first_corners(records, first, count):
    found = 0
    for f in range(len(records)):
        own = np.int64(records[f, 1]) - first
        found += 0 <= own < count
    return found


def count_first_corners(records: Records, first: int, count: int) -> int:
    """How many triangles belong to the tile: those whose first vertex does."""
    return int(_count_first_corners(records, first, count))


@compiled
def _place(sorted_ids, wanted):
    low, high = 0, len(sorted_ids)
    while low < high:
        middle = (low + high) >> 1
        if sorted_ids[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low


@compiled
def _relabel(records, first, own_numbers, others, other_numbers, faces):
    for f in range(len(records)):
        for corner in range(1, 4):
            own = np.int64(records[f, corner]) - first
            if 0 <= own < len(own_numbers):
                faces[f, corner - 1] = own_numbers[own]
            else:
                at = _place(others, records[f, corner])
                faces[f, corner - 1] = other_numbers[at]


def relabel(
    records: Records,
    first: int,
    own_numbers: Ints,
    others: NDArray[np.uint32],
    other_numbers: Ints,
) -> Ints:
    """The triangles (m, 3) with other numbers for their vertices.

    Parameters
    ----------
    own_numbers : (count,), the numbers of the tile's vertices.
    others, other_numbers : (k,), all other vertices, ascending, and their numbers.
    """
    faces = np.empty((len(records), 3), dtype=np.int32)
    _relabel(records, first, own_numbers, others, other_numbers, faces)
    return faces


@compiled
def _edge_uses(faces, i, row, end, incident, slot, ends, uses):
    """Count how often each edge of vertex i leaves it and arrives; how many edges there are."""
    found = 0
    for at in range(row, end):
        f = incident[at]
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        after = b if a == i else (c if b == i else a)
        before = c if a == i else (a if b == i else b)
        for side in range(2):
            k = after if side == 0 else before
            place = slot[k]
            if place >= found or ends[place] != k:
                place = found
                slot[k] = found
                ends[found] = k
                uses[found, 0] = 0
                uses[found, 1] = 0
                found += 1
            uses[place, side] += 1
    return found


@compiled
def _count_edges(faces, face_start, incident, own, counts):
    widest = 0
    for i in range(len(own)):
        widest = max(widest, face_start[i + 1] - face_start[i])
    slot = np.zeros(len(own), dtype=np.int32)
    ends = np.empty(2 * widest, dtype=np.int32)
    uses = np.empty((2 * widest, 2), dtype=np.int32)
    for i in range(len(own)):
        if not own[i]:
            continue
        found = _edge_uses(faces, i, face_start[i], face_start[i + 1], incident, slot, ends, uses)
        for place in range(found):
            if ends[place] > i:
                out, into = uses[place, 0], uses[place, 1]
                if out + into == 1:
                    counts[0] += 1
                elif out + into > 2:
                    counts[2] += 1
                elif out != 1:
                    counts[1] += 1


def count_own_edges(faces: Ints, incidence: tuple[Ints, Ints], own: Flags) -> tuple[int, int, int]:
    """Boundary, inconsistent and non-manifold edges, of those from an ``own`` (n,) vertex to one of
    higher number: see ``connectivity.Connectivity``.

    ``incidence`` are the faces around each vertex; those of own vertices must be complete.
    """
    counts = np.zeros(3, dtype=np.int64)
    _count_edges(faces, *incidence, own, counts)
    boundary, inconsistent, non_manifold = map(int, counts)
    return boundary, inconsistent, non_manifold


@compiled
def _count_flat(vertices, faces, own):
    flat = 0
    for f in range(len(faces)):
        if own[f]:
            a, b, c = np.uint64(faces[f, 0]), np.uint64(faces[f, 1]), np.uint64(faces[f, 2])
            ux, uy, uz, wx, wy, wz, nx, ny, nz = edges_and_normal(vertices, a, b, c)
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            flat += length <= DEGENERATE * longest_square(ux, uy, uz, wx, wy, wz)
    return flat


def count_flat_faces(vertices: Floats, faces: Ints, own: Flags) -> int:
    """How many ``own`` (m,) faces have no normal, see ``geometry``."""
    return int(_count_flat(vertices, faces, own))
