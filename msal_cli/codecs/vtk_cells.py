"""VTK's types of cells, of legacy and of XML files."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.surface_cells import CORNERS, CURVED, SurfaceCells, runs_of
from msal_cli.errors import EXPORT_AGAIN, FormatError

_KINDS = {
    1: "vertex",
    2: "vertex",
    3: "line",
    4: "line",
    5: "triangle",
    6: "strip",
    7: "polygon",
    8: "pixel",
    9: "quad",
    10: "tetra",
    11: "voxel",
    12: "hexahedron",
    13: "wedge",
    14: "pyramid",
    42: "polyhedron",
    **dict.fromkeys((22, 23, 28, 30, 32, 34, 36, 69, 70, 76, 77), CURVED),
}
_POLYGONS = (5, 7, 9)
_MOST_RUNS = 1000
"""Runs of one type that are added one by one, so that all cells keep the order of the file."""


def add_cells(cells: SurfaceCells, kind: str, sizes: Longs, corners: Longs) -> None:
    """Add cells of one kind: ``sizes`` (k,), and their corners one behind the other."""
    wrong = sizes != CORNERS.get(kind, sizes)
    if wrong.any():
        raise FormatError(f"a {kind} has {int(sizes[wrong][0])} corners", hint=EXPORT_AGAIN)
    if kind == "strip":
        cells.add_strips(corners, sizes)
    elif kind == "polygon":
        cells.add_polygons(kind, corners, sizes)
    elif size := cells.sort(kind, len(sizes)):
        cells.add(kind, corners.reshape(-1, size))


def add_cells_of_types(cells: SurfaceCells, types: Longs, sizes: Longs, corners: Longs) -> None:
    """Add the cells of an unstructured grid, ``types`` (k,) being VTK's numbers.

    Raises UnsupportedError for curved cells.
    """
    if len(types) != len(sizes):
        raise FormatError("there are not as many types as cells", hint=EXPORT_AGAIN)
    names = {one: _KINDS.get(one, f"cell of type {one}") for one in np.unique(types).tolist()}
    curved = [one for one, kind in names.items() if kind == CURVED]
    cells.refuse_curved("cells", int(np.isin(types, curved).sum()))
    runs = runs_of(types)
    if len(runs) <= _MOST_RUNS:
        stops = np.cumsum(sizes)
        for run in runs:
            own = corners[stops[run.start] - sizes[run.start] : stops[run.stop - 1]]
            add_cells(cells, names[int(types[run.start])], sizes[run], own)
        return
    # Types in turns: polygons together in the order of the file, then the others type by type.
    for type in (5, 9):
        wrong = (types == type) & (sizes != CORNERS[_KINDS[type]])
        if wrong.any():
            kind = _KINDS[type]
            raise FormatError(f"a {kind} has not {CORNERS[kind]} corners", hint=EXPORT_AGAIN)
    groups = [("polygon", np.isin(types, _POLYGONS))]
    groups += [(name, types == one) for one, name in names.items() if one not in _POLYGONS]
    for kind, chosen in groups:
        add_cells(cells, kind, sizes[chosen], corners[np.repeat(chosen, sizes)])


def add_layer(cells: SurfaceCells, dimensions: list[int], n_points: int) -> None:
    """Add the quadrilaterals of a structured grid that is one layer thick."""
    if len(dimensions) != 3 or dimensions[0] * dimensions[1] * dimensions[2] != n_points:
        raise FormatError("DIMENSIONS and POINTS do not agree", hint=EXPORT_AGAIN)
    rows = [one for one in dimensions if one > 1]
    if len(rows) != 2:
        cells.count("block of cells" if len(rows) == 3 else "row of points", 1)
        return
    at = np.arange(n_points, dtype=np.int64).reshape(rows[1], rows[0])
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], axis=-1)
    cells.add("quad", quads.reshape(-1, 4))
