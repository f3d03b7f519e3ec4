"""Who neighbours whom: welding, one-rings, edge counts, winding and components.

A one-ring is kept in compressed rows: the neighbours of vertex i are
``ring[ring_start[i]:ring_start[i + 1]]``, each once: in the order of the faces around i those that
follow it, where all faces are wound one way and close; else as these faces name them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.parallel import MARKING_THREADS, over_ranges

Kept = TypeVar("Kept")

KEPT_FACES = 100_000
"""Faces up to which a mesh keeps what was found out about its faces, 200 bytes each or so."""


@compiled
def _hashed(a, b, c):
    """A hash of three 64-bit patterns of floating-point numbers; minus zero counts as zero."""
    minus_zero = np.uint64(0x8000000000000000)
    a = np.uint64(0) if a == minus_zero else a
    b = np.uint64(0) if b == minus_zero else b
    c = np.uint64(0) if c == minus_zero else c
    h = a * np.uint64(0x9E3779B97F4A7C15)
    h ^= h >> np.uint64(29)
    h = (h + b) * np.uint64(0xBF58476D1CE4E5B9)
    h ^= h >> np.uint64(32)
    h = (h + c) * np.uint64(0x94D049BB133111EB)
    return h ^ (h >> np.uint64(31))


_BLOCK_ROWS = 512


@compiled
def _hashes(bits, start, stop, mask, hashes):
    for i in range(start, stop):
        hashes[i - start] = _hashed(bits[i, 0], bits[i, 1], bits[i, 2]) & mask


@compiled
def _alike_perhaps(bits, used, seen, again, candidates):
    """Rows whose hash another row has too: the only ones that can equal another; their number.

    ``seen`` and ``again`` are bit sets, a power of two words long.  Those of millions of rows fit
    no cache: the words of a block of rows are read first, all at once, so that many waits for
    memory are one.
    """
    mask = np.uint64(64 * len(seen) - 1)
    one, six, low = np.uint64(1), np.uint64(6), np.uint64(63)
    hashes = np.empty(_BLOCK_ROWS, dtype=np.uint64)
    touched = np.uint64(0)
    repeats = False
    for start in range(0, len(used), _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, len(used))
        _hashes(bits, start, stop, mask, hashes)
        for at in range(stop - start):
            touched |= seen[hashes[at] >> six]
        for at in range(stop - start):
            word = hashes[at] >> six
            bit = (one if used[start + at] else np.uint64(0)) << (hashes[at] & low)
            if seen[word] & bit:
                again[word] |= bit
                repeats = True
            seen[word] |= bit
    # Of no use, but what is read for nothing would not be read; the last place is to spare.
    candidates[len(used)] = np.int64(touched & one)
    count = 0
    if not repeats:
        return count
    for start in range(0, len(used), _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, len(used))
        _hashes(bits, start, stop, mask, hashes)
        for at in range(stop - start):
            candidates[count] = start + at
            is_one = (again[hashes[at] >> six] >> (hashes[at] & low)) & one
            count += 1 if is_one and used[start + at] else 0
    return count


@compiled
def _welded(rows, bits, candidates, table, first):
    mask = len(table) - 1
    merged = 0
    for at in range(len(candidates)):
        i = candidates[at]
        slot = np.int64(_hashed(bits[i, 0], bits[i, 1], bits[i, 2]) >> np.uint64(20)) & mask
        while True:
            k = table[slot]
            if k < 0:
                table[slot] = i
                break
            if rows[k, 0] == rows[i, 0] and rows[k, 1] == rows[i, 1] and rows[k, 2] == rows[i, 2]:
                first[i] = k
                merged += 1
                break
            slot = (slot + 1) & mask
    return merged


def first_alike(rows: Floats, used: NDArray[np.bool_]) -> tuple[Ints, int]:
    """For each row of (n, 3) numbers the lowest-numbered equal row, (n,) int32, and how many rows
    equal one before them.

    Minus zero equals zero, and NaN nothing.  Rows outside ``used`` (n,) equal nothing and stand
    for themselves.
    """
    n = len(rows)
    rows = np.ascontiguousarray(rows)
    bits = rows.view(np.uint64)
    # Sixteen bits a row: among different rows one in sixteen has another's hash.
    words = 1 << max(0, (n // 4).bit_length())
    seen, again = np.zeros(words, dtype=np.uint64), np.zeros(words, dtype=np.uint64)
    first = np.arange(n, dtype=np.int32)
    candidates = np.empty(n + 1, dtype=np.int32)
    count = _alike_perhaps(bits, used, seen, again, candidates)
    if not count:
        return first, 0
    # Twice the rows at least, so that probing stays short.
    table = np.full(1 << max(4, (2 * count).bit_length()), -1, dtype=np.int32)
    return first, int(_welded(rows, bits, candidates[:count], table, first))


@compiled
def _marked(items, marks):
    for at in range(len(items)):
        marks[items[at]] = True


def used_vertices(n_vertices: int, faces: Ints) -> NDArray[np.bool_]:
    """(n,) bool, True for every vertex that a face (m, 3) names."""
    used = np.zeros(n_vertices, dtype=bool)
    _marked(np.ascontiguousarray(faces).reshape(-1), used)
    return used


@compiled
def _repeated_corners(faces, repeated):
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        repeated[f] = (a == b) | (b == c) | (c == a)


def repeated_corners(faces: Ints) -> NDArray[np.bool_]:
    """(m,) bool, True for every face (m, 3) that names a vertex twice."""
    repeated = np.empty(len(faces), dtype=bool)
    _repeated_corners(np.ascontiguousarray(faces), repeated)
    return repeated


def welded(vertices: Floats, faces: Ints) -> Ints:
    """For each vertex the lowest-numbered vertex at exactly its position, (n,) int32.

    Minus zero equals zero.  Vertices that no face uses weld with nothing and stand for themselves.
    """
    return first_alike(vertices, used_vertices(len(vertices), faces))[0]


@compiled
def _numbered(left, right, table, number, first):
    mask = len(table) - 1
    found = 0
    for i in range(len(left)):
        a, b = left[i], right[i]
        h = np.uint64(np.uint32(a)) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
        h = (h + np.uint64(np.uint32(b))) * np.uint64(0xBF58476D1CE4E5B9)
        h ^= h >> np.uint64(32)
        slot = np.int64(h & np.uint64(mask))
        while True:
            k = table[slot]
            if k < 0:
                table[slot] = found
                number[i] = found
                first[found] = i
                found += 1
                break
            if left[first[k]] == a and right[first[k]] == b:
                number[i] = k
                break
            slot = (slot + 1) & mask
    return found


def numbered(left: Ints, right: Ints) -> tuple[Ints, Ints]:
    """Give each different pair (left, right) a number, in order of appearance.

    Both arguments are (n,) int32.  Returns the number of every pair, (n,), and the first place of
    every number, (k,).
    """
    table = np.full(1 << max(4, (2 * len(left)).bit_length()), -1, dtype=np.int32)
    number = np.empty(len(left), dtype=np.int32)
    first = np.empty(len(left), dtype=np.int32)
    found = _numbered(left, right, table, number, first)
    return number, first[:found].copy()


@compiled
def _incident_faces(faces, face_start, incident):
    for f in range(len(faces)):
        for corner in range(3):
            face_start[faces[f, corner] + 1] += 1
    for i in range(len(face_start) - 1):
        face_start[i + 1] += face_start[i]
    # Filling advances each row's start to its end; the shift afterwards restores it.
    for f in range(len(faces)):
        for corner in range(3):
            i = faces[f, corner]
            incident[face_start[i]] = f
            face_start[i] += 1
    for i in range(len(face_start) - 1, 0, -1):
        face_start[i] = face_start[i - 1]
    face_start[0] = 0


@compiled
def _neighbours_in_face(faces, f, i):
    """The vertex after i and the vertex before i in face f."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    if a == i:
        return b, c
    if b == i:
        return c, a
    return a, b


@compiled
def _closed_rings(start, stop, faces, face_start, incident, ring, opened):
    """Fill the rings of vertices whose faces close one circle or several, wound one way.

    They are the vertices that follow i in its faces, in the places of these faces.  ``opened[i]``
    becomes True for all other vertices; what stands in their places is of no use.
    """
    # Who follows vertex i is marked i, and, once it has been found to go before it too, -2 - i.
    mark = np.empty(len(opened), dtype=np.int32)
    for i in range(len(mark)):
        mark[i] = -1
    for i in range(start, stop):
        row = face_start[i]
        end = face_start[i + 1]
        is_closed = True
        for at in range(row, end):
            f = np.uint64(incident[at])
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            # Without branches: which corner of a face a vertex is cannot be foreseen.
            after = b if a == i else (c if b == i else a)
            ring[at] = after
            is_closed &= mark[np.uint64(after)] != i
            mark[np.uint64(after)] = i
        for at in range(row, end):
            f = np.uint64(incident[at])
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            before = np.uint64(c if a == i else (a if b == i else b))
            is_closed &= mark[before] == i
            mark[before] = -2 - i
        opened[i] = not is_closed


@compiled
def _open_ring(faces, face_start, incident, i, row, slot, ring, uses):
    """Fill the ring of any vertex from ``row`` on; its end.

    ``uses`` tells how often each edge leaves the vertex, and how often it arrives.
    """
    filled = row
    for at in range(face_start[i], face_start[i + 1]):
        after, before = _neighbours_in_face(faces, incident[at], i)
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
    """All rings where some are no circles; ``closed`` has the others, in the places of their faces.

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
            # An edge between an open vertex and a closed one has two faces, wound one way.
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
    """Neighbourhoods of a triangle mesh.

    Attributes
    ----------
    faces : (m, 3), the triangles themselves.
    ring_start, ring : rows of the one-rings, (n + 1,) and (sum of valences,).
    boundary : (n,) bool, True at the ends of an edge that has one face only.
    boundary_edges : edges with one face.
    inconsistent_edges : edges with two faces that run through it in the same direction.
    non_manifold_edges : edges with more than two faces.
    """

    faces: Ints
    ring_start: Ints
    ring: Ints
    boundary: NDArray[np.bool_]
    boundary_edges: int
    inconsistent_edges: int
    non_manifold_edges: int

    @property
    def has_ring(self) -> NDArray[np.bool_]:
        """(n,) bool, True where a vertex has neighbours."""
        is_used: NDArray[np.bool_] = self.ring_start[1:] > self.ring_start[:-1]
        return is_used

    @property
    def one_ring(self) -> tuple[Ints, Ints]:
        """Rows of the one-rings: where they start (n + 1,), and the neighbours."""
        return self.ring_start, self.ring

    @functools.cached_property
    def incidence(self) -> tuple[Ints, Ints]:
        """Rows of the faces around each vertex: where they start (n + 1,), and the faces (3 m,)."""
        return incidence(len(self.ring_start) - 1, self.faces)

    def kept(self, name: str, made: Callable[[], Kept]) -> Kept:
        """What ``made`` gives, from the first such call on; but only for small meshes.

        Whoever looks for the best setting runs many over the same small mesh, and what follows
        from its faces is then half of the work.  With large meshes it would take memory from
        whatever comes after.
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

    @property
    def face_start(self) -> Ints:
        """(n + 1,), where the row of each vertex starts in ``incident_faces``."""
        return self.incidence[0]

    @property
    def incident_faces(self) -> Ints:
        """(3 m,), the faces around each vertex, row by row."""
        return self.incidence[1]


def incidence(n_vertices: int, faces: Ints) -> tuple[Ints, Ints]:
    """Rows of the faces around each vertex, (n + 1,) and (3 m,), for ``faces`` (m, 3)."""
    face_start = np.zeros(n_vertices + 1, dtype=np.int32)
    incident = np.empty(3 * len(faces), dtype=np.int32)
    _incident_faces(faces, face_start, incident)
    return face_start, incident


def connectivity(n_vertices: int, faces: Ints) -> Connectivity:
    """Neighbourhoods of ``faces`` (m, 3), which must name three different vertices each."""
    face_start, incident = incidence(n_vertices, faces)
    ring = np.empty(len(incident), dtype=np.int32)
    opened = np.empty(n_vertices, dtype=bool)
    rows = faces, face_start, incident, ring, opened
    over_ranges(_closed_rings, n_vertices, *rows, most=MARKING_THREADS)
    boundary = np.zeros(n_vertices, dtype=bool)
    if not opened.any():
        return Connectivity(faces, face_start, ring, boundary, 0, 0, 0)
    closed = ring
    ring_start = np.zeros(n_vertices + 1, dtype=np.int32)
    # Two entries a face are enough for any faces; what is not written to takes no memory.
    most = len(incident) + int((face_start[1:] - face_start[:-1])[opened].sum())
    ring = np.empty(most, dtype=np.int32)
    total, *counts = _open_rings(
        faces, face_start, incident, opened, closed, ring_start, ring, boundary
    )
    return Connectivity(faces, ring_start, ring[:total], boundary, *map(int, counts))


@compiled
def _duplicates(corners, table, duplicate):
    mask = len(table) - 1
    found = 0
    for f in range(len(corners)):
        a, b, c = corners[f, 0], corners[f, 1], corners[f, 2]
        h = np.uint64(a) * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
        h = (h + np.uint64(b)) * np.uint64(0xBF58476D1CE4E5B9)
        h ^= h >> np.uint64(32)
        h = (h + np.uint64(c)) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
        slot = np.int64(h & np.uint64(mask))
        while True:
            k = table[slot]
            if k < 0:
                table[slot] = f
                break
            if corners[k, 0] == a and corners[k, 1] == b and corners[k, 2] == c:
                duplicate[f] = True
                found += 1
                break
            slot = (slot + 1) & mask
    return found


def duplicate_faces(faces: Ints) -> NDArray[np.bool_]:
    """True (m,) for every face whose three vertices, in any order, an earlier face has too."""
    table = np.full(1 << max(4, (2 * len(faces)).bit_length()), -1, dtype=np.int32)
    duplicate = np.zeros(len(faces), dtype=bool)
    _duplicates(np.sort(faces, axis=1), table, duplicate)
    return duplicate


@compiled
def _root(parent, item):
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@compiled
def _count_components(faces, used, parent):
    components = 0
    for i in range(len(parent)):
        parent[i] = i
        if used[i]:
            components += 1
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if parent[a] == parent[b] and parent[b] == parent[c]:
            continue
        first = _root(parent, a)
        for corner in range(1, 3):
            other = _root(parent, faces[f, corner])
            if other != first:
                components -= 1
                # The lower number becomes the root, so that the forest does not depend on luck.
                if other < first:
                    parent[first] = other
                    first = other
                else:
                    parent[other] = first
    return components


def count_components(n_vertices: int, faces: Ints, used: NDArray[np.bool_]) -> int:
    """Number of connected parts among the vertices that ``used`` (n,) marks."""
    return int(_count_components(faces, used, np.empty(n_vertices, dtype=np.int32)))


def component_labels(n_vertices: int, faces: Ints) -> Ints:
    """For each vertex (n,) the lowest number of a vertex in its connected part."""
    labels = np.empty(n_vertices, dtype=np.int32)
    _count_components(faces, np.ones(n_vertices, dtype=bool), labels)
    while (above := labels[labels]).tobytes() != labels.tobytes():
        labels = above
    return labels


@compiled
def _root_and_parity(parent, parity, face):
    """Root of a face and whether the face is wound against it; paths are shortened."""
    root = face
    against = False
    while parent[root] != root:
        against ^= parity[root]
        root = parent[root]
    here, left = face, against
    while parent[here] != root and here != root:
        up, was = parent[here], parity[here]
        parent[here] = root
        parity[here] = left
        left ^= was
        here = up
    return root, against


@compiled
def _to_flip(faces, face_start, incident, ring_start, flip):
    n = len(ring_start) - 1
    m = len(faces)
    parent = np.arange(m)
    parity = np.zeros(m, dtype=np.bool_)
    twisted = np.zeros(m, dtype=np.bool_)
    slot = np.full(n, -1, dtype=np.int32)
    stamp = np.full(n, -1, dtype=np.int32)
    widest = 0
    for i in range(n):
        widest = max(widest, ring_start[i + 1] - ring_start[i])
    count = np.zeros(widest, dtype=np.int32)
    face_of = np.empty((widest, 2), dtype=np.int32)
    leaves = np.empty((widest, 2), dtype=np.bool_)
    for i in range(n):
        used = 0
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            after, before = _neighbours_in_face(faces, f, i)
            for side in range(2):
                k = after if side == 0 else before
                if k < i:
                    continue
                if stamp[k] != i:
                    stamp[k] = i
                    slot[k] = used
                    count[used] = 0
                    used += 1
                s = slot[k]
                if count[s] < 2:
                    face_of[s, count[s]] = f
                    leaves[s, count[s]] = side == 0
                count[s] += 1
        for s in range(used):
            if count[s] != 2:
                continue
            same = leaves[s, 0] == leaves[s, 1]
            one, one_against = _root_and_parity(parent, parity, face_of[s, 0])
            two, two_against = _root_and_parity(parent, parity, face_of[s, 1])
            if one == two:
                if (one_against ^ two_against) != same:
                    twisted[one] = True
            else:
                low, high = min(one, two), max(one, two)
                parent[high] = low
                parity[high] = one_against ^ two_against ^ same
                twisted[low] |= twisted[high]
    against = np.zeros(m, dtype=np.int64)
    size = np.zeros(m, dtype=np.int64)
    for f in range(m):
        root, is_against = _root_and_parity(parent, parity, f)
        size[root] += 1
        if is_against:
            against[root] += 1
        flip[f] = is_against
    unorientable = 0
    for f in range(m):
        root, _ = _root_and_parity(parent, parity, f)
        if twisted[root]:
            flip[f] = False
            if root == f:
                unorientable += 1
        elif 2 * against[root] > size[root]:
            flip[f] = not flip[f]
    return unorientable


def faces_to_flip(faces: Ints, links: Connectivity) -> tuple[NDArray[np.bool_], int]:
    """The faces to turn round so that every part that can be is wound one way.

    Faces are joined across edges with exactly two faces.  In each part the lesser number of faces
    is turned; a part that has no consistent winding (a Moebius band) is left as it is.

    Returns
    -------
    flip : (m,) bool.
    unorientable : number of parts that have no consistent winding.
    """
    flip = np.zeros(len(faces), dtype=bool)
    unorientable = _to_flip(faces, *links.incidence, links.ring_start, flip)
    return flip, int(unorientable)
