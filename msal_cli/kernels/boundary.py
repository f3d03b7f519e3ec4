"""Open edges: which neighbours a vertex is averaged with where the surface ends."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity


@compiled
def _open_neighbours(faces, face_start, incident, boundary, kept, row_start, row):
    """Neighbours of every boundary vertex along edges with one face; counted where not kept."""
    n = len(boundary)
    stamp = np.full(n, -1, dtype=np.int32)
    times = np.empty(n, dtype=np.int32)
    total = 0
    for i in range(n):
        if boundary[i]:
            for at in range(face_start[i], face_start[i + 1]):
                for corner in range(3):
                    k = faces[incident[at], corner]
                    if stamp[k] != i:
                        stamp[k] = i
                        times[k] = 0
                    times[k] += 1
            times[i] = 0
            # The second walk takes them in the order in which the faces name them.
            for at in range(face_start[i], face_start[i + 1]):
                for corner in range(3):
                    k = faces[incident[at], corner]
                    if times[k] == 1:
                        times[k] = 0
                        if kept:
                            row[total] = k
                        total += 1
        row_start[i + 1] = total
    return total


def boundary_curves(faces: Ints, links: Connectivity) -> tuple[Ints, Ints]:
    """Rows of the neighbours that are joined to a vertex by an edge with one face.

    Parameters
    ----------
    faces : (m, 3), the faces that ``links`` were made from.

    Returns
    -------
    row_start, row : (n + 1,) and (2 x boundary edges,), like a one-ring; rows of inner vertices
        are empty.
    """
    row_start = np.zeros(len(links.boundary) + 1, dtype=np.int32)
    row = np.empty(0, dtype=np.int32)
    around = (faces, *links.incidence, links.boundary)
    total = _open_neighbours(*around, False, row_start, row)
    row = np.empty(total, dtype=np.int32)
    _open_neighbours(*around, True, row_start, row)
    return row_start, row


def averaged_ring(faces: Ints, links: Connectivity, boundary: str) -> tuple[Ints, Ints]:
    """One-rings (n + 1,) and (...,) to average over, for a rule at open edges.

    ``boundary`` is ``"free"``: all neighbours that a vertex has; ``"fixed"``: a boundary vertex has
    an empty row and stays; or ``"curve"``: a boundary vertex is averaged with its neighbours along
    open edges only, so that the rim is smoothed as a curve and is not drawn inwards.
    """
    if boundary == "free" or not links.boundary_edges:
        return links.one_ring
    edge = links.boundary
    valence = np.diff(links.ring_start)
    curve_start, curve = boundary_curves(faces, links)
    if boundary == "fixed":
        curve_start, curve = np.zeros_like(curve_start), curve[:0]
    on_curve = np.diff(curve_start)
    ring_start = np.zeros_like(links.ring_start)
    np.cumsum(np.where(edge, on_curve, valence), out=ring_start[1:])
    ring = np.empty(ring_start[-1], dtype=np.int32)
    of_edge = np.repeat(edge, np.diff(ring_start))
    ring[of_edge] = curve
    ring[~of_edge] = links.ring[~np.repeat(edge, valence)]
    return ring_start, ring
