"""Guide normals: for each face the mean normal of the most consistent patch that holds it.

Zhang, Deng, Zhang, Bouaziz and Liu 2015.  The patch of a face is the face and those that share a
vertex with it.  Its score is the greater the less its normals agree,

    H = max |n_a - n_b|  max |n_e - n_e'| / (epsilon + sum |n_e - n_e'|),

the first maximum over all pairs of its faces, the others and the sum over the pairs that share an
edge.  The second factor is near one where one edge has all the bend: a patch across a sharp edge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.connectivity import Connectivity
from msal_cli.core.face_rings import face_rings
from msal_cli.core.geometry import VANISHED
from msal_cli.core.parallel import over_ranges
from msal_cli.dataclass import dataclass

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
LongInts = NDArray[np.int64]

EPSILON = 1e-9


@compiled
def _pairs(edge_start, edge_ring, first_pair, pairs):  # type: ignore[no-untyped-def]
    """Number the pairs f < g of neighbours in the order of the rows."""
    found = 0
    for f in range(len(edge_start) - 1):
        first_pair[f] = found
        for at in range(edge_start[f], edge_start[f + 1]):
            if edge_ring[at] > f:
                pairs[found, 0] = f
                pairs[found, 1] = edge_ring[at]
                found += 1
    first_pair[len(edge_start) - 1] = found
    return found


@compiled
def _inner(  # type: ignore[no-untyped-def]
    start, stop, ring_start, ring, first_pair, pairs, sizes, inner_start, inner
):
    """Fill the rows of ``inner``; where it is empty, count their ``sizes``."""
    member = np.full(len(ring_start) - 1, -1, dtype=np.int32)
    filling = len(inner) > 0
    for f in range(start, stop):
        row, end = ring_start[f], ring_start[f + 1]
        member[f] = f
        for at in range(row, end):
            member[ring[at]] = f
        count = 0
        for at in range(row - 1, end):
            a = f if at < row else ring[at]
            for pair in range(first_pair[a], first_pair[a + 1]):
                if member[pairs[pair, 1]] == f:
                    if filling:
                        inner[inner_start[f] + count] = pair
                    count += 1
        sizes[f] = count


@compiled
def _jumps(start, stop, normals, pairs, jumps):  # type: ignore[no-untyped-def]
    """|n_a - n_b| of every pair; zero where either has no normal."""
    for pair in range(start, stop):
        a, b = pairs[pair, 0], pairs[pair, 1]
        ax, ay, az = normals[a, 0], normals[a, 1], normals[a, 2]
        bx, by, bz = normals[b, 0], normals[b, 1], normals[b, 2]
        if (ax == 0.0 and ay == 0.0 and az == 0.0) or (bx == 0.0 and by == 0.0 and bz == 0.0):
            jumps[pair] = 0.0
        else:
            dx, dy, dz = ax - bx, ay - by, az - bz
            jumps[pair] = np.sqrt(dx * dx + dy * dy + dz * dz)


@compiled
def _scored(  # type: ignore[no-untyped-def]
    start, stop, normals, areas, ring_start, ring, jumps, inner_start, inner, scores, means
):
    """Score and area-weighted mean normal of every patch; infinity where the mean vanishes."""
    widest = 0
    for f in range(start, stop):
        widest = max(widest, ring_start[f + 1] - ring_start[f])
    members = np.empty((widest + 1, 3))
    for f in range(start, stop):
        row = ring_start[f]
        count = 0
        sx = sy = sz = weight = 0.0
        for at in range(row - 1, ring_start[f + 1]):
            k = f if at < row else ring[at]
            nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
            if nx == 0.0 and ny == 0.0 and nz == 0.0:
                continue
            members[count, 0] = nx
            members[count, 1] = ny
            members[count, 2] = nz
            count += 1
            area = areas[k]
            sx += area * nx
            sy += area * ny
            sz += area * nz
            weight += area
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        if length <= VANISHED * weight:
            scores[f] = np.inf
            continue
        means[f, 0] = sx / length
        means[f, 1] = sy / length
        means[f, 2] = sz / length
        widest_square = 0.0
        for a in range(count):
            ax, ay, az = members[a, 0], members[a, 1], members[a, 2]
            for b in range(a):
                dx, dy, dz = members[b, 0] - ax, members[b, 1] - ay, members[b, 2] - az
                square = dx * dx + dy * dy + dz * dz
                if square > widest_square:
                    widest_square = square
        greatest = total = 0.0
        for at in range(inner_start[f], inner_start[f + 1]):
            jump = jumps[inner[at]]
            greatest = max(greatest, jump)
            total += jump
        scores[f] = np.sqrt(widest_square) * greatest / (EPSILON + total)


@compiled
def _chosen(start, stop, normals, ring_start, ring, scores, means, guides):  # type: ignore[no-untyped-def]
    for f in range(start, stop):
        best = f
        for at in range(ring_start[f], ring_start[f + 1]):
            if scores[ring[at]] < scores[best]:
                best = ring[at]
        known = scores[best] < np.inf
        for axis in range(3):
            guides[f, axis] = means[best, axis] if known else normals[f, axis]


@dataclass(frozen=True, eq=False)
class Patches:
    """The patches of a mesh.

    Attributes
    ----------
    ring_start, ring : rows of the faces of each patch but for its own, (m + 1,) and (k,).
    edge_start, edge_ring : rows of the faces that share an edge with each face.
    pairs : (e, 2), the faces that share an edge, each pair once, the lower number first.
    inner_start, inner : rows of the pairs both of whose faces are in the patch, (m + 1,).
    """

    ring_start: Ints
    ring: Ints
    edge_start: Ints
    edge_ring: Ints
    pairs: Ints
    inner_start: LongInts
    inner: Ints

    def guides(self, normals: Floats, areas: Floats) -> Floats:
        """Guide normals (m, 3) for face ``normals`` (m, 3) and ``areas`` (m,).

        Of the patches centred at a face or at one that shares a vertex with it, the guide is the
        area-weighted mean normal of the one with the lowest score; of equal ones that of the face
        itself, then the first of its row.  Faces whose normal is zero do not count.  A face all of
        whose patches have no mean normal is guided by its own.
        """
        m = len(normals)
        jumps = np.empty(len(self.pairs))
        over_ranges(_jumps, len(self.pairs), normals, self.pairs, jumps)
        scores = np.empty(m)
        means = np.empty((m, 3))
        over_ranges(
            _scored,
            m,
            normals,
            areas,
            self.ring_start,
            self.ring,
            jumps,
            self.inner_start,
            self.inner,
            scores,
            means,
        )
        guides = np.empty((m, 3))
        over_ranges(_chosen, m, normals, self.ring_start, self.ring, scores, means, guides)
        return guides


def patches(faces: Ints, links: Connectivity) -> Patches:
    """The patches of ``faces`` (m, 3), those that ``links`` were made from.

    Raises TooLargeError as ``face_rings`` does.
    """
    m = len(faces)
    ring_start, ring = face_rings(faces, links, "vertex")
    edge_start, edge_ring = face_rings(faces, links, "edge")
    first_pair = np.empty(m + 1, dtype=np.int32)
    pairs = np.empty((len(edge_ring) // 2, 2), dtype=np.int32)
    _pairs(edge_start, edge_ring, first_pair, pairs)
    sizes = np.empty(m, dtype=np.int32)
    inner_start = np.zeros(m + 1, dtype=np.int64)
    inner = np.empty(0, dtype=np.int32)
    known = (ring_start, ring, first_pair, pairs, sizes)
    over_ranges(_inner, m, *known, inner_start, inner)
    np.cumsum(sizes, dtype=np.int64, out=inner_start[1:])
    if inner_start[-1]:
        inner = np.empty(inner_start[-1], dtype=np.int32)
        over_ranges(_inner, m, *known, inner_start, inner)
    return Patches(ring_start, ring, edge_start, edge_ring, pairs, inner_start, inner)
