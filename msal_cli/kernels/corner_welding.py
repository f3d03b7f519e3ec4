"""Triangle soup, facets with corners of their own, as an indexed mesh.

Corners at exactly the same position become one vertex by a hash table of vertex numbers.  Nearly
all the time goes into waiting for the table, whose places for new vertices are anywhere in memory:
so the places of a block of corners are computed first, which is vector code, and read all at once,
so that many waits are one; only then is any corner decided.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled

_BLOCK_FACETS = 256
_FACTOR_X = np.uint64(0x9E3779B97F4A7C15)
_FACTOR_Y = np.uint64(0xC2B2AE3D27D4EB4F)
_FACTOR_Z = np.uint64(0x94D049BB133111EB)


@compiled
def _slot(x, y, z, shift):  # type: ignore[no-untyped-def]
    """The place of a position in a table of ``2 ** (64 - shift)`` places."""
    a = np.float64(x).view(np.uint64)
    b = np.float64(y).view(np.uint64)
    c = np.float64(z).view(np.uint64)
    # Round numbers have bits at the top only, and a product carries nothing down.
    a ^= a >> np.uint64(32)
    b ^= b >> np.uint64(32)
    c ^= c >> np.uint64(32)
    return np.int64((a * _FACTOR_X + b * _FACTOR_Y + c * _FACTOR_Z) >> shift)


@compiled
def _index_corners(first, found, corners, shift, table, vertices, faces):  # type: ignore[no-untyped-def]
    """Number the corners of facets from ``first`` on.

    table (2^k,) int32 : 0 or one more than a vertex's number; ``shift`` is 64 - k.

    Returns the facet that it came to, the vertices found so far, and whether that facet has a
    position that is not finite; it stops too where the table or ``vertices`` might become full.
    """
    mask = len(table) - 1
    room = min(len(vertices), len(table) // 2)
    slots = np.empty(3 * _BLOCK_FACETS, dtype=np.int64)
    touched = 0
    for block in range(first, len(faces), _BLOCK_FACETS):
        stop = min(block + _BLOCK_FACETS, len(faces))
        if found + 3 * (stop - block) > room:
            return block, found, False
        for f in range(block, stop):
            for k in range(3):
                # The sum makes a plain zero of a negative one.
                slots[3 * (f - block) + k] = _slot(
                    np.float64(corners[f, 3 * k]) + 0.0,
                    np.float64(corners[f, 3 * k + 1]) + 0.0,
                    np.float64(corners[f, 3 * k + 2]) + 0.0,
                    shift,
                )
        for at in range(3 * (stop - block)):
            touched |= table[slots[at]]
        for f in range(block, stop):
            for k in range(3):
                x = np.float64(corners[f, 3 * k]) + 0.0
                y = np.float64(corners[f, 3 * k + 1]) + 0.0
                z = np.float64(corners[f, 3 * k + 2]) + 0.0
                if not (abs(x) < np.inf and abs(y) < np.inf and abs(z) < np.inf):
                    return f, found, True
                slot = slots[3 * (f - block) + k]
                number = table[slot] - 1
                while number >= 0 and not (
                    vertices[number, 0] == x
                    and vertices[number, 1] == y
                    and vertices[number, 2] == z
                ):
                    slot = (slot + 1) & mask
                    number = table[slot] - 1
                if number < 0:
                    number = found
                    found += 1
                    table[slot] = found
                    vertices[number, 0] = x
                    vertices[number, 1] = y
                    vertices[number, 2] = z
                faces[f, k] = number
    # Never true, but what is read for nothing would not be read.
    if touched < 0:
        found = -1
    return len(faces), found, False


@compiled
def _enter(vertices, shift, table):  # type: ignore[no-untyped-def]
    """Enter vertices that are all different into an empty table."""
    mask = len(table) - 1
    for number in range(len(vertices)):
        slot = _slot(vertices[number, 0], vertices[number, 1], vertices[number, 2], shift)
        while table[slot] != 0:
            slot = (slot + 1) & mask
        table[slot] = number + 1


def weld_corners(corners: NDArray[np.float32] | Floats) -> tuple[Floats, Ints, int]:
    """The facets ``corners`` (m, 9), of any strides, as an indexed mesh.

    Minus zero equals zero, and becomes it.  3 m must be below 2^31.

    Returns
    -------
    vertices : (n, 3) float64, the different positions in order of appearance.
    faces : (m, 3) int32.
    bad : the first facet with a position that is not finite, where the others end; else -1.
    """
    m = len(corners)
    faces = np.empty((m, 3), dtype=np.int32)
    # A closed surface has half as many vertices as facets.  Room is always left for one block.
    vertices = np.empty((min(3 * m, m // 2 + m // 32 + 6 * _BLOCK_FACETS), 3))
    bits = max(12, (5 * len(vertices) // 2 - 1).bit_length())
    table = np.zeros(1 << bits, dtype=np.int32)
    at = found = 0
    while True:
        shift = np.uint64(64 - bits)
        at, found, is_bad = _index_corners(at, found, corners, shift, table, vertices, faces)
        if at == m or is_bad:
            break
        if found + 3 * _BLOCK_FACETS > len(vertices):
            vertices.resize((min(3 * m, 2 * len(vertices)), 3), refcheck=False)
        if found + 3 * _BLOCK_FACETS > len(table) // 2:
            bits += 1
            table = np.zeros(1 << bits, dtype=np.int32)
            _enter(vertices[:found], np.uint64(64 - bits), table)
    vertices.resize((found, 3), refcheck=False)
    return vertices, faces, at if is_bad else -1
