"""Who neighbours whom: welding, one-rings, edge counts, winding and components.

A one-ring is kept in compressed rows: the neighbours of vertex i are
``ring[ring_start[i]:ring_start[i + 1]]``, each once, in the order in which the faces name them.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@compiled
def _welded(bits, used, table, first):  # type: ignore[no-untyped-def]
    mask = len(table) - 1
    merged = 0
    for i in range(len(first)):
        first[i] = i
        if not used[i]:
            continue
        a, b, c = bits[i, 0], bits[i, 1], bits[i, 2]
        h = a * np.uint64(0x9E3779B97F4A7C15)
        h ^= h >> np.uint64(29)
        h = (h + b) * np.uint64(0xBF58476D1CE4E5B9)
        h ^= h >> np.uint64(32)
        h = (h + c) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
        slot = np.int64(h & np.uint64(mask))
        while True:
            k = table[slot]
            if k < 0:
                table[slot] = i
                break
            if bits[k, 0] == a and bits[k, 1] == b and bits[k, 2] == c:
                first[i] = k
                merged += 1
                break
            slot = (slot + 1) & mask
    return merged


def first_alike(rows: Floats, used: NDArray[np.bool_]) -> Ints:
    """For each row of (n, 3) numbers the lowest-numbered equal row, (n,) int32.

    Minus zero equals zero.  Rows outside ``used`` (n,) equal nothing and stand for themselves.
    """
    bits = (rows + 0.0).view(np.uint64)
    # Twice the rows at least, so that probing stays short.
    table = np.full(1 << max(4, (2 * len(rows)).bit_length()), -1, dtype=np.int32)
    first = np.empty(len(rows), dtype=np.int32)
    _welded(bits, used, table, first)
    return first


def welded(vertices: Floats, faces: Ints) -> Ints:
    """For each vertex the lowest-numbered vertex at exactly its position, (n,) int32.

    Minus zero equals zero.  Vertices that no face uses weld with nothing and stand for themselves.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[faces.reshape(-1)] = True
    return first_alike(vertices, used)


@compiled
def _numbered(left, right, table, number, first):  # type: ignore[no-untyped-def]
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
def _incident_faces(faces, face_start, incident):  # type: ignore[no-untyped-def]
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
def _neighbours_in_face(faces, f, i):  # type: ignore[no-untyped-def]
    """The vertex after i and the vertex before i in face f."""
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    if a == i:
        return b, c
    if b == i:
        return c, a
    return a, b


@compiled
def _ring_sizes(faces, face_start, incident, ring_start):  # type: ignore[no-untyped-def]
    n = len(ring_start) - 1
    seen = np.full(n, -1, dtype=np.int32)
    total = 0
    for i in range(n):
        for at in range(face_start[i], face_start[i + 1]):
            after, before = _neighbours_in_face(faces, incident[at], i)
            if seen[after] != i:
                seen[after] = i
                total += 1
            if seen[before] != i:
                seen[before] = i
                total += 1
        ring_start[i + 1] = total
    return total


@compiled
def _rings(faces, face_start, incident, ring_start, ring, boundary):  # type: ignore[no-untyped-def]
    """Fill the rings; count (boundary, inconsistent, non-manifold) edges; mark the boundary."""
    n = len(ring_start) - 1
    # Positions in ``ring`` only grow, so a slot at or above the row's start belongs to this row.
    slot = np.full(n, -1, dtype=np.int32)
    widest = 0
    for i in range(n):
        widest = max(widest, ring_start[i + 1] - ring_start[i])
    outgoing = np.empty(widest, dtype=np.int32)
    incoming = np.empty(widest, dtype=np.int32)
    open_edges = twisted_edges = crowded_edges = 0
    for i in range(n):
        row = ring_start[i]
        filled = row
        for at in range(face_start[i], face_start[i + 1]):
            after, before = _neighbours_in_face(faces, incident[at], i)
            if slot[after] < row:
                slot[after] = filled
                ring[filled] = after
                outgoing[filled - row] = 0
                incoming[filled - row] = 0
                filled += 1
            outgoing[slot[after] - row] += 1
            if slot[before] < row:
                slot[before] = filled
                ring[filled] = before
                outgoing[filled - row] = 0
                incoming[filled - row] = 0
                filled += 1
            incoming[slot[before] - row] += 1
        for at in range(row, filled):
            out = outgoing[at - row]
            around = out + incoming[at - row]
            if around == 1:
                boundary[i] = True
            if ring[at] > i:
                if around == 1:
                    open_edges += 1
                elif around > 2:
                    crowded_edges += 1
                elif out != 1:
                    twisted_edges += 1
    return open_edges, twisted_edges, crowded_edges


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

    @functools.cached_property
    def incidence(self) -> tuple[Ints, Ints]:
        """Rows of the faces around each vertex: where they start (n + 1,), and the faces (3 m,)."""
        return incidence(len(self.ring_start) - 1, self.faces)

    def passing_incidence(self) -> tuple[Ints, Ints]:
        """As ``incidence``, but not kept where nobody has asked for it yet: it takes more memory
        than the faces, and is made anew in little time."""
        kept: tuple[Ints, Ints] | None = self.__dict__.get("incidence")
        return incidence(len(self.ring_start) - 1, self.faces) if kept is None else kept

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
    ring_start = np.zeros(n_vertices + 1, dtype=np.int32)
    total = _ring_sizes(faces, face_start, incident, ring_start)
    ring = np.empty(total, dtype=np.int32)
    boundary = np.zeros(n_vertices, dtype=bool)
    counts = _rings(faces, face_start, incident, ring_start, ring, boundary)
    return Connectivity(faces, ring_start, ring, boundary, *map(int, counts))


@compiled
def _duplicates(corners, table, duplicate):  # type: ignore[no-untyped-def]
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
def _root(parent, item):  # type: ignore[no-untyped-def]
    while parent[item] != item:
        parent[item] = parent[parent[item]]
        item = parent[item]
    return item


@compiled
def _count_components(faces, used, parent):  # type: ignore[no-untyped-def]
    components = 0
    for i in range(len(parent)):
        parent[i] = i
        if used[i]:
            components += 1
    for f in range(len(faces)):
        first = _root(parent, faces[f, 0])
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


@compiled
def _root_and_parity(parent, parity, face):  # type: ignore[no-untyped-def]
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
def _to_flip(faces, face_start, incident, ring_start, flip):  # type: ignore[no-untyped-def]
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
    unorientable = _to_flip(faces, links.face_start, links.incident_faces, links.ring_start, flip)
    return flip, int(unorientable)
