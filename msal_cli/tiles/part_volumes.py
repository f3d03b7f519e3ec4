"""What each connected part of a closed surface encloses, from what the tiles have of it.

In the folder of a tile, ``part_figures.npy`` (k, 10) has for each of its parts the number among
those of the whole, the area before, the signed volumes before and after, and least and greatest
coordinates before, about the origin of the whole mesh.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis.enclosure import turned_parts
from msal_cli.tiles import borders
from msal_cli.tiles.part_files import save_array

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from msal_cli.analysis.measures import SurfaceChange
    from msal_cli.arrays import Floats, Ints
    from msal_cli.tiles.part_files import TileMesh

_FIGURES = "part_figures.npy"
_BLOCK_FACES = 1 << 16
_AREA, _BEFORE, _AFTER = range(3)


def save_figures(folder: Path, mesh: TileMesh, moved: Floats) -> None:
    """Write the figures of a tile's parts, whose vertices came to ``moved`` (n, 3)."""
    parts = borders.number_parts(folder, mesh)
    own = np.flatnonzero(mesh.own_vertices)
    # Corners of own faces that belong to others count there.
    numbers = np.unique(parts[own])
    sums = np.zeros((len(numbers), 3))
    own_faces = np.flatnonzero(mesh.own_faces)
    for start in range(0, len(own_faces), _BLOCK_FACES):
        faces = mesh.faces[own_faces[start : start + _BLOCK_FACES]]
        at = np.searchsorted(numbers, parts[faces[:, 0]])
        for column, values in enumerate(_measure_faces(mesh.vertices, moved, faces)):
            sums[:, column] += np.bincount(at, values, len(numbers))
    order = own[np.argsort(parts[own], kind="stable")]
    starts = np.searchsorted(parts[order], numbers)
    positions = mesh.vertices[order]
    low, high = (least.reduceat(positions, starts) for least in (np.minimum, np.maximum))
    save_array(folder / _FIGURES, np.column_stack([numbers, sums, low, high]))


def turn_outwards(
    folders: Iterable[Path], n_parts: int, change: SurfaceChange
) -> tuple[SurfaceChange, int]:
    """``change`` with the volumes that are enclosed in place of the signed ones, and how many of
    the parts are inside out."""
    sums = np.zeros((n_parts, 3))
    low, high = np.full((n_parts, 3), np.inf), np.full((n_parts, 3), -np.inf)
    for folder in folders:
        rows = np.load(folder / _FIGURES)
        numbers = rows[:, 0].astype(np.intp)
        sums[numbers] += rows[:, 1:4]
        low[numbers] = np.minimum(low[numbers], rows[:, 4:7])
        high[numbers] = np.maximum(high[numbers], rows[:, 7:])
    is_turned = turned_parts(sums[:, _BEFORE], sums[:, _AREA], lambda: (low, high))
    if not is_turned.any():
        return change, 0
    signs = np.where(is_turned, -1.0, 1.0)
    enclosed = replace(
        change,
        volume_before=float((signs * sums[:, _BEFORE]).sum()),
        volume_after=float((signs * sums[:, _AFTER]).sum()),
    )
    return enclosed, int(np.count_nonzero(is_turned))


def _measure_faces(before: Floats, after: Floats, faces: Ints) -> tuple[Floats, Floats, Floats]:
    """Areas before, and volumes before and after that faces (m, 3) span with the origin."""
    a, b, c = (before[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    areas = np.sqrt((normals * normals).sum(axis=1)) / 2.0
    a_after, b_after, c_after = (after[faces[:, corner]] for corner in range(3))
    normals_after = np.cross(b_after - a_after, c_after - a_after)
    return (
        areas,
        (a * normals).sum(axis=1) / 6.0,
        (a_after * normals_after).sum(axis=1) / 6.0,
    )
