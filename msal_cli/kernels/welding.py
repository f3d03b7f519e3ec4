"""Equal vertices and faces, and the map from the mesh back to the vertices of its file."""

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels import array_files
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.spatial_order import blocks, order_vertices


@compiled
def hash_bits(a, b, c):
    """A hash of three 64-bit patterns; minus zero, the highest bit alone, counts as 0."""
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


@compiled
def _alike_perhaps(bits, used, seen, again, candidates):
    """The rows whose hash is not unique, the only ones that can equal another; their number.

    ``seen`` and ``again`` are bit sets, a power of two words long.
    """
    mask = np.uint64(64 * len(seen) - 1)
    one, six, low = np.uint64(1), np.uint64(6), np.uint64(63)
    repeats = False
    for i in range(len(used)):
        code = hash_bits(bits[i, 0], bits[i, 1], bits[i, 2]) & mask
        bit = (one if used[i] else np.uint64(0)) << (code & low)
        if seen[code >> six] & bit:
            again[code >> six] |= bit
            repeats = True
        seen[code >> six] |= bit
    count = 0
    if not repeats:
        return count
    for i in range(len(used)):
        code = hash_bits(bits[i, 0], bits[i, 1], bits[i, 2]) & mask
        is_one = (again[code >> six] >> (code & low)) & one
        candidates[count] = i
        count += 1 if is_one and used[i] else 0
    return count


@compiled
def _weld(rows, bits, candidates, table, first):
    mask = len(table) - 1
    merged = 0
    for i in candidates:
        slot = np.int64(hash_bits(bits[i, 0], bits[i, 1], bits[i, 2]) >> np.uint64(20)) & mask
        while table[slot] >= 0 and vec.load(rows, table[slot]) != vec.load(rows, i):
            slot = (slot + 1) & mask
        if table[slot] < 0:
            table[slot] = i
        else:
            first[i] = table[slot]
            merged += 1
    return merged


def first_alike(rows: Floats, used: Flags) -> tuple[Ints, int]:
    """For each row of (n, 3) numbers the lowest-numbered equal row, (n,) int32, and the number of
    rows that equal an earlier one.

    Minus zero equals zero, and NaN nothing.  Rows outside ``used`` (n,) are ignored and map to
    themselves.
    """
    n = len(rows)
    rows = np.ascontiguousarray(rows)
    bits = rows.view(np.uint64)
    # Sixteen bits a row: one in sixteen different rows has the hash of another.
    words = 1 << max(0, (n // 4).bit_length())
    seen, again = np.zeros(words, dtype=np.uint64), np.zeros(words, dtype=np.uint64)
    first = np.arange(n, dtype=np.int32)
    candidates = np.empty(n + 1, dtype=np.int32)
    count = _alike_perhaps(bits, used, seen, again, candidates)
    if not count:
        return first, 0
    # At least twice the rows, so that probing stays short.
    table = np.full(1 << max(4, (2 * count).bit_length()), -1, dtype=np.int32)
    return first, int(_weld(rows, bits, candidates[:count], table, first))


@compiled
def _mark(items, marks):
    for at in range(len(items)):
        marks[items[at]] = True


def used_vertices(n_vertices: int, faces: Ints) -> Flags:
    """(n,) bool, True for each vertex that a face (m, 3) names."""
    used = np.zeros(n_vertices, dtype=bool)
    _mark(np.ascontiguousarray(faces).reshape(-1), used)
    return used


def repeated_corners(faces: Ints) -> Flags:
    """(m,) bool, True for each face (m, 3) that names a vertex twice."""
    a, b, c = faces.T
    repeated: Flags = (a == b) | (b == c) | (c == a)
    return repeated


@compiled
def _number(left, right, table, number, first):
    mask = len(table) - 1
    found = 0
    for i in range(len(left)):
        a, b = left[i], right[i]
        slot = np.int64(hash_bits(np.uint64(a), np.uint64(b), np.uint64(0)) & np.uint64(mask))
        k = table[slot]
        while k >= 0 and (left[first[k]] != a or right[first[k]] != b):
            slot = (slot + 1) & mask
            k = table[slot]
        if k < 0:
            k = table[slot] = found
            first[found] = i
            found += 1
        number[i] = k
    return found


def number_groups(left: Ints, right: Ints) -> tuple[Ints, Ints]:
    """Number the different pairs (left, right) in order of appearance.

    Both arguments are (n,) int32.  Returns the number of each pair (n,), and the first index of
    each (k,).
    """
    table = np.full(1 << max(4, (2 * len(left)).bit_length()), -1, dtype=np.int32)
    number = np.empty(len(left), dtype=np.int32)
    first = np.empty(len(left), dtype=np.int32)
    found = _number(left, right, table, number, first)
    return number, first[:found].copy()


def duplicate_faces(faces: Ints) -> tuple[Flags, bool]:
    """True (m,) for every face whose three vertices, in any order, an earlier face has too, and
    whether each other face has such a duplicate with the other winding."""
    rows = np.sort(faces, axis=1).astype(np.float64)
    first, _ = first_alike(rows, np.ones(len(faces), dtype=bool))
    duplicate: Flags = first != np.arange(len(faces))
    a, b, c = faces.T
    winding = (a < b) ^ (b < c) ^ (a < c)
    turned = np.unique(first[winding != winding[first]])
    return duplicate, len(turned) == len(faces) - np.count_nonzero(duplicate)


@compiled
def _scatter(start, stop, before, after, is_used, place, first, last, origin, original, result):
    for i in range(start, stop):
        k = np.int64(place[i]) if len(place) else np.int64(i)
        if k >= last or (k < first and k >= 0) or (k < 0 and first > 0):
            continue
        if k >= 0 and is_used[k]:
            place_after = vec.load(after, k)
            if place_after != vec.load(before, k):
                vec.store(result, i, vec.add(place_after, vec.load(origin, 0)))
                continue
        vec.store(result, i, vec.load(original, i))


def scatter(
    before: Floats,
    after: Floats,
    is_used: NDArray[np.bool_],
    place: Ints | None,
    origin: Floats,
    original: Floats,
) -> Floats:
    """File positions (n_file, 3) for mesh positions ``after`` (n, 3), which were ``before``.

    ``place`` (n_file,) is the mesh vertex of each file vertex, -1 for none; None for the identity.
    A vertex that did not move or that ``is_used`` (n,) excludes keeps exactly its value in
    ``original``; ``origin`` (3,) is added to the others.
    """
    result = np.empty_like(original)
    place = np.empty(0, dtype=np.int32) if place is None else place
    mesh = before, after, is_used, place
    for block in blocks(len(after), after.itemsize * 3) if len(place) else [(0, len(after))]:
        over_ranges(_scatter, len(original), *mesh, *block, origin, original, result)
    return result


def first_places(place: Ints, count: int) -> Longs:
    """The first index into ``place`` (n,) of each number below ``count``; 0 if it is not there.

    -1 in ``place`` is no number.
    """
    first = np.zeros(count + 1, dtype=np.int64)
    # In reverse, so that the first one is assigned last.
    first[place[::-1]] = np.arange(len(place))[::-1]
    return first[:count]


def widest_gap(positions: Floats, place: Ints, n_places: int) -> float:
    """Largest distance of ``positions`` (n, 3) from the first one with the same ``place`` (n,)."""
    late = np.ones(len(place), dtype=bool)
    first = first_places(place, n_places)
    late[first] = False
    late = np.flatnonzero(late & (place >= 0))
    offsets = positions[late] - positions[first[place[late]]]
    return float(np.sqrt((offsets * offsets).sum(axis=1).max(initial=0.0)))


# Triangle soup, facets with separate corners, as an indexed mesh.  Most of the time is spent on
# waiting for the hash table of vertex numbers, whose slots for new vertices are random in memory.
# So the slots of a block of corners are read first, all at once.  If arrays are in files, each wait
# may be one for the disk.  So the corners are read several times, each time for slots in one part
# of the table, which fits into memory.

_BLOCK_FACETS = 256


@compiled
def _slot(x, y, z, shift):
    """The slot of a position in a table of ``2 ** (64 - shift)`` slots."""
    a, b, c = (
        np.float64(x).view(np.uint64),
        np.float64(y).view(np.uint64),
        np.float64(z).view(np.uint64),
    )
    return np.int64(hash_bits(a, b, c) >> shift)


@compiled
def _corner(corners, f, k):
    """The position of corner k of facet f; the sum turns a negative zero into a positive one."""
    x, y, z = corners[f, 3 * k], corners[f, 3 * k + 1], corners[f, 3 * k + 2]
    return np.float64(x) + 0.0, np.float64(y) + 0.0, np.float64(z) + 0.0


@compiled
def _index_corners(found, corners, shift, part, part_shift, table, vertices, keys, faces):
    """Number the corners of facets whose slot is in one ``part`` of the table.

    table (2^k,) int32 : 0 or one more than a vertex's number; ``shift`` is 64 - k.  A part of it
        has ``2 ** part_shift`` slots.
    keys (n,) uint64 : of each vertex its first corner, and in the low half its number.  Not filled
        if empty.

    Returns the facet reached, the vertices found so far, and whether that facet has a position that
    is not finite; it stops too if the table or ``vertices`` might become full.
    """
    mask = len(table) - 1
    room = min(len(vertices), len(table) // 2)
    slots = np.empty(3 * _BLOCK_FACETS, dtype=np.int64)
    touched = 0
    for block in range(0, len(faces), _BLOCK_FACETS):
        stop = min(block + _BLOCK_FACETS, len(faces))
        if found + 3 * (stop - block) > room:
            return block, found, False
        for at in range(3 * (stop - block)):
            x, y, z = _corner(corners, block + at // 3, at % 3)
            slots[at] = _slot(x, y, z, shift)
        if len(table) == 1 << part_shift:
            for at in range(3 * (stop - block)):
                touched |= table[slots[at]]
        for at in range(3 * (stop - block)):
            f, k, slot = block + at // 3, at % 3, slots[at]
            x, y, z = _corner(corners, f, k)
            if not (abs(x) < np.inf and abs(y) < np.inf and abs(z) < np.inf):
                return f, found, True
            if slot >> part_shift != part:
                continue
            number = table[slot] - 1
            while number >= 0 and vec.load(vertices, number) != (x, y, z):
                slot = (slot + 1) & mask
                number = table[slot] - 1
            if number < 0:
                number = found
                if len(keys):
                    keys[number] = np.uint64(3 * f + k) << np.uint64(32) | np.uint64(number)
                found += 1
                table[slot] = found
                vec.store(vertices, number, (x, y, z))
            faces[f, k] = number
    # Never true; keeps the compiler from removing the reads of a block.
    return len(faces), -1 if touched < 0 else found, False


def weld_corners(corners: NDArray[np.float32] | Floats) -> tuple[Floats, Ints, int]:
    """The facets ``corners`` (m, 9), of any strides, as an indexed mesh.

    Minus zero becomes zero.  3 m must be below 2^31.

    Returns
    -------
    vertices : (n, 3) float64, the different positions in order of appearance.
    faces : (m, 3) int32.
    bad : the first facet with a non-finite position, where the result ends; else -1.
    """
    m = len(corners)
    faces = np.empty((m, 3), dtype=np.int32)
    # A closed surface has half as many vertices as facets.  Room is always left for one block.
    most = 3 * (m + _BLOCK_FACETS)
    room = min(most, m // 2 + m // 32 + 6 * _BLOCK_FACETS)
    while True:
        vertices = np.empty((room, 3))
        bits = max(12, (5 * room // 2 - 1).bit_length())
        table = np.zeros(1 << bits, dtype=np.int32)
        part_bits = 0
        if array_files.are_used():
            part_bits = (len(blocks(vertices.nbytes + table.nbytes, 1)) - 1).bit_length()
        keys = np.empty(room if part_bits else 0, dtype=np.uint64)
        found = 0
        for part in range(1 << part_bits):
            places = np.uint64(64 - bits), part, bits - part_bits
            results = table, vertices, keys, faces
            at, found, is_bad = _index_corners(found, corners, *places, *results)
            if is_bad:
                return vertices[:found], faces, at
            if at < m:
                break
        if at == m:
            break
        room = min(most, 2 * room)
    del table
    vertices.resize((found, 3), refcheck=False)
    if part_bits:
        vertices, faces, _ = order_vertices(vertices, faces, keys[:found])
    return vertices, faces, -1
