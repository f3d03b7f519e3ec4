"""Which faces neighbour a face: across its edges, or at its corners.

Neighbourhoods are kept in compressed rows: the neighbours of face f are
``ring[ring_start[f]:ring_start[f + 1]]``, each once and never f itself, first those across its
three edges in turn, then those at its three corners in turn, in ascending order each.

All faces around an edge are neighbours of one another, also where there are more than two.  So
that hubs cost no more than other parts, an edge or a vertex with more than ``MOST_AROUND`` faces
makes no neighbours: the faces of a wide fan still neighbour the next ones across their edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.connectivity import Connectivity
from msal_cli.core.geometry import mean_edge_length
from msal_cli.core.parallel import over_ranges
from msal_cli.errors import TooLargeError

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

MOST_AROUND = 64
"""Faces around an edge or a vertex beyond which sharing it does not make neighbours."""

MOST_PAIRS = 2**31 - 1
"""Entries that 32-bit rows can number."""


@compiled
def _circles(faces, face_start, incident, following):  # type: ignore[no-untyped-def]
    """Link each side of a face to the next side along the same edge, round in a circle.

    Side 3 f + c of face f runs from its corner c to the next; an open edge's follows itself.
    """
    n = len(face_start) - 1
    stamp = np.full(n, -1, dtype=np.int32)
    first = np.empty(n, dtype=np.int32)
    last = np.empty(n, dtype=np.int32)
    for i in range(n):
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            own = 0
            while faces[f, own] != i:
                own += 1
            before = (own + 2) % 3
            for turn in range(2):
                k = faces[f, before] if turn else faces[f, (own + 1) % 3]
                if k < i:
                    continue
                side = 3 * f + (before if turn else own)
                if stamp[k] != i:
                    stamp[k] = i
                    first[k] = side
                else:
                    following[last[k]] = side
                last[k] = side
                following[side] = first[k]


@compiled
def _neighbours(  # type: ignore[no-untyped-def]
    start, stop, faces, face_start, incident, following, at_corners, sizes, ring_start, ring
):
    """Fill the rows of ``ring``; where it is empty, count their ``sizes``."""
    seen = np.full(len(faces), -1, dtype=np.int32)
    filling = len(ring) > 0
    for f in range(start, stop):
        seen[f] = f
        found = 0
        row = ring_start[f]
        for side in range(3 * f, 3 * f + 3):
            around = 1
            at = following[side]
            while at != side and around <= MOST_AROUND:
                around += 1
                at = following[at]
            if around > MOST_AROUND:
                continue
            at = following[side]
            while at != side:
                g = at // 3
                if seen[g] != f:
                    seen[g] = f
                    if filling:
                        ring[row + found] = g
                    found += 1
                at = following[at]
        if at_corners:
            for corner in range(3):
                i = faces[f, corner]
                if face_start[i + 1] - face_start[i] > MOST_AROUND:
                    continue
                for entry in range(face_start[i], face_start[i + 1]):
                    g = incident[entry]
                    if seen[g] != f:
                        seen[g] = f
                        if filling:
                            ring[row + found] = g
                        found += 1
        sizes[f] = found


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
    around = (faces, links.face_start, links.incident_faces)
    following = np.empty(3 * len(faces), dtype=np.int32)
    _circles(*around, following)
    sizes = np.empty(len(faces), dtype=np.int32)
    ring_start = np.zeros(len(faces) + 1, dtype=np.int32)
    ring = np.empty(0, dtype=np.int32)
    at_corners = sharing == "vertex"
    counted = (*around, following, at_corners, sizes)
    over_ranges(_neighbours, len(faces), *counted, ring_start, ring)
    total = int(sizes.sum(dtype=np.int64))
    if total > MOST_PAIRS:
        raise TooLargeError(
            f"the {len(faces)} faces have {total} neighbours, too many to number",
            hint="cut the mesh into parts",
        )
    np.cumsum(sizes, out=ring_start[1:])
    if total:
        ring = np.empty(total, dtype=np.int32)
        over_ranges(_neighbours, len(faces), *counted, ring_start, ring)
    return ring_start, ring


@compiled
def _centroids(start, stop, vertices, faces, centroids):  # type: ignore[no-untyped-def]
    for f in range(start, stop):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        for axis in range(3):
            centroids[f, axis] = (vertices[a, axis] + vertices[b, axis] + vertices[c, axis]) / 3.0


def face_centroids(vertices: Floats, faces: Ints) -> Floats:
    """Means (m, 3) of the three corners of each face, file units."""
    centroids = np.empty((len(faces), 3))
    over_ranges(_centroids, len(faces), vertices, faces, centroids)
    return centroids


def mean_centroid_distance(centroids: Floats, ring_start: Ints, ring: Ints) -> float:
    """Mean distance of the centroids (m, 3) of neighbours, file units; zero without neighbours.

    Over the pairs of the rows; those of edges are usual.
    """
    return mean_edge_length(centroids, ring_start, ring)
