"""Connectivity: one-rings, faces around vertices, boundary edges, components, winding.

One-rings are stored in CSR form: the neighbours of vertex i, each once, are
``ring[ring_start[i]:ring_start[i + 1]]``.  If all faces around i are consistently wound and closed,
they are the vertices that follow i in these faces, in their order; else they are ordered as the
faces name them.
"""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Ints, Longs
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import MARKING_THREADS, over_ranges
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO
from msal_cli.light_dataclass import dataclass

Kept = TypeVar("Kept")

KEPT_FACES = 100_000
"""Largest mesh, in faces, that caches results about its faces, about 200 bytes for each."""


@compiled
def _index_rows(keys, per_row, per_column, starts, places):
    for row in range(len(keys)):
        for column in range(keys.shape[1]):
            starts[keys[row, column] + 1] += 1
    for key in range(len(starts) - 1):
        starts[key + 1] += starts[key]
    # Filling advances each row's start to its end; the shift afterwards restores it.
    for row in range(len(keys)):
        for column in range(keys.shape[1]):
            key = keys[row, column]
            places[starts[key]] = row * per_row + column * per_column
            starts[key] += 1
    for key in range(len(starts) - 1, 0, -1):
        starts[key] = starts[key - 1]
    starts[0] = 0


def index_rows(count: int, keys: Ints, per_row: int = 1, per_column: int = 0) -> tuple[Ints, Ints]:
    """The occurrences of each of ``count`` numbers in ``keys`` (m, k), in CSR form.

    Returns where the rows start, (count + 1,), and the occurrences (m k,), ascending: the row in
    ``keys`` times ``per_row`` plus the column times ``per_column``.
    """
    starts = np.zeros(count + 1, dtype=np.int32)
    places = np.empty(keys.size, dtype=np.int32)
    _index_rows(keys, per_row, per_column, starts, places)
    return starts, places


@compiled
def _closed_rings(start, stop, faces, face_start, incident, ring, opened):
    """Fill the one-rings of vertices whose faces are consistently wound and form closed fans.

    The neighbours are the vertices that follow i in its faces, in the order of these faces.
    ``opened[i]`` becomes True for all other vertices, whose entries are then invalid.
    """
    # A vertex that follows i in a face is marked i, then, if it also precedes i, -2 - i.
    mark = np.full(len(opened), -1, dtype=np.int32)
    for i in range(start, stop):
        row = face_start[i]
        end = face_start[i + 1]
        is_closed = True
        for at in range(row, end):
            f = np.uint64(incident[at])
            after, _ = vec.after_and_before(faces, f, i)
            ring[at] = after
            is_closed &= mark[np.uint64(after)] != i
            mark[np.uint64(after)] = i
        for at in range(row, end):
            f = np.uint64(incident[at])
            _, before = vec.after_and_before(faces, f, i)
            is_closed &= mark[np.uint64(before)] == i
            mark[np.uint64(before)] = -2 - i
        opened[i] = not is_closed


@compiled
def _open_ring(faces, face_start, incident, i, row, slot, ring, uses):
    """Fill the one-ring of any vertex from ``row`` on; returns its end.

    ``uses`` counts how often each edge leaves the vertex, and how often it arrives.
    """
    filled = row
    for at in range(face_start[i], face_start[i + 1]):
        after, before = vec.after_and_before(faces, incident[at], i)
        # Positions only grow, so a slot at or above the row's start belongs to this row.
        for side in range(2):
            k = after if side == 0 else before
            if slot[k] < row:
                slot[k] = filled
                ring[filled] = k
                uses[filled - row, 0] = 0
                uses[filled - row, 1] = 0
                filled += 1
            uses[slot[k] - row, side] += 1
    return filled


@compiled
def _open_rings(faces, face_start, incident, opened, closed, ring_start, ring, boundary):
    """All one-rings if some are not closed; ``closed`` has the others, in the order of their faces.

    Counts (entries, boundary, inconsistent, non-manifold) edges and marks the boundary.
    """
    n = len(opened)
    slot = np.full(n, -1, dtype=np.int32)
    widest = 0
    for i in range(n):
        if opened[i]:
            widest = max(widest, face_start[i + 1] - face_start[i])
    uses = np.empty((2 * widest, 2), dtype=np.int32)
    open_edges = twisted_edges = crowded_edges = 0
    filled = 0
    for i in range(n):
        row = filled
        if not opened[i]:
            for at in range(face_start[i], face_start[i + 1]):
                ring[filled] = closed[at]
                filled += 1
            ring_start[i + 1] = filled
            continue
        filled = _open_ring(faces, face_start, incident, i, row, slot, ring, uses)
        ring_start[i + 1] = filled
        for at in range(row, filled):
            out, into = uses[at - row, 0], uses[at - row, 1]
            if out + into == 1:
                boundary[i] = True
            # An edge between an open vertex and a closed one has two consistently wound faces.
            if ring[at] > i:
                if out + into == 1:
                    open_edges += 1
                elif out + into > 2:
                    crowded_edges += 1
                elif out != 1:
                    twisted_edges += 1
    return filled, open_edges, twisted_edges, crowded_edges


@dataclass(frozen=True, eq=False)
class Connectivity:
    """Connectivity of a triangle mesh."""

    faces: Ints  # (m, 3), the triangles themselves
    ring_start: Ints  # ring_start, ring: one-rings in CSR form, (n + 1,) and (sum of valences,)
    ring: Ints
    boundary: Flags  # (n,) bool, True for the ends of boundary edges
    boundary_edges: int  # edges with one face
    inconsistent_edges: int  # edges with two faces of opposite winding
    non_manifold_edges: int  # edges with more than two faces

    @property
    def has_ring(self) -> Flags:
        """(n,) bool, True where a vertex has neighbours."""
        is_used: Flags = self.ring_start[1:] > self.ring_start[:-1]
        return is_used

    @property
    def one_ring(self) -> tuple[Ints, Ints]:
        """The one-rings in CSR form: where they start (n + 1,), and the neighbours."""
        return self.ring_start, self.ring

    def rings_of(self, vertices: Ints | Longs) -> tuple[Longs, Longs, Longs]:
        """The concatenated one-rings of vertices (c,): for each neighbour (k,) the index of its
        vertex into ``vertices``, and its own vertex number; and the valences (c,)."""
        starts = self.ring_start[vertices]
        counts = (self.ring_start[vertices + 1] - starts).astype(np.int64)
        rows = np.repeat(np.arange(len(vertices)), counts)
        at = np.arange(len(rows)) + np.repeat(starts - (np.cumsum(counts) - counts), counts)
        return rows, self.ring[at].astype(np.int64), counts

    @functools.cached_property
    def incidence(self) -> tuple[Ints, Ints]:
        """The faces around each vertex in CSR form: row starts (n + 1,), and the faces (3 m,)."""
        return index_rows(len(self.ring_start) - 1, self.faces)

    def release_incidence(self) -> None:
        """Free the memory of ``incidence``; it is computed anew when needed."""
        self.__dict__.pop("incidence", None)

    def kept(self, name: str, made: Callable[[], Kept]) -> Kept:
        """The result of ``made``, cached by ``name`` if the mesh is small.

        A search for the best setting runs many filters on the same small mesh, and without a cache
        results that depend only on its faces would be half of the work.  For large meshes the cache
        would take too much memory.
        """
        if len(self.faces) > KEPT_FACES:
            return made()
        if name not in self._kept:
            self._kept[name] = made()
        known: Kept = self._kept[name]
        return known

    @functools.cached_property
    def _kept(self) -> dict[str, Any]:
        return {}


def connectivity(n_vertices: int, faces: Ints) -> Connectivity:
    """Connectivity of ``faces`` (m, 3) with three different vertices each."""
    face_start, incident = index_rows(n_vertices, faces)
    ring = np.empty(len(incident), dtype=np.int32)
    opened = np.empty(n_vertices, dtype=bool)
    rows = faces, face_start, incident, ring, opened
    over_ranges(_closed_rings, n_vertices, *rows, most=MARKING_THREADS)
    boundary = np.zeros(n_vertices, dtype=bool)
    if not opened.any():
        return Connectivity(faces, face_start, ring, boundary, 0, 0, 0)
    closed = ring
    ring_start = np.zeros(n_vertices + 1, dtype=np.int32)
    # Two entries a face are always enough; pages that are not written to take no memory.
    most = len(incident) + int((face_start[1:] - face_start[:-1])[opened].sum())
    ring = np.empty(most, dtype=np.int32)
    total, *counts = _open_rings(
        faces, face_start, incident, opened, closed, ring_start, ring, boundary
    )
    return Connectivity(faces, ring_start, ring[:total], boundary, *map(int, counts))


@compiled
def _circles(start, stop, faces, face_start, incident, following):
    """Link each side of a face to the next side along the same edge, in a cycle.

    Side 3 f + c of face f runs from its corner c to the next one; that of a boundary edge is linked
    to itself.  A range of vertices handles the edges from them to vertices of higher number.  All
    arrays are flat and unsigned, so that indices need no test of their sign.
    """
    n = len(face_start) - 1
    stamp = np.full(n, n, dtype=np.uint32)
    first = np.empty_like(stamp)
    last = np.empty_like(stamp)
    for i in range(np.uint64(start), np.uint64(stop)):
        for at in range(np.uint64(face_start[i]), np.uint64(face_start[i + ONE])):
            side = THREE * incident[at]
            a, b, c = faces[side], faces[side + ONE], faces[side + TWO]
            # Without branches: which corner of a face a vertex is cannot be predicted.
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


def side_circles(faces: Ints, links: Connectivity) -> NDArray[np.uint32]:
    """For each side of ``faces`` (m, 3) the next one along its edge, (3 m,); see ``_circles``."""
    following = np.empty(3 * len(faces), dtype=np.uint32)
    around = [array.reshape(-1).view(np.uint32) for array in (faces, *links.incidence)]
    over_ranges(_circles, len(links.boundary), *around, following, most=MARKING_THREADS)
    return following


def boundary_curves(faces: Ints, links: Connectivity) -> tuple[Ints, Ints]:
    """The neighbours of each vertex along boundary edges, in CSR form.

    Parameters
    ----------
    faces : (m, 3), the faces that ``links`` were made from.

    Returns
    -------
    row_start, row : (n + 1,) and (2 x boundary edges,), like a one-ring; empty for inner vertices.
    """
    corners, following = faces.reshape(-1), side_circles(faces, links)
    # The side of a boundary edge is linked to itself.
    starts = np.flatnonzero(following == np.arange(len(following), dtype=np.uint32))
    ends = starts + np.where(starts % 3 == 2, -2, 1)
    here, there = np.concatenate([starts, ends]), np.concatenate([ends, starts])
    row_start = np.zeros(len(links.boundary) + 1, dtype=np.int32)
    np.cumsum(np.bincount(corners[here], minlength=len(links.boundary)), out=row_start[1:])
    # In the order in which the faces name them.
    return row_start, corners[there[np.lexsort((there, corners[here]))]]


def averaging_ring(faces: Ints, links: Connectivity, boundary: str) -> tuple[Ints, Ints]:
    """The one-rings (n + 1,) and (...,) to average over, by a rule for boundary vertices.

    ``boundary`` is ``"free"``: all neighbours of a vertex; ``"fixed"``: a boundary vertex has an
    empty row and stays; or ``"curve"``: a boundary vertex is averaged with its neighbours along
    boundary edges only, so that the boundary is smoothed as a curve and is not drawn inwards.
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


@compiled
def _root(parent, item):
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@compiled
def _join(parent, root, item):
    """Join the component of a root with that of another item; returns its root."""
    other = _root(parent, item)
    if other == root:
        return root
    # The lower number becomes the root, so that the result is unique.
    parent[max(root, other)] = min(root, other)
    return min(root, other)


@compiled
def _count_components(faces, used, parent):
    for i in range(len(parent)):
        parent[i] = i
    for f in range(len(faces)):
        a, b, c = vec.load(faces, f)
        if parent[a] != parent[b] or parent[b] != parent[c]:
            _join(parent, _join(parent, _root(parent, a), b), c)
    components = 0
    for i in range(len(parent)):
        components += used[i] and parent[i] == i
    return components


def count_components(n_vertices: int, faces: Ints, used: Flags) -> int:
    """Number of connected components among the vertices that ``used`` (n,) marks."""
    return int(_count_components(faces, used, np.empty(n_vertices, dtype=np.int32)))


def component_labels(n_vertices: int, faces: Ints) -> Ints:
    """For each vertex (n,) the lowest vertex number in its connected component."""
    parent = np.empty(n_vertices, dtype=np.int32)
    _count_components(faces, np.ones(n_vertices, dtype=bool), parent)
    return _find_roots(parent)


def _find_roots(parent: Ints) -> Ints:
    while not np.array_equal(above := parent[parent], parent):
        parent = above
    return parent


@compiled
def _join_faces(corners, following, parent):
    for side in range(len(corners)):
        other = np.int64(following[side])
        # Each edge with exactly two faces once: its two sides follow each other.
        if other > side and following[other] == side:
            a, b = 2 * (side // 3), 2 * (other // 3)
            is_against = np.int64(corners[side] == corners[other])
            _join(parent, _root(parent, a), b + is_against)
            _join(parent, _root(parent, a + 1), b + 1 - is_against)


def faces_to_flip(faces: Ints, links: Connectivity) -> tuple[Flags, int]:
    """The faces to flip so that the winding of each orientable component is consistent.

    Faces are connected across edges with exactly two faces.  In each component the smaller number
    of faces is flipped; a component without a consistent winding (a Moebius band) is not changed.

    Returns
    -------
    flip : (m,) bool.
    unorientable : number of components that have no consistent winding.
    """
    # Face f is two items, 2 f as it is and 2 f + 1 flipped.  Items of consistent winding are
    # joined, so a component is joined with its flipped self if it has no consistent winding.
    parent = np.arange(2 * len(faces), dtype=np.int32)
    _join_faces(faces.reshape(-1).view(np.uint32), side_circles(faces, links), parent)
    kept, flipped = _find_roots(parent).reshape(-1, 2).T
    counts = np.bincount(kept, minlength=len(parent))
    # Of two halves that one is flipped that does not have the first face.
    flip = counts[kept] < counts[flipped] + kept % 2
    is_first = kept == np.arange(0, len(parent), 2)
    return flip, int(np.count_nonzero(is_first & (kept == flipped)))
