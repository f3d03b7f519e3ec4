"""Guide normals: for each face the mean normal of the most consistent patch that holds it.

Zhang, Deng, Zhang, Bouaziz and Liu 2015.  The patch of a face is the face and those that share a
vertex with it.  Its score is the greater the less its normals agree,

    H = max |n_a - n_b|  max |n_e - n_e'| / (epsilon + sum |n_e - n_e'|),

the first maximum over all pairs of its faces, the others and the sum over the pairs that share an
edge.  The second factor is near one where one edge has all the bend: a patch across a sharp edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.face_rings import face_rings, find_rows
from msal_cli.kernels.geometry import VANISHED, usable_areas
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, most_neighbours

EPSILON = 1e-9

BLOCK_PATCHES = np.uint64(32)
"""Patches that are worked on at a time: what belongs to them fits a first-level cache."""

FOUR = np.uint64(4)


@compiled
def _pairs(edge_start, edge_ring, first_pair, pairs):
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
def _inner(start, stop, first, ring_start, ring, first_pair, pairs, most, sizes, inner):
    """Find rows as ``find_rows`` wants them: of each pair as many as both faces are in a patch.

    ``pairs`` flat.  Which are cannot be predicted: without a branch each is written down, and kept
    by being counted.
    """
    member = np.empty(len(ring_start) - 1, dtype=np.uint32)
    for face in range(np.uint64(len(member))):
        member[face] = len(member)
    filled = np.uint64(start * most)
    for f in range(np.uint64(first + start), np.uint64(first + stop)):
        name = np.uint32(f)
        row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
        member[f] = name
        for at in range(row, end):
            member[ring[at]] = name
        before = filled
        for at in range(row, end + ONE):
            a = np.uint64(ring[at]) if at < end else f
            for pair in range(np.uint64(first_pair[a]), np.uint64(first_pair[a + ONE])):
                inner[filled] = pair
                filled += np.uint64(member[pairs[TWO * pair + ONE]] == name)
        sizes[f] = filled - before
    return start * most, np.int64(filled)


@compiled
def _jumps(start, stop, n, pairs, jumps):
    """|n_a - n_b| of every pair; zero where either has no normal.  n normals, flat as the pairs."""
    for pair in range(np.uint64(start), np.uint64(stop)):
        a, b = THREE * pairs[TWO * pair], THREE * pairs[TWO * pair + ONE]
        ax, ay, az = n[a], n[a + ONE], n[a + TWO]
        bx, by, bz = n[b], n[b + ONE], n[b + TWO]
        dx, dy, dz = ax - bx, ay - by, az - bz
        jump = np.sqrt(dx * dx + dy * dy + dz * dz)
        has_first = (ax != 0.0) | (ay != 0.0) | (az != 0.0)
        has_second = (bx != 0.0) | (by != 0.0) | (bz != 0.0)
        jumps[pair] = jump if has_first & has_second else 0.0


@compiled
def _gather(first, last, half, n, areas, ring_start, ring, x, y, z, counts, sums):
    """Put the normals of the patches of a block side by side, and add up areas and normals.

    Those of a patch are followed by themselves, from the first on, for ``half`` places: so that
    the k-th after each is another of its patch.  Faces without an area are left out.  Returns how
    many places are filled.
    """
    filled = np.uint64(0)
    for f in range(first, last):
        row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
        sx = sy = sz = weight = 0.0
        own = filled
        k = np.uint64(f)
        at = row
        while True:
            p = THREE * k
            nx, ny, nz = n[p], n[p + ONE], n[p + TWO]
            x[filled] = nx
            y[filled] = ny
            z[filled] = nz
            area = areas[k]
            filled += np.uint64(area > 0.0)
            sx += area * nx
            sy += area * ny
            sz += area * nz
            weight += area
            if at == end:
                break
            k = np.uint64(ring[at])
            at += ONE
        place = FOUR * (f - first)
        sums[place], sums[place + ONE], sums[place + TWO] = sx, sy, sz
        sums[place + THREE] = weight
        counts[f - first] = filled - own
        if filled > own:
            for one in range(own, own + half):
                x[filled] = x[one]
                y[filled] = y[one]
                z[filled] = z[one]
                filled += ONE
    return filled


@compiled
def _widest(half, filled, x, y, z, squares):
    """The greatest square of a difference between each vector and the next ``half``, an even
    number of them; vector code, for which the places of a block are many enough."""
    for at in range(filled):
        squares[at] = 0.0
    places = max(filled, half) - half
    for k in range(ONE, half, TWO):
        for at in range(places):
            ax, ay, az = x[at], y[at], z[at]
            bx, by, bz = x[at + k] - ax, y[at + k] - ay, z[at + k] - az
            cx, cy, cz = x[at + k + ONE] - ax, y[at + k + ONE] - ay, z[at + k + ONE] - az
            square = max(bx * bx + by * by + bz * bz, cx * cx + cy * cy + cz * cz)
            squares[at] = max(squares[at], square)


@compiled
def _score(start, stop, n, areas, ring_start, ring, jumps, inner_start, inner, scores, means):
    """Score and area-weighted mean normal of every patch; infinity where the mean vanishes.

    n normals, flat as the means.  All indices are unsigned, so that none is looked at for its sign.
    """
    start, stop = np.uint64(start), np.uint64(stop)
    # A patch has one face more than its ring, and as many places again at most.
    room = np.int64(BLOCK_PATCHES * TWO * (most_neighbours(start, stop, ring_start) + THREE))
    x, y, z, squares = np.empty(room), np.empty(room), np.empty(room), np.empty(room)
    counts = np.empty(np.int64(BLOCK_PATCHES), dtype=np.uint64)
    sums = np.empty(np.int64(FOUR * BLOCK_PATCHES))
    for first in range(start, stop, BLOCK_PATCHES):
        last = min(first + BLOCK_PATCHES, stop)
        # All pairs of k normals are each with those up to k / 2 places on; here an even number.
        half = (most_neighbours(first, last, ring_start) + THREE) // FOUR * TWO
        filled = _gather(first, last, half, n, areas, ring_start, ring, x, y, z, counts, sums)
        _widest(half, filled, x, y, z, squares)
        place = np.uint64(0)
        for f in range(first, last):
            count = counts[f - first]
            square = 0.0
            for at in range(place, place + count):
                square = max(square, squares[at])
            place += count + half if count else count
            greatest = total = 0.0
            for at in range(np.uint64(inner_start[f]), np.uint64(inner_start[f + ONE])):
                jump = jumps[inner[at]]
                greatest = max(greatest, jump)
                total += jump
            of = FOUR * (f - first)
            sx, sy, sz = sums[of], sums[of + ONE], sums[of + TWO]
            length = np.sqrt(sx * sx + sy * sy + sz * sz)
            if length <= VANISHED * sums[of + THREE]:
                scores[f] = np.inf
                continue
            scores[f] = np.sqrt(square) * greatest / (EPSILON + total)
            p = THREE * f
            means[p], means[p + ONE], means[p + TWO] = sx / length, sy / length, sz / length


@compiled
def _choose(start, stop, n, ring_start, ring, scores, means, guides):
    """n normals, flat as the means and guides."""
    for f in range(np.uint64(start), np.uint64(stop)):
        best = np.uint64(f)
        least = scores[f]
        for at in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
            k = np.uint64(ring[at])
            score = scores[k]
            # Two choices without a branch: which patch is best cannot be predicted.
            best = k if score < least else best
            least = min(least, score)
        p, q = THREE * f, THREE * best
        known = least < np.inf
        guides[p] = means[q] if known else n[p]
        guides[p + ONE] = means[q + ONE] if known else n[p + ONE]
        guides[p + TWO] = means[q + TWO] if known else n[p + TWO]


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
    inner_start: Longs
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
        flat = normals.reshape(-1)
        pairs = self.pairs.reshape(-1).view(np.uint32)
        over_ranges(_jumps, len(self.pairs), flat, pairs, jumps)
        rows = self.ring_start.view(np.uint32), self.ring.view(np.uint32)
        inner = self.inner_start.view(np.uint64), self.inner.view(np.uint32)
        scores = np.empty(m)
        means = np.empty(3 * m)
        areas = usable_areas(normals, areas)
        over_ranges(_score, m, flat, areas, *rows, jumps, *inner, scores, means)
        guides = np.empty((m, 3))
        over_ranges(_choose, m, flat, *rows, scores, means, guides.reshape(-1))
        return guides


def patches(faces: Ints, links: Connectivity) -> Patches:
    """The patches of ``faces`` (m, 3), those that ``links`` were made from.

    Raises TooLargeError as ``face_rings`` does.
    """
    return links.kept("patches", lambda: _make(faces, links))


def _make(faces: Ints, links: Connectivity) -> Patches:
    m = len(faces)
    ring_start, ring = face_rings(faces, links, "vertex")
    edge_start, edge_ring = face_rings(faces, links, "edge")
    first_pair = np.empty(m + 1, dtype=np.int32)
    pairs = np.empty((len(edge_ring) // 2, 2), dtype=np.int32)
    _pairs(edge_start, edge_ring, first_pair, pairs)
    # Every pair of a patch is an edge of two of its faces.
    widest, across = int(np.diff(ring_start).max()), int(np.diff(edge_start).max())
    most = (widest + 1) * across // 2 + 1
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    numbered = first_pair.view(np.uint32), pairs.reshape(-1).view(np.uint32)
    sizes, inner = find_rows(_inner, m, most, *rows, *numbered, most)
    inner_start = np.zeros(m + 1, dtype=np.int64)
    np.cumsum(sizes, dtype=np.int64, out=inner_start[1:])
    return Patches(ring_start, ring, edge_start, edge_ring, pairs, inner_start, inner)
