"""Neighbours of faces, faces within a distance, and groups of faces: flaps and patches.

Neighbours are stored in CSR form: those of face f are ``ring[ring_start[f]:ring_start[f + 1]]``,
each once and without f, first those across its three edges, then those at its three corners,
ascending.

All faces around an edge are neighbours of one another, also at non-manifold edges.  To limit the
cost, an edge or a vertex with more than ``MAX_AROUND`` faces makes no neighbours: the faces of a
wide fan are still neighbours across their edges.

The faces within a distance are found by breadth-first search through faces whose centroids are
within it, not in a ball in space, so the other side of a thin wall is not included.

Rows are computed once, into room for the longest ones, and packed, because counting first would
take twice the time.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from msal_cli.arrays import Floats, Floats32, Ints, Longs
from msal_cli.errors import TooLargeError
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity, side_circles
from msal_cli.kernels.geometry import VANISHED, usable_areas
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import MARKING_THREADS, fill_array, over_ranges
from msal_cli.kernels.vectors import ONE, THREE, TWO, longest_row
from msal_cli.light_dataclass import dataclass

MAX_AROUND = 64
"""With more faces around an edge or a vertex, sharing it does not make them neighbours."""

_MAX_AROUND = np.uint64(MAX_AROUND)

MAX_PAIRS = 2**31 - 1
"""Largest number of entries of rows with 32-bit offsets."""


def find_rows(
    kernel: Callable[..., Any], count: int, most: int, *known: object
) -> tuple[Ints, Ints]:
    """Sizes (count,) of the rows of all items, and the concatenated rows.

    ``kernel(start, stop, *known, sizes, found)`` finds the rows of a range of items, of at most
    ``most`` indices each.  It writes their ``sizes``, writes the concatenated rows into ``found``
    (uint32) from start * most on, and returns where they begin and end there.
    """
    sizes = np.empty(count, dtype=np.int32)
    # Pages that are not written to take no memory.
    found = np.empty(count * most, dtype=np.uint32)
    filled = 0
    for start, end in over_ranges(kernel, count, *known, sizes, found, most=MARKING_THREADS):
        if start:
            found[filled : filled + end - start] = found[start:end]
        filled += end - start
    found.resize(filled, refcheck=False)
    return sizes, found.view(np.int32)


@compiled
def _neighbours(start, stop, faces, face_start, incident, following, at_corners, most, sizes, ring):
    """Find neighbours, for ``find_rows``.

    Whether a face was seen before cannot be predicted, so each is written, and only counted if it
    is new: this needs no branch.
    """
    seen = np.full(len(faces) // 3, len(faces) // 3, dtype=np.uint32)
    filled = np.uint64(start * most)
    for f in range(np.uint64(start), np.uint64(stop)):
        name = np.uint32(f)
        seen[f] = name
        row = filled
        for side in range(THREE * f, THREE * f + THREE):
            around = ONE
            at = np.uint64(following[side])
            while at != side and around <= _MAX_AROUND:
                around += ONE
                at = np.uint64(following[at])
            if around > _MAX_AROUND:
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
                if end - entry > _MAX_AROUND:
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
    """The neighbours of each face in CSR form, ``ring_start`` (m + 1,) and ``ring``.

    Parameters
    ----------
    faces : (m, 3), those that ``links`` were made from.
    sharing : ``"edge"``: faces that share an edge; ``"vertex"``: those that share a vertex too.

    Raises TooLargeError if there are more than ``MAX_PAIRS`` neighbours in all.
    """
    return links.kept(f"face rings, {sharing}", lambda: _find_face_rings(faces, links, sharing))


def _find_face_rings(faces: Ints, links: Connectivity, sharing: str) -> tuple[Ints, Ints]:
    m = len(faces)
    around = [array.reshape(-1).view(np.uint32) for array in (faces, *links.incidence)]
    following = side_circles(faces, links)
    # A row has fewer than MAX_AROUND faces for each corner: around it, or around the edges
    # between corners where there are too many.
    widest = int(np.diff(links.incidence[0]).max())
    most = 3 * min(widest, MAX_AROUND) + 1
    sizes, ring = find_rows(_neighbours, m, most, *around, following, sharing == "vertex", most)
    if len(ring) > MAX_PAIRS:
        raise TooLargeError(
            f"the {m} faces have {len(ring)} neighbours, too many to number",
            hint="cut the mesh into parts",
        )
    return _starts(sizes).astype(np.int32), ring


@compiled
def _corner_means(start, stop, values, faces, means):
    for f in range(start, stop):
        a, b, c = vec.load_corners(faces, f)
        for column in range(values.shape[1]):
            means[f, column] = (values[a, column] + values[b, column] + values[c, column]) / 3.0


def face_centroids(vertices: Floats, faces: Ints) -> Floats:
    """Means (m, 3) of the three corners of each face, file units."""
    return fill_array(_corner_means, (len(faces), 3), vertices, faces)


def centroid_points(vertices: Floats, faces: Ints) -> Floats:
    """The centroids, flat and followed by a zero (3 m + 1,): lanes read four numbers of each."""
    points = np.empty(3 * len(faces) + 1)
    over_ranges(_corner_means, len(faces), vertices, faces, points[:-1].reshape(-1, 3))
    points[-1] = 0.0
    return points


def corner_means(values: Floats, faces: Ints) -> Floats32:
    """Means (m, k) of ``values`` (n, k) over the three corners of each face."""
    means = np.empty((len(faces), values.shape[1]), dtype=np.float32)
    over_ranges(_corner_means, len(faces), values, faces, means)
    return means


@compiled
def _find_near(start, stop, c, ring_start, ring, radii, most, sizes, near):
    """Find faces within a radius, for ``find_rows``; c centroids, flat; ``radii`` (1,) or (m,)."""
    has_own = len(radii) > 1
    none = np.uint32(len(ring_start) - 1)
    seen = np.full(len(ring_start) - 1, none, dtype=np.uint32)
    most = np.uint64(most)
    found = np.empty(np.int64(most + longest_row(np.uint64(0), none, ring_start)), np.uint32)
    filled = np.uint64(start) * most
    for own in range(np.uint64(start), np.uint64(stop)):
        centre = vec.load(c, own)
        radius = radii[own] if has_own else radii[0]
        square_radius = radius * radius
        name = np.uint32(own)
        seen[own] = name
        g = np.uint64(own)
        count = at = np.uint64(0)
        while True:
            for entry in range(np.uint64(ring_start[g]), np.uint64(ring_start[g + ONE])):
                k = np.uint64(ring[entry])
                if seen[k] == name:
                    continue
                seen[k] = name
                # Whether a face is near cannot be predicted, so each is written, and only counted
                # if it is: this needs no branch.
                found[count] = ring[entry]
                count += np.uint64(vec.square_distance(vec.load(c, k), centre) <= square_radius)
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
    """The faces near each face in CSR form: ``near_start`` (m + 1,) int64 and ``near``.

    Parameters
    ----------
    centroids : (m, 3), file units.
    ring_start, ring : the neighbours that the search goes through in CSR form, (m + 1,) and (k,).
    radius : distance between centroids up to which a face is near, file units; or (m,), one for
        each face as the centre.
    most : number of faces at which a search stops; the first ones found are kept.

    A row does not contain its own face.  It is in breadth-first order along ``ring``.
    """
    sizes, near = find_rows(
        _find_near,
        len(centroids),
        most,
        centroids.reshape(-1),
        ring_start.view(np.uint32),
        ring.view(np.uint32),
        np.atleast_1d(np.float64(radius)),
        most,
    )
    return _starts(sizes), near


def _starts(sizes: Ints) -> Longs:
    """Where rows of these sizes (m,) start, and where the last one ends: (m + 1,) int64."""
    starts = np.zeros(len(sizes) + 1, dtype=np.int64)
    np.cumsum(sizes, out=starts[1:])
    return starts


# Flaps: an edge with exactly two faces, and the two vertices that face it.


@compiled
def _flaps(faces, face_start, incident, ring_start, ring, result):
    n = len(ring_start) - 1
    # Positions in ``ring`` only grow, so a slot at or above a row's start belongs to that row.
    slot = np.full(n, -1, dtype=np.int32)
    widest = longest_row(0, n, ring_start)
    count = np.zeros(widest, dtype=np.int32)
    facing = np.empty((widest, 2), dtype=np.int32)
    found = 0
    for i in range(n):
        row = ring_start[i]
        for at in range(row, ring_start[i + 1]):
            slot[ring[at]] = at - row
            count[at - row] = 0
        for at in range(face_start[i], face_start[i + 1]):
            after, before = vec.after_and_before(faces, incident[at], i)
            for k, opposite in ((after, before), (before, after)):
                s = slot[k]
                if count[s] < 2:
                    facing[s, count[s]] = opposite
                count[s] += 1
        for at in range(row, ring_start[i + 1]):
            if ring[at] > i and count[at - row] == 2:
                result[found, 0], result[found, 1] = i, facing[at - row, 0]
                result[found, 2], result[found, 3] = ring[at], facing[at - row, 1]
                found += 1
    return found


def flaps(faces: Ints, links: Connectivity) -> Ints:
    """Each edge (p1, p3) with exactly two faces (p1, p2, p3) and (p1, p3, p4): (e, 4) int32.

    p1 < p3, and the rows are in ascending order of p1.  Boundary and non-manifold edges are left
    out.  The two faces may have any winding; as written here it is consistent.  ``faces`` (m, 3)
    are those that ``links`` were made from.
    """
    # Each such edge is in the one-rings of both its ends.
    result = np.empty((len(links.ring) // 2, 4), dtype=np.int32)
    return result[: _flaps(faces, *links.incidence, *links.one_ring, result)].copy()


@compiled
def _dihedral_angles(start, stop, x, corners, angles):
    for e in range(start, stop):
        p1, p2, p3, p4 = corners[e, 0], corners[e, 1], corners[e, 2], corners[e, 3]
        _, _, m = vec.edges_and_normal(x, p1, p2, p3)
        _, _, n = vec.edges_and_normal(x, p1, p3, p4)
        angles[e] = np.arctan2(vec.norm(vec.cross(m, n)), vec.dot(m, n))


def dihedral_angles(vertices: Floats, corners: Ints) -> Floats:
    """Angle (e,) between the normals of the two faces of each flap (e, 4), 0 to pi radians; zero
    beside a degenerate face."""
    return fill_array(_dihedral_angles, len(corners), vertices, corners)


# Guides (Zhang, Deng, Zhang, Bouaziz and Liu 2015): the mean normal of the most consistent patch.
#
# The patch of a face is the face and those that share a vertex with it.  Its score is greater the
# less its normals agree,
#
#     H = max |n_a - n_b|  max |n_e - n_e'| / (epsilon + sum |n_e - n_e'|),
#
# the first maximum over all pairs of its faces, the others and the sum over the pairs that share an
# edge.  The second factor is near one where one edge has all the bend: a patch across a sharp edge.

EPSILON = 1e-9


@compiled
def _inner(start, stop, ring_start, ring, first_pair, pairs, most, sizes, inner):
    """Find the pairs, flat, of which both faces are in a patch, for ``find_rows``; without
    branches, like ``_neighbours``."""
    member = np.full(len(ring_start) - 1, len(ring_start) - 1, dtype=np.uint32)
    filled = np.uint64(start * most)
    for f in range(np.uint64(start), np.uint64(stop)):
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
    """|n_a - n_b| of each pair; zero if either has no normal.  n normals, flat like the pairs."""
    for pair in range(np.uint64(start), np.uint64(stop)):
        a, b = vec.load(n, pairs[TWO * pair]), vec.load(n, pairs[TWO * pair + ONE])
        jumps[pair] = 0.0 if vec.is_zero(a) | vec.is_zero(b) else vec.norm(vec.subtract(a, b))


@compiled
def _score(start, stop, n, areas, ring_start, ring, jumps, inner_start, inner, scores, means):
    """Score and area-weighted mean normal of each patch; infinity if the mean vanishes.

    n normals, flat like the means.  Faces without an area do not count.  Indices are unsigned, so
    that they need no test of their sign.
    """
    room = np.int64(longest_row(start, stop, ring_start)) + 1
    x, y, z = np.empty(room), np.empty(room), np.empty(room)
    for f in range(np.uint64(start), np.uint64(stop)):
        row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
        total, weight, count = vec.ORIGIN, 0.0, np.uint64(0)
        for at in range(row, end + ONE):
            k = np.uint64(ring[at - ONE]) if at > row else f
            normal, area = vec.load(n, k), areas[k]
            x[count], y[count], z[count] = normal
            count += np.uint64(area > 0.0)
            total = vec.add_scaled(total, area, normal)
            weight += area
        square = 0.0
        for k in range(count):
            own = x[k], y[k], z[k]
            for at in range(np.uint64(k) + ONE, count):
                square = max(square, vec.square_distance((x[at], y[at], z[at]), own))
        greatest = sum_of_jumps = 0.0
        for at in range(np.uint64(inner_start[f]), np.uint64(inner_start[f + ONE])):
            jump = jumps[inner[at]]
            greatest = max(greatest, jump)
            sum_of_jumps += jump
        length = vec.norm(total)
        if length <= VANISHED * weight:
            scores[f] = np.inf
            continue
        scores[f] = np.sqrt(square) * greatest / (EPSILON + sum_of_jumps)
        vec.store(means, f, vec.divide(total, length))


@compiled
def _choose(start, stop, n, ring_start, ring, scores, means, guides):
    """n normals, flat as the means and guides."""
    for f in range(np.uint64(start), np.uint64(stop)):
        best = np.uint64(f)
        least = scores[f]
        for at in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
            k = np.uint64(ring[at])
            score = scores[k]
            # Which patch is best cannot be predicted, so there is no branch.
            best = k if score < least else best
            least = min(least, score)
        vec.store(guides, f, vec.load(means, best) if least < np.inf else vec.load(n, f))


@dataclass(frozen=True, eq=False)
class Patches:
    """The patches of a mesh."""

    rows: tuple[Ints, Ints]  # faces of each patch without its centre in CSR form, (m + 1,) and (k,)
    edges: tuple[Ints, Ints]  # faces that share an edge with each face, in CSR form
    pairs: Ints  # (e, 2), the faces that share an edge, each pair once, the lower number first
    inner: tuple[Longs, Ints]  # pairs of which both faces are in each patch, in CSR form

    def guides(self, normals: Floats, areas: Floats) -> Floats:
        """Guide normals (m, 3) for face ``normals`` (m, 3) and ``areas`` (m,).

        The guide of a face is the area-weighted mean normal of the patch with the lowest score
        among those centred at the face or at a face that shares a vertex with it; of equal ones at
        the face itself, then the first in its row.  Faces whose normal is zero do not count.  If no
        patch has a mean normal, the guide is the face's own normal.
        """
        m = len(normals)
        flat = normals.reshape(-1)
        pairs = self.pairs.reshape(-1).view(np.uint32)
        jumps = fill_array(_jumps, len(self.pairs), flat, pairs)
        rows = [part.view(np.uint32) for part in self.rows]
        inner = self.inner[0].view(np.uint64), self.inner[1].view(np.uint32)
        scores, means = np.empty(m), np.empty(3 * m)
        areas = usable_areas(normals, areas)
        over_ranges(_score, m, flat, areas, *rows, jumps, *inner, scores, means)
        guides = np.empty((m, 3))
        over_ranges(_choose, m, flat, *rows, scores, means, guides.reshape(-1))
        return guides


def patches(faces: Ints, links: Connectivity) -> Patches:
    """The patches of ``faces`` (m, 3), those that ``links`` were made from.

    Raises TooLargeError as ``face_rings`` does.
    """
    return links.kept("patches", lambda: _find_patches(faces, links))


def _find_patches(faces: Ints, links: Connectivity) -> Patches:
    m = len(faces)
    rows = face_rings(faces, links, "vertex")
    edge_start, edge_ring = edges = face_rings(faces, links, "edge")
    # The pairs f < g of neighbours in the order of the rows.
    f = np.repeat(np.arange(m, dtype=np.int32), np.diff(edge_start))
    is_first = edge_ring > f
    pairs = np.column_stack([f[is_first], edge_ring[is_first]])
    first_pair = np.append(0, np.cumsum(is_first))[edge_start].astype(np.uint32)
    # Each pair of a patch is an edge of two of its faces.
    widest, across = int(np.diff(rows[0]).max()), int(np.diff(edge_start).max())
    most = (widest + 1) * across // 2 + 1
    known = [part.view(np.uint32) for part in rows]
    numbered = first_pair, pairs.reshape(-1).view(np.uint32)
    sizes, inner = find_rows(_inner, m, most, *known, *numbered, most)
    return Patches(rows, edges, pairs, (_starts(sizes), inner))
