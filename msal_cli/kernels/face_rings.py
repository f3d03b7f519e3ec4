"""Which faces neighbour a face, across its edges or at its corners, and which are near it.

Neighbourhoods are kept in compressed rows: the neighbours of face f are
``ring[ring_start[f]:ring_start[f + 1]]``, each once and never f itself, first those across its
three edges in turn, then those at its three corners in turn, in ascending order each.

All faces around an edge are neighbours of one another, also where there are more than two.  So
that hubs cost no more than other parts, an edge or a vertex with more than ``MOST_AROUND`` faces
makes no neighbours: the faces of a wide fan still neighbour the next ones across their edges.

The faces near a face are found by a flood through the connectivity, not in a ball in space: the
other side of a thin wall is not found, and no search tree is needed.  It goes on through faces
whose centroids are within the distance.

Lengths of rows are not known before they are found.  To find rows twice, once for their lengths,
would cost twice the time.  So a kernel writes them into room for the longest rows, a part of the
items after the other, and they are put together then.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.errors import TooLargeError
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity, side_circles
from msal_cli.kernels.geometry import mean_edge_length
from msal_cli.kernels.parallel import MARKING_THREADS, fill_array, over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, most_neighbours

MOST_AROUND = 64
"""Faces around an edge or a vertex beyond which sharing it does not make neighbours."""

_MOST = np.uint64(MOST_AROUND)

MOST_PAIRS = 2**31 - 1
"""Entries that 32-bit rows can number."""

PARTS = 8
"""Parts of the items, at most: the rows of one are in memory twice."""

SMALLEST_PART = 1 << 17
"""Items in a part, at least, unless their rows may be very long."""

MOST_ROOM = 1 << 26
"""Indices that there is room for in a part: a limit on memory counts it, even if unused."""


def find_rows(
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


@compiled
def _neighbours(
    start, stop, first, faces, face_start, incident, following, at_corners, most, sizes, ring
):
    """Find rows as ``find_rows`` wants them.

    Whether a face was met before cannot be predicted: without a branch each is written down, and
    kept by being counted.
    """
    seen = np.empty(len(faces) // 3, dtype=np.uint32)
    for face in range(np.uint64(len(seen))):
        seen[face] = len(seen)
    filled = np.uint64(start * most)
    for f in range(np.uint64(first + start), np.uint64(first + stop)):
        name = np.uint32(f)
        seen[f] = name
        row = filled
        for side in range(THREE * f, THREE * f + THREE):
            around = ONE
            at = np.uint64(following[side])
            while at != side and around <= _MOST:
                around += ONE
                at = np.uint64(following[at])
            if around > _MOST:
                continue
            for _ in range(around - ONE):
                at = np.uint64(following[at])
                g = at // THREE
                ring[filled] = g
                filled += np.uint64(seen[g] != name)
                seen[g] = name
        if at_corners:
            for corner in range(THREE * f, THREE * f + THREE):
                i = np.uint64(faces[corner])
                entry, end = np.uint64(face_start[i]), np.uint64(face_start[i + ONE])
                if end - entry > _MOST:
                    continue
                while entry < end:
                    g = np.uint64(incident[entry])
                    ring[filled] = g
                    filled += np.uint64(seen[g] != name)
                    seen[g] = name
                    entry += ONE
        sizes[f] = filled - row
    return start * most, np.int64(filled)


def face_rings(faces: Ints, links: Connectivity, sharing: str) -> tuple[Ints, Ints]:
    """Rows of the faces that neighbour each face, ``ring_start`` (m + 1,) and ``ring``.

    Parameters
    ----------
    faces : (m, 3), those that ``links`` were made from.
    sharing : ``"edge"``: faces that share an edge; ``"vertex"``: those that share a vertex too.

    Raises
    ------
    TooLargeError
        where the faces have more than ``MOST_PAIRS`` neighbours in all.
    """
    return links.kept(f"face rings, {sharing}", lambda: _make(faces, links, sharing))


def _make(faces: Ints, links: Connectivity, sharing: str) -> tuple[Ints, Ints]:
    m = len(faces)
    face_start = links.face_start.view(np.uint32)
    around = faces.reshape(-1).view(np.uint32), face_start, links.incident_faces.view(np.uint32)
    following = side_circles(faces, links)
    # A row has fewer than MOST_AROUND faces for each corner: around it, or around the edges
    # between corners where there are too many.
    widest = int(np.diff(face_start).max())
    most = 3 * min(widest, MOST_AROUND) + 1
    sizes, ring = find_rows(_neighbours, m, most, *around, following, sharing == "vertex", most)
    if len(ring) > MOST_PAIRS:
        raise TooLargeError(
            f"the {m} faces have {len(ring)} neighbours, too many to number",
            hint="cut the mesh into parts",
        )
    ring_start = np.zeros(m + 1, dtype=np.int32)
    np.cumsum(sizes, out=ring_start[1:])
    return ring_start, ring


@compiled
def _centroids(start, stop, vertices, faces, centroids):
    for f in range(start, stop):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for axis in range(3):
            centroids[f, axis] = (vertices[a, axis] + vertices[b, axis] + vertices[c, axis]) / 3.0


def face_centroids(vertices: Floats, faces: Ints) -> Floats:
    """Means (m, 3) of the three corners of each face, file units."""
    return fill_array(_centroids, (len(faces), 3), vertices, faces)


def mean_centroid_distance(centroids: Floats, ring_start: Ints, ring: Ints) -> float:
    """Mean distance of the centroids (m, 3) of neighbours, file units; zero without neighbours.

    Over the pairs of the rows; those of edges are usual.
    """
    return mean_edge_length(centroids, ring_start, ring)


@compiled
def _reached(start, stop, first, c, ring_start, ring, radii, most, sizes, near):
    """Find rows as ``find_rows`` wants them; c centroids, flat; ``radii`` one, or one a face."""
    has_own = len(radii) > 1
    seen = np.empty(len(ring_start) - 1, dtype=np.uint32)
    none = np.uint32(len(seen))
    for face in range(np.uint64(len(seen))):
        seen[face] = none
    most = np.uint64(most)
    found = np.empty(np.int64(most + most_neighbours(np.uint64(0), none, ring_start)), np.uint32)
    filled = np.uint64(start) * most
    for own in range(np.uint64(first + start), np.uint64(first + stop)):
        p = THREE * own
        x, y, z = c[p], c[p + ONE], c[p + TWO]
        radius = radii[own] if has_own else radii[0]
        square_radius = radius * radius
        name = np.uint32(own)
        seen[own] = name
        g = np.uint64(own)
        count = at = np.uint64(0)
        while True:
            for entry in range(np.uint64(ring_start[g]), np.uint64(ring_start[g + ONE])):
                # Whether a face is new and near cannot be predicted: without a branch each is
                # written down, and kept by being counted.
                k = np.uint64(ring[entry])
                p = THREE * k
                dx, dy, dz = c[p] - x, c[p + ONE] - y, c[p + TWO] - z
                is_near = dx * dx + dy * dy + dz * dz <= square_radius
                found[count] = ring[entry]
                count += np.uint64(is_near & (seen[k] != name))
                seen[k] = name
            if at >= count or count >= most:
                break
            g = np.uint64(found[at])
            at += ONE
        count = min(count, most)
        for place in range(count):
            near[filled + place] = found[place]
        sizes[own] = count
        filled += count
    return start * np.int64(most), np.int64(filled)


def faces_within(
    centroids: Floats, ring_start: Ints, ring: Ints, radius: float | Floats, most: int
) -> tuple[Longs, Ints]:
    """Rows of the faces near each face: ``near_start`` (m + 1,) int64 and ``near``.

    Parameters
    ----------
    centroids : (m, 3), file units.
    ring_start, ring : rows of the neighbours that the flood goes through, (m + 1,) and (k,).
    radius : distance between centroids up to which a face is near, file units; or (m,), one for
        each face, from which the distance is measured.
    most : faces at which the flood from a face stops; the first that it meets are kept.

    A face is not in its own row.  Rows begin with the nearest neighbours, in steps along ``ring``.
    """
    sizes, near = find_rows(
        _reached,
        len(centroids),
        most,
        centroids.reshape(-1),
        ring_start.view(np.uint32),
        ring.view(np.uint32),
        np.atleast_1d(np.float64(radius)),
        most,
    )
    near_start = np.zeros(len(centroids) + 1, dtype=np.int64)
    np.cumsum(sizes, dtype=np.int64, out=near_start[1:])
    return near_start, near
