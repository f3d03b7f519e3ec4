"""How much of each voxel a closed surface fills, exactly along one axis.

Columns of the grid are cut with the triangles.  At every cut the column enters the solid or leaves
it, so that a running sum of the cuts is the winding number: 1 inside, 0 outside.  Holes are closed
first, so that what is entered is left again.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints, Longs

Volume = NDArray[np.float32]

PAIRS_AT_ONCE = 1 << 21
"""Pairs of a triangle and a column that are looked at together."""


@dataclass(frozen=True)
class Grid:
    """Voxels: the centre of the first (3,), the distances to the next (3,), and how many (3,)."""

    origin: Floats
    spacing: Floats
    shape: tuple[int, int, int]


def close_holes(vertices: Floats, faces: Ints) -> tuple[Floats, Ints, int]:
    """A mesh with its holes closed by a fan of triangles each, and the number of holes.

    A fan joins the border of a hole with the mean of its vertices.  Where edges have more than two
    faces, as many of them as are left over are such a border.
    """
    n = len(vertices)
    starts = faces.reshape(-1).astype(np.int64)
    ends = faces[:, [1, 2, 0]].reshape(-1).astype(np.int64)
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    keys, inverse = np.unique(low * n + high, return_inverse=True)
    surplus = np.bincount(inverse, weights=np.where(starts < ends, 1.0, -1.0)).astype(np.int64)
    open_edges = np.repeat(np.arange(len(keys)), np.abs(surplus))
    if not len(open_edges):
        return vertices, faces, 0
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b = keys[open_edges] // n, keys[open_edges] % n
    # The fan's faces pass their border the other way.
    is_up = surplus[open_edges] > 0
    first, second = np.where(is_up, b, a), np.where(is_up, a, b)
    links = coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
    _, part = connected_components(links, directed=False)
    holes, hole = np.unique(part[first], return_inverse=True)
    counts = np.bincount(hole)
    tips = np.stack(
        [np.bincount(hole, weights=vertices[first, axis]) / counts for axis in range(3)], axis=1
    )
    fans = np.stack([first, second, n + hole], axis=1).astype(np.int32)
    return np.concatenate([vertices, tips]), np.concatenate([faces, fans]), len(holes)


def fill_centres(vertices: Floats, faces: Ints, grid: Grid) -> Flags:
    """Whether the centre of each voxel is inside a closed mesh, (nx, ny, nz)."""
    _, _, nz = grid.shape
    winding = np.zeros((grid.shape[0] * grid.shape[1], nz + 1), dtype=np.int32)
    for column, height, turn in _cut_columns(vertices, faces, grid, (0.0, 0.0)):
        above = np.ceil(height).clip(0, nz).astype(np.int64)
        np.add.at(winding, (column, above), turn)
    inside: Flags = winding.cumsum(axis=1)[:, :nz] > 0
    return inside.reshape(grid.shape)


def fill_voxels(vertices: Floats, faces: Ints, grid: Grid, columns: int = 3) -> Volume:
    """What share of each voxel is inside a closed mesh, (nx, ny, nz), 0 to 1.

    A voxel is cut by ``columns`` x ``columns`` lines along the third axis, and how long these run
    inside is exact.
    """
    _, _, nz = grid.shape
    change = np.zeros((grid.shape[0] * grid.shape[1], nz + 1))
    shifts = (np.arange(columns) + 0.5) / columns - 0.5
    share = 1.0 / columns**2
    for shift in ((x, y) for x in shifts for y in shifts):
        for column, height, turn in _cut_columns(vertices, faces, grid, shift):
            place = np.clip(height + 0.5, 0.0, nz - 1e-9)
            voxel = place.astype(np.int64)
            within = place - voxel
            np.add.at(change, (column, voxel), share * turn * (1.0 - within))
            np.add.at(change, (column, voxel + 1), share * turn * within)
    filled: Volume = change.cumsum(axis=1)[:, :nz].clip(0.0, 1.0).astype(np.float32)
    return filled.reshape(grid.shape)


def _cut_columns(
    vertices: Floats, faces: Ints, grid: Grid, shift: tuple[float, float]
) -> Iterator[tuple[Longs, Floats, Longs]]:
    """Cuts of columns of voxels with triangles: which column, at what height in voxels, and +1
    where the column enters the solid on its way up or -1 where it leaves.

    ``shift`` moves the columns from the voxels' centres, in voxels along the first two axes.
    """
    nx, ny, _ = grid.shape
    places = (vertices - grid.origin) / grid.spacing
    places[:, :2] -= shift
    corners = places[faces]
    low = np.ceil(corners[:, :, :2].min(axis=1)).clip(0).astype(np.int64)
    high = np.floor(corners[:, :, :2].max(axis=1)).astype(np.int64)
    high = np.minimum(high, [nx - 1, ny - 1])
    sizes = np.maximum(high - low + 1, 0)
    counts = sizes[:, 0] * sizes[:, 1]
    touched = np.flatnonzero(counts)
    ends = np.cumsum(counts[touched])
    start = 0
    while start < len(touched):
        done = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, done + PAIRS_AT_ONCE)))
        some = touched[start:stop]
        face = np.repeat(some, counts[some])
        first = np.repeat(np.cumsum(counts[some]) - counts[some], counts[some])
        at = np.arange(len(face)) - first
        x = low[face, 0] + at // sizes[face, 1]
        y = low[face, 1] + at % sizes[face, 1]
        yield _cut(corners, faces, face, x, y, ny)
        start = stop


def _cut(
    corners: Floats, faces: Ints, face: Longs, x: Longs, y: Longs, ny: int
) -> tuple[Longs, Floats, Longs]:
    """Those pairs of a triangle and a column that meet, as ``_cut_columns`` gives them."""
    is_left = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        # Both faces of an edge see the column on the same side: the ends are taken in one order.
        is_turned = faces[face, a] > faces[face, b]
        p = np.where(is_turned[:, None], corners[face, b, :2], corners[face, a, :2])
        q = np.where(is_turned[:, None], corners[face, a, :2], corners[face, b, :2])
        side = (q[:, 0] - p[:, 0]) * (y - p[:, 1]) - (q[:, 1] - p[:, 1]) * (x - p[:, 0])
        is_left.append((side >= 0.0) != is_turned)
    faces_up = is_left[0] & is_left[1] & is_left[2]
    faces_down = ~(is_left[0] | is_left[1] | is_left[2])
    meets = np.flatnonzero(faces_up | faces_down)
    face, x, y = face[meets], x[meets], y[meets]
    a, b, c = corners[face, 0], corners[face, 1], corners[face, 2]
    normal = np.cross(b - a, c - a)
    offset = normal[:, 0] * (x - a[:, 0]) + normal[:, 1] * (y - a[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        height = a[:, 2] - offset / normal[:, 2]
    # A triangle that is nearly upright has no height to speak of but its own.
    heights = corners[face, :, 2]
    height = np.clip(np.nan_to_num(height, nan=0.0), heights.min(axis=1), heights.max(axis=1))
    return x * ny + y, height, np.where(faces_down[meets], 1, -1)
