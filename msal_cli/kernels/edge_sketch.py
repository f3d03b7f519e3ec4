"""Which edges are left once every edge has met its opposite, in memory of a fixed size.

Two faces that are wound alike run through the edge between them in opposite directions.  Each
directed edge is added to three cells of a table, with a plus in one direction and a minus in the
other, so that it vanishes from the table once its opposite comes, however far apart in the file
they are.  What is left are the edges of boundaries, and those between faces that are wound against
each other.  As long as they are no more than three quarters of the cells, they can be listed: a
cell with one edge alone names it, it is taken out of its other two cells, and so on (an invertible
Bloom lookup table, Goodrich and Mitzenmacher 2011).  Edges are known by a hash of the positions of
their ends, so that vertices which coincide are one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.vectors import longest_square
from msal_cli.kernels.welding import hash_bits

DEGENERATE = 1e-12
"""See ``kernels.geometry``."""

PART_BITS = 20
"""There are three parts of 2 ** 20 cells: 100 MB, of which only what is touched takes memory."""

PENDING = 1 << 15
"""Edges that wait for their opposites in a place that fits a cache: most come soon."""

MOST_NET = 3
"""Faces more in one direction than in the other, up to which an edge can be listed."""

LENGTH_STEPS = float(1 << 52)
"""Steps in the largest length: lengths are kept as whole numbers, which add up exactly."""

_COUNT, _KEYS, _CHECKS, _LENGTHS, _FIELDS = range(5)

(
    DOUBLED_AREA,
    SIXFOLD_VOLUME,
    SIDES,  # sum of the lengths of the sides of all faces with three different corners
    FACES,  # how many such faces there are
    FLAT,  # faces without a normal
    N_SUMS,
) = range(6)


@compiled
def _check(key):
    """A number that goes with a key, to know a lone key by."""
    return hash_bits(key, np.uint64(0x5851F42D4C957F2D), np.uint64(1))


@compiled
def _cell(key, part, part_bits):
    """The cell of a key in one of the three parts."""
    bits = np.uint64(part_bits)
    mask = (np.uint64(1) << bits) - np.uint64(1)
    place = (key >> (np.uint64(part) * bits)) & mask
    return (np.uint64(part) << bits) + place


@compiled
def _add(cells, part_bits, key, is_plus, length):
    """Add an edge to its cells, or take it out; sums are modulo 2 ** 64."""
    check = _check(key)
    for part in range(3):
        cell = _cell(key, part, part_bits)
        if is_plus:
            cells[cell, _COUNT] += np.uint64(1)
            cells[cell, _KEYS] += key
            cells[cell, _CHECKS] += check
            cells[cell, _LENGTHS] += length
        else:
            cells[cell, _COUNT] -= np.uint64(1)
            cells[cell, _KEYS] -= key
            cells[cell, _CHECKS] -= check
            cells[cell, _LENGTHS] -= length


@compiled
def _position_hash(x, y, z):
    return hash_bits(
        np.float64(x).view(np.uint64), np.float64(y).view(np.uint64), np.float64(z).view(np.uint64)
    )


@compiled
def _both_hash(first, corners, f, at):
    """The hash of a position whose own is ``first`` and another one."""
    second = _position_hash(corners[f, at], corners[f, at + 1], corners[f, at + 2])
    return hash_bits(first, second, np.uint64(2))


@compiled
def _meet(cells, part_bits, pending, signs, hash_a, hash_b, length):
    """One directed edge: it cancels its opposite, or waits, or what waited goes to the cells."""
    is_plus = hash_a < hash_b
    low, high = (hash_a, hash_b) if is_plus else (hash_b, hash_a)
    key = hash_bits(low, high, np.uint64(0)) >> np.uint64(2)
    place = np.int64(key >> np.uint64(40)) & (len(signs) - 1)
    sign = 1 if is_plus else -1
    if signs[place] != 0:
        if pending[place, 0] == key and signs[place] == -sign:
            signs[place] = 0
            return
        _add(cells, part_bits, pending[place, 0], signs[place] > 0, pending[place, 1])
    pending[place, 0], pending[place, 1] = key, length
    signs[place] = sign


@compiled
def _add_faces(
    corners, others, triangles, origin, steps, used, cells, part_bits, pending, signs, sums
):
    """Add faces to the table and to the sums, and mark the vertices that they use.

    With ``others``, ends of edges are one where both positions are: those of ``corners`` and these.
    """
    doubled_area = sixfold_volume = sides = 0.0
    n_faces = n_flat = 0
    # A set bit for each vertex; none are wanted where there are none.
    marks = len(used) > 0
    for f in range(len(corners)):
        ax, ay, az = np.float64(corners[f, 0]), np.float64(corners[f, 1]), np.float64(corners[f, 2])
        bx, by, bz = np.float64(corners[f, 3]), np.float64(corners[f, 4]), np.float64(corners[f, 5])
        cx, cy, cz = np.float64(corners[f, 6]), np.float64(corners[f, 7]), np.float64(corners[f, 8])
        hash_a = _position_hash(ax, ay, az)
        hash_b = _position_hash(bx, by, bz)
        hash_c = _position_hash(cx, cy, cz)
        ux, uy, uz = bx - ax, by - ay, bz - az
        wx, wy, wz = cx - ax, cy - ay, cz - az
        vx, vy, vz = wx - ux, wy - uy, wz - uz
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        doubled = np.sqrt(nx * nx + ny * ny + nz * nz)
        n_flat += doubled <= DEGENERATE * longest_square(ux, uy, uz, wx, wy, wz)
        if hash_a == hash_b or hash_b == hash_c or hash_c == hash_a:
            continue
        if len(others) > 0:
            hash_a = _both_hash(hash_a, others, f, 0)
            hash_b = _both_hash(hash_b, others, f, 3)
            hash_c = _both_hash(hash_c, others, f, 6)
        n_faces += 1
        doubled_area += doubled
        px, py, pz = ax - origin[0], ay - origin[1], az - origin[2]
        sixfold_volume += px * nx + py * ny + pz * nz
        length_u = np.sqrt(ux * ux + uy * uy + uz * uz)
        vx, vy, vz = cx - bx, cy - by, cz - bz
        length_v = np.sqrt(vx * vx + vy * vy + vz * vz)
        length_w = np.sqrt(wx * wx + wy * wy + wz * wz)
        sides += length_u + length_v + length_w
        _meet(cells, part_bits, pending, signs, hash_a, hash_b, np.uint64(length_u * steps))
        _meet(cells, part_bits, pending, signs, hash_b, hash_c, np.uint64(length_v * steps))
        _meet(cells, part_bits, pending, signs, hash_c, hash_a, np.uint64(length_w * steps))
        if marks:
            for corner in range(3):
                vertex = np.uint64(triangles[f, corner])
                used[vertex >> np.uint64(3)] |= np.uint8(1) << np.uint8(vertex & np.uint64(7))
    sums[DOUBLED_AREA] += doubled_area
    sums[SIXFOLD_VOLUME] += sixfold_volume
    sums[SIDES] += sides
    sums[FACES] += n_faces
    sums[FLAT] += n_flat


@compiled
def _flush(cells, part_bits, pending, signs):
    """Add what still waits."""
    for place in range(len(signs)):
        if signs[place] != 0:
            _add(cells, part_bits, pending[place, 0], signs[place] > 0, pending[place, 1])
            signs[place] = 0


@compiled
def _lone(cells, cell, part_bits):
    """Faces that the one edge of a cell has more in one direction than in the other, its key, and
    its length in steps; 0 faces if the cell has no edge or several."""
    count = np.int64(cells[cell, _COUNT])
    n = np.uint64(abs(count))
    if n == np.uint64(0) or n > np.uint64(MOST_NET):
        return 0, np.uint64(0), np.uint64(0)
    zero = np.uint64(0)
    keys, lengths = cells[cell, _KEYS], cells[cell, _LENGTHS]
    keys = keys if count > 0 else zero - keys
    lengths = lengths if count > 0 else zero - lengths
    key = keys // n
    if key * n != keys or key >> np.uint64(62) != zero:
        return 0, zero, zero
    checks = cells[cell, _CHECKS] if count > 0 else zero - cells[cell, _CHECKS]
    if checks != n * _check(key) or cell != _cell(key, cell >> np.uint64(part_bits), part_bits):
        return 0, zero, zero
    return count, key, lengths // n


@compiled
def _list_edges(cells, part_bits, stack, counts, lengths):
    """Take out all edges and count them by the number of faces too many; whether none is left."""
    for first in range(len(cells)):
        top = 0
        stack[0] = first
        while top >= 0:
            cell = np.uint64(stack[top])
            top -= 1
            net, key, length = _lone(cells, cell, part_bits)
            if net == 0:
                continue
            n = abs(net)
            counts[n] += 1
            lengths[n] += np.float64(length)
            for _ in range(n):
                _add(cells, part_bits, key, net < 0, length)
            for part in range(3):
                other = _cell(key, part, part_bits)
                if other != cell:
                    top += 1
                    stack[top] = other
    for at in range(len(cells)):
        if cells[at, _COUNT] != np.uint64(0) or cells[at, _KEYS] != np.uint64(0):
            return False
    return True


@dataclass(frozen=True)
class LeftEdges:
    """Edges that did not cancel out.

    Attributes
    ----------
    boundary_edges, boundary_length : edges with one face more in one direction, and the sum of
        their lengths: those with one face, unless an edge has three.
    inconsistent_edges : those with two faces more in one direction: wound against each other.
    crowded_edges : with three faces more.
    """

    boundary_edges: int
    boundary_length: float
    inconsistent_edges: int
    crowded_edges: int


class EdgeSketch:
    """Sums over the faces of a surface that comes in pieces, and its edges without an opposite.

    ``origin`` (3,) is where volumes are seen from, ``extent`` the largest length that there is,
    and ``n_vertices`` counts the vertices of which those that faces use are marked; 0 for none.
    """

    def __init__(
        self, origin: Floats, extent: float, n_vertices: int, part_bits: int | None = None
    ) -> None:
        self._origin = origin
        self._steps = LENGTH_STEPS / extent
        self._part_bits = part_bits or PART_BITS
        self._cells = np.zeros((3 << self._part_bits, _FIELDS), dtype=np.uint64)
        self._pending = np.zeros((PENDING, 2), dtype=np.uint64)
        self._signs = np.zeros(PENDING, dtype=np.int8)
        self.used = np.zeros(-(-n_vertices // 8), dtype=np.uint8)
        self.sums = np.zeros(N_SUMS)

    def add(
        self,
        corners: NDArray[np.floating],
        triangles: NDArray[np.uint32],
        others: NDArray[np.floating] | None = None,
    ) -> None:
        """Add faces: their ``corners`` (m, 9), file units, and vertices (m, 3).

        With ``others`` (m, 9), the same corners elsewhere, edges meet where they do there, too.
        """
        _add_faces(
            corners,
            corners[:0] if others is None else others,
            triangles,
            self._origin,
            self._steps,
            self.used,
            self._cells,
            self._part_bits,
            self._pending,
            self._signs,
            self.sums,
        )

    def left_edges(self) -> LeftEdges | None:
        """The edges without an opposite; None if there are too many of them to tell.  This empties
        the table, so it comes last and once."""
        _flush(self._cells, self._part_bits, self._pending, self._signs)
        counts: Longs = np.zeros(MOST_NET + 1, dtype=np.int64)
        lengths = np.zeros(MOST_NET + 1)
        # Each edge that is taken out puts two cells on top, and comes from one.
        stack = np.empty(len(self._cells) + 8, dtype=np.int64)
        if not _list_edges(self._cells, self._part_bits, stack, counts, lengths):
            return None
        return LeftEdges(
            int(counts[1]), float(lengths[1]) / self._steps, int(counts[2]), int(counts[3])
        )
