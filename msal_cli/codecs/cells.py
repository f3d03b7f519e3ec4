"""VTK's cells: the polygons of a surface in the order of the file, others counted."""

from __future__ import annotations

from collections import Counter

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.errors import UnsupportedError, damaged

_CURVED = (22, 23, 28, 30, 32, 34, 36, 69, 70, 76, 77)
"""Types of surface cells of second order, which are refused."""

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
}
_CORNERS = {"triangle": 3, "quad": 4, "pixel": 4}
"""Surface cells of one size; a pixel has its corners row by row."""

_FLAT = (*_CORNERS, "polygon", "strip", "line", "vertex")
_POLYGONS = (5, 7, 9)
_PIXEL = np.array([0, 1, 3, 2])
_NONE = np.zeros(0, dtype=np.int64)

_MAX_RUNS = 1000
"""Runs of one type that are added one by one, so that all cells keep the order of the file."""


class Cells:
    """Polygons collected block by block, and how many cells of each kind there are."""

    def __init__(self) -> None:
        self._corners: list[Longs] = [_NONE]
        self._sizes: list[Longs] = [_NONE]
        self._counts: Counter[str] = Counter()
        self._small = 0

    def add(self, kind: str, sizes: Longs, corners: Longs) -> None:
        """Add cells of one kind: ``sizes`` (k,), and their corners one behind the other.

        Cells that are no surface are counted.
        """
        wrong = sizes != _CORNERS.get(kind, sizes)
        if wrong.any():
            raise damaged(f"a {kind} has {int(sizes[wrong][0])} corners")
        self._counts[kind] += len(sizes)
        if kind == "strip":
            triangles = corners[_strip_triangles(sizes)]
            corners, sizes = triangles.reshape(-1), np.full(len(triangles), 3, dtype=np.int64)
        elif kind == "pixel":
            corners = corners.reshape(-1, 4)[:, _PIXEL].reshape(-1)
        elif kind == "polygon" and not (is_face := sizes >= 3).all():
            self._small += int(np.count_nonzero(~is_face))
            corners, sizes = corners[np.repeat(is_face, sizes)], sizes[is_face]
        elif kind not in _CORNERS and kind != "polygon":
            return
        self._corners.append(corners)
        self._sizes.append(sizes)

    def add_types(self, types: Longs, sizes: Longs, corners: Longs) -> None:
        """Add the cells of an unstructured grid, ``types`` (k,) being VTK's numbers."""
        if len(types) != len(sizes):
            raise damaged("there are not as many types as cells")
        if n_curved := int(np.isin(types, _CURVED).sum()):
            raise UnsupportedError(
                f"the file has second-order surface cells ({n_curved} cells)",
                hint="write it with first-order triangles or quads",
            )
        names = {
            value: _KINDS.get(value, f"cell of type {value}") for value in np.unique(types).tolist()
        }
        starts = np.flatnonzero(np.diff(types, prepend=-1))
        if len(starts) <= _MAX_RUNS:
            ends = np.cumsum(sizes)
            for start, stop in zip(starts, [*starts[1:], len(types)], strict=False):
                own = corners[ends[start] - sizes[start] : ends[stop - 1]]
                self.add(names[int(types[start])], sizes[start:stop], own)
            return
        # Types in turns: polygons together in the order of the file, then the others by type.
        for type in (5, 9):
            kind = _KINDS[type]
            if ((types == type) & (sizes != _CORNERS[kind])).any():
                raise damaged(f"a {kind} has not {_CORNERS[kind]} corners")
        groups = [("polygon", np.isin(types, _POLYGONS))]
        groups += [(name, types == one) for one, name in names.items() if one not in _POLYGONS]
        for kind, chosen in groups:
            self.add(kind, sizes[chosen], corners[np.repeat(chosen, sizes)])

    def add_layer(self, dimensions: list[int], n_points: int) -> None:
        """Add the quadrilaterals of a structured grid that is one layer thick."""
        if len(dimensions) != 3 or dimensions[0] * dimensions[1] * dimensions[2] != n_points:
            raise damaged("DIMENSIONS and POINTS do not agree")
        rows = [size for size in dimensions if size > 1]
        if len(rows) != 2:
            self._counts["block of cells" if len(rows) == 3 else "row of points"] += 1
            return
        at = np.arange(n_points, dtype=np.int64).reshape(rows[1], rows[0])
        quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], axis=-1)
        self.add("quad", np.full(quads.size // 4, 4, dtype=np.int64), quads.reshape(-1))

    def corners(self) -> Longs:
        """The corners (c,) of all polygons, as the file numbers them."""
        return np.concatenate(self._corners)

    def sizes(self) -> Longs:
        """How many corners each polygon (p,) has."""
        return np.concatenate(self._sizes)

    def describe(self) -> str:
        """What cells there are, such as ``"3 tetra, 1 line"``."""
        return ", ".join(f"{count} {kind}" for kind, count in self._counts.items() if count)

    def warnings(self) -> tuple[str, ...]:
        others = {kind: n for kind, n in self._counts.items() if n and kind not in _FLAT}
        listed = ", ".join(f"{n} {kind}" for kind, n in others.items())
        n_strips = self._counts["strip"]
        warnings = (
            listed and f"other cells ({listed}) are kept; their corners move with the surface",
            n_strips and f"{n_strips} triangle strips are read as triangles, and kept",
            self._small
            and f"{self._small} polygons of fewer than three corners are kept and left out",
        )
        return tuple(str(warning) for warning in warnings if warning)


def _strip_triangles(sizes: Longs) -> Longs:
    """The triangles (m, 3) of strips of ``sizes`` (p,) as places among their corners.

    Each triangle of a strip is turned like the first.
    """
    n_triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(np.cumsum(sizes) - sizes, n_triangles)
    inside = np.arange(len(first)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    odd, at = inside % 2, first + inside
    return np.stack([at + odd, at + 1 - odd, at + 2], axis=1)
