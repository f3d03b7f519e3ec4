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

from msal_cli.arrays import Floats, Ints
from msal_cli.errors import TooLargeError
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.geometry import mean_edge_length
from msal_cli.kernels.parallel import MARKING_THREADS, fill_array, over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, ZERO
from msal_cli.kernels.variable_rows import found_rows

MOST_AROUND = 64
"""Faces around an edge or a vertex beyond which sharing it does not make neighbours."""

_MOST = np.uint64(MOST_AROUND)

MOST_PAIRS = 2**31 - 1
"""Entries that 32-bit rows can number."""


@compiled
def _circles(start, stop, faces, face_start, incident, following):
    """Link each side of a face to the next side along the same edge, round in a circle.

    Side 3 f + c of face f runs from its corner c to the next; an open edge's follows itself.  A
    range of vertices has the edges from them to vertices of higher number.  All arrays are flat
    and unsigned, so that no index is looked at for its sign.
    """
    n = np.uint64(len(face_start)) - ONE
    stamp = np.empty(np.int64(n), dtype=np.uint32)
    for i in range(n):
        stamp[i] = n
    first = np.empty_like(stamp)
    last = np.empty_like(stamp)
    for i in range(np.uint64(start), np.uint64(stop)):
        for at in range(np.uint64(face_start[i]), np.uint64(face_start[i + ONE])):
            side = THREE * incident[at]
            a, b, c = faces[side], faces[side + ONE], faces[side + TWO]
            # Without branches: which corner of a face a vertex is cannot be foreseen.
            own = ZERO if a == i else (ONE if b == i else TWO)
            previous = TWO if own == ZERO else own - ONE
            after = b if a == i else (c if b == i else a)
            before = c if a == i else (a if b == i else b)
            for k, here in ((after, side + own), (before, side + previous)):
                if k > i:
                    if stamp[k] != i:
                        stamp[k] = i
                        first[k] = here
                    else:
                        following[last[k]] = here
                    last[k] = here
                    following[here] = first[k]


@compiled
def _neighbours(
    start, stop, first, faces, face_start, incident, following, at_corners, most, sizes, ring
):
    """Find rows as ``found_rows`` wants them.

    Whether a face was met before cannot be foreseen: without a branch each is written down, and
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
    return links.kept(f"face rings, {sharing}", lambda: _made(faces, links, sharing))


def _made(faces: Ints, links: Connectivity, sharing: str) -> tuple[Ints, Ints]:
    m = len(faces)
    face_start = links.face_start.view(np.uint32)
    around = faces.reshape(-1).view(np.uint32), face_start, links.incident_faces.view(np.uint32)
    following = np.empty(3 * m, dtype=np.uint32)
    over_ranges(_circles, len(face_start) - 1, *around, following, most=MARKING_THREADS)
    # A row has fewer than MOST_AROUND faces for each corner: around it, or around the edges
    # between corners where there are too many.
    widest = int(np.diff(face_start).max())
    most = 3 * min(widest, MOST_AROUND) + 1
    sizes, ring = found_rows(_neighbours, m, most, *around, following, sharing == "vertex", most)
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
