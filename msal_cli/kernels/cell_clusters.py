"""Vertices gathered in the cells of a grid, in a table of a fixed size, and faces between cells.

A cell is known by its whole-numbered place on the finest grid, shifted to the right along each axis
as often as the grid was made coarser.  The first vertex in the file that lies in a cell stands for
it (Rossignac and Borrel 1993, with a vertex in place of a mean: a mean takes away noise).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.geometry import DEGENERATE, face_normals_and_areas
from msal_cli.kernels.vectors import longest_square
from msal_cli.kernels.welding import duplicate_faces, hash_bits

AXIS_BITS = 21
"""Bits of a place along an axis."""

EMPTY = -1


@compiled
def _key(x, y, z, low, per_cell, shifts):
    """The cell of a position as one number: 21 bits of each axis."""
    i = np.int64((x - low[0]) * per_cell) >> shifts[0]
    j = np.int64((y - low[1]) * per_cell) >> shifts[1]
    k = np.int64((z - low[2]) * per_cell) >> shifts[2]
    return i | (j << 21) | (k << 42)


@compiled
def _slot(key, keys):
    """Where a key is in the table, or the empty place where it belongs."""
    mask = len(keys) - 1
    slot = np.int64(hash_bits(np.uint64(key), np.uint64(0), np.uint64(0)) >> np.uint64(20)) & mask
    while keys[slot] != EMPTY and keys[slot] != key:
        slot = (slot + 1) & mask
    return slot


@compiled
def _enter(first, vertices, number, low, per_cell, shifts, keys, chosen, places, count, most):
    """Enter vertices from ``first`` on until there are more than ``most`` cells; the number of
    vertices that are done with, and of cells."""
    for at in range(first, len(vertices)):
        x, y, z = vertices[at, 0], vertices[at, 1], vertices[at, 2]
        key = _key(np.float64(x), np.float64(y), np.float64(z), low, per_cell, shifts)
        slot = _slot(key, keys)
        if keys[slot] == EMPTY:
            if count == most:
                return at, count
            keys[slot] = key
            chosen[slot] = number + at
            places[slot, 0], places[slot, 1], places[slot, 2] = x, y, z
            count += 1
    return len(vertices), count


@compiled
def _reenter(old_keys, old_chosen, old_places, axis, keys, chosen, places):
    """Enter the cells of a table into one that is twice as coarse along an axis; their number.

    Of the vertices of cells that become one the first in the file stays.
    """
    count = 0
    shift = 21 * axis
    field = np.int64(0x1FFFFF) << shift
    for at in range(len(old_keys)):
        if old_keys[at] == EMPTY:
            continue
        place = (old_keys[at] & field) >> shift
        key = (old_keys[at] & ~field) | ((place >> 1) << shift)
        slot = _slot(key, keys)
        if keys[slot] == EMPTY:
            count += 1
        elif chosen[slot] < old_chosen[at]:
            continue
        keys[slot] = key
        chosen[slot] = old_chosen[at]
        for k in range(3):
            places[slot, k] = old_places[at, k]
    return count


@compiled
def _join(corners, low, per_cell, shifts, keys, numbers, vertices, normals, facing, found):
    """The faces between three different cells, as cells' numbers in ``found``; how many there are.

    The unit normals of all faces are added to the cells of their corners, ``facing``, and to
    ``normals`` of those corners that stand for cells.
    """
    count = 0
    cells = np.empty(3, dtype=np.int64)
    unit = np.empty(3)
    for f in range(len(corners)):
        _unit_normal(corners, f, unit)
        for k in range(3):
            x, y, z = corners[f, 3 * k], corners[f, 3 * k + 1], corners[f, 3 * k + 2]
            key = _key(np.float64(x), np.float64(y), np.float64(z), low, per_cell, shifts)
            cell = np.int64(numbers[_slot(key, keys)])
            cells[k] = cell
            is_own = x == vertices[cell, 0] and y == vertices[cell, 1] and z == vertices[cell, 2]
            for axis in range(3):
                facing[cell, axis] += unit[axis]
                if is_own:
                    normals[cell, axis] += unit[axis]
        if cells[0] != cells[1] and cells[1] != cells[2] and cells[2] != cells[0]:
            for k in range(3):
                found[count, k] = cells[k]
            count += 1
    return count


@compiled
def _unit_normal(corners, f, unit):
    """Write the unit normal of a face; zeros if it has none."""
    ax, ay, az = np.float64(corners[f, 0]), np.float64(corners[f, 1]), np.float64(corners[f, 2])
    ux, uy, uz = corners[f, 3] - ax, corners[f, 4] - ay, corners[f, 5] - az
    wx, wy, wz = corners[f, 6] - ax, corners[f, 7] - ay, corners[f, 8] - az
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    has_normal = length > DEGENERATE * longest_square(ux, uy, uz, wx, wy, wz)
    scale = 1.0 / length if has_normal else 0.0
    unit[0], unit[1], unit[2] = nx * scale, ny * scale, nz * scale


class CellTable:
    """The cells of a grid that have vertices, no more than ``most`` of them.

    The grid begins as ``2 ** (AXIS_BITS - 1)`` cells along the longest side, from ``low`` (3,) over
    ``extent``, and becomes coarser along one axis after the other whenever it has too many.
    """

    def __init__(self, low: Floats, extent: float, most: int) -> None:
        self._low, self._most = low, most
        self._per_cell = (1 << (AXIS_BITS - 1)) / extent
        self._shifts: Longs = np.zeros(3, dtype=np.int64)
        # A table that is half full at most.
        self._size = 1 << int(2 * most - 1).bit_length()
        self._count = self._n_coarser = 0
        self._keys, self._chosen, self._places = self._empty()

    def _empty(self) -> tuple[Longs, Longs, Floats]:
        keys = np.full(self._size, EMPTY, dtype=np.int64)
        return keys, np.empty(self._size, dtype=np.int64), np.empty((self._size, 3))

    def enter(self, number: int, vertices: NDArray[np.floating]) -> None:
        """Enter vertices (n, 3), of which the first has this number in the file."""
        done = 0
        while done < len(vertices):
            done, self._count = _enter(
                done,
                vertices,
                number,
                self._low,
                self._per_cell,
                self._shifts,
                self._keys,
                self._chosen,
                self._places,
                self._count,
                self._most,
            )
            if done < len(vertices):
                self._coarsen()

    def _coarsen(self) -> None:
        axis = self._n_coarser % 3
        self._n_coarser += 1
        table = self._empty()
        self._count = _reenter(self._keys, self._chosen, self._places, axis, *table)
        self._keys, self._chosen, self._places = table
        self._shifts[axis] += 1

    def close(self) -> CellFaces:
        """All vertices have been entered: what takes the faces."""
        slots = np.flatnonzero(self._keys != EMPTY)
        order = slots[np.argsort(self._chosen[slots])]
        numbers = np.empty(self._size, dtype=np.int32)
        numbers[order] = np.arange(len(order), dtype=np.int32)
        return CellFaces(
            self._chosen[order],
            np.ascontiguousarray(self._places[order]),
            (self._low, self._per_cell, self._shifts, self._keys, numbers),
        )


class CellFaces:
    """The vertices that stand for cells, and the faces between them.

    Attributes
    ----------
    chosen : (k,) the numbers of the vertices in the file, in rising order.
    vertices : (k, 3) their positions.
    normals : (k, 3) sums of the unit normals of the faces around them.
    facing : (k, 3) sums of those of the faces at all vertices in their cells.
    """

    def __init__(self, chosen: Longs, vertices: Floats, grid: tuple[object, ...]) -> None:
        self.chosen, self.vertices = chosen, vertices
        self.normals, self.facing = np.zeros_like(vertices), np.zeros_like(vertices)
        self._grid = grid
        self._faces: list[Ints] = []
        self._n_new = self._n_distinct = 0

    def add(self, corners: NDArray[np.floating]) -> None:
        """Add faces, by the positions (m, 9) of their corners."""
        found = np.empty((len(corners), 3), dtype=np.int32)
        sums = self.normals, self.facing
        count = _join(corners, *self._grid, self.vertices, *sums, found)
        self._faces.append(found[:count].copy())
        self._n_new += count
        if self._n_new > self._n_distinct + len(self.vertices):
            self._merge()

    def _merge(self) -> None:
        faces = np.concatenate(self._faces)
        self._faces = [faces[~duplicate_faces(faces)]]
        self._n_new, self._n_distinct = 0, len(self._faces[0])

    @property
    def faces(self) -> Ints:
        """The faces (m, 3), each set of three cells but once.

        Where noise is near the side of a cell, two vertices stand for nearly one place, and the
        surface folds between them.  Faces that look the other way than their cells are left out:
        those above and below them cover the place.
        """
        self._merge()
        faces = self._faces[0]
        normals, _ = face_normals_and_areas(self.vertices, faces)
        wanted = self.facing[faces].sum(axis=1)
        return np.ascontiguousarray(faces[np.einsum("ij,ij->i", normals, wanted) > 0.0])
