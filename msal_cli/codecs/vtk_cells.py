"""VTK's cells, of legacy and of XML files: those that are a surface, and those that are not."""

from __future__ import annotations

from collections import Counter

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.errors import EXPORT_AGAIN, FormatError, UnsupportedError

_NAMES = {
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
_SIZES = {"triangle": 3, "pixel": 4, "quad": 4}
_CURVED = {22, 23, 28, 30, 32, 34, 36, 69, 70, 76, 77}
_PIXEL = np.array([0, 1, 3, 2])


class Surface:
    """The polygons of a file, in its order; strips are cut into triangles."""

    def __init__(self) -> None:
        self._polygons: list[tuple[Longs, Longs]] = []
        self._counts: Counter[str] = Counter()
        self._strips = self._small = 0

    def add(self, kind: str, offsets: Longs, corners: Longs) -> None:
        """Add cells of one kind: ``offsets`` (k + 1,) into ``corners``."""
        sizes = np.diff(offsets)
        self._counts[kind] += len(sizes)
        if kind in _SIZES and (sizes != _SIZES[kind]).any():
            raise FormatError(
                f"a {kind} has {int(sizes[sizes != _SIZES[kind]][0])} corners", hint=EXPORT_AGAIN
            )
        if kind == "strip":
            self._strips += len(sizes)
            self._polygons.append(_strip_triangles(offsets, corners))
        elif kind == "pixel":
            self._polygons.append((corners.reshape(-1, 4)[:, _PIXEL].reshape(-1), sizes))
        elif kind in ("triangle", "quad", "polygon"):
            is_face = sizes >= 3
            if not is_face.all():
                self._small += int(np.count_nonzero(~is_face))
                corners = corners[np.repeat(is_face, sizes)]
            self._polygons.append((corners, sizes[is_face]))

    def add_layer(self, dimensions: list[int], n_points: int) -> None:
        """Add the quadrilaterals of a structured grid that is one layer thick."""
        if len(dimensions) != 3 or dimensions[0] * dimensions[1] * dimensions[2] != n_points:
            raise FormatError("DIMENSIONS and POINTS do not agree", hint=EXPORT_AGAIN)
        rows = [one for one in dimensions if one > 1]
        if len(rows) != 2:
            self._counts["block of cells" if len(rows) == 3 else "row of points"] += 1
            return
        place = np.arange(n_points, dtype=np.int64).reshape(rows[1], rows[0])
        quads = np.stack([place[:-1, :-1], place[:-1, 1:], place[1:, 1:], place[1:, :-1]], axis=-1)
        self.add("quad", 4 * np.arange(quads.size // 4 + 1, dtype=np.int64), quads.reshape(-1))

    def polygons(self) -> tuple[Longs, Longs]:
        """Corners (c,) and sizes (p,)."""
        none = np.zeros(0, dtype=np.int64)
        corners = np.concatenate([none, *(one[0] for one in self._polygons)])
        return corners, np.concatenate([none, *(one[1] for one in self._polygons)])

    def held(self) -> str:
        """What cells there are, such as ``"3 tetra, 1 line"``."""
        return ", ".join(f"{count} {kind}" for kind, count in self._counts.items() if count)

    def warnings(self) -> list[str]:
        """What a user should know of the cells."""
        result = []
        others = [
            f"{count} {kind}"
            for kind, count in self._counts.items()
            if count and kind not in (*_SIZES, "polygon", "strip", "line", "vertex")
        ]
        if others:
            result.append(
                f"other cells ({', '.join(others)}) are kept; their corners move with the surface"
            )
        if self._strips:
            result.append(f"{self._strips} triangle strips are read as triangles, and kept")
        if self._small:
            result.append(
                f"{self._small} polygons of fewer than three corners are kept and left out"
            )
        return result


def surface_of(types: Longs, offsets: Longs, corners: Longs, surface: Surface) -> None:
    """Add the cells of an unstructured grid, ``types`` (k,) being VTK's numbers, to a surface.

    Raises UnsupportedError for curved cells.
    """
    if len(types) != len(offsets) - 1:
        raise FormatError("there are not as many types as cells", hint=EXPORT_AGAIN)
    curved = sorted(_CURVED.intersection(np.unique(types).tolist()))
    if curved:
        n_curved = int(np.isin(types, curved).sum())
        raise UnsupportedError(
            f"the file has second-order surface cells ({n_curved})",
            hint="write it with first-order triangles or quads",
        )
    # Runs of one type, so that the order of the file is kept.
    starts = np.flatnonzero(np.diff(types, prepend=-1))
    if len(starts) > 1000:
        # Types in turns: the same polygons in their order, cell by cell only where they must be.
        _add_mixed(types, offsets, corners, surface)
        return
    for start, stop in zip(starts, [*starts[1:], len(types)], strict=False):
        own = offsets[start : stop + 1]
        kind = _NAMES.get(int(types[start]), f"cell of type {int(types[start])}")
        surface.add(kind, own - own[0], corners[own[0] : own[-1]])


def _add_mixed(types: Longs, offsets: Longs, corners: Longs, surface: Surface) -> None:
    """Add cells type by type, polygons of every kind together in the file's order."""
    is_flat = np.isin(types, (5, 7, 9))
    sizes = np.diff(offsets)
    for kind, wanted in (("triangle", 5), ("quad", 9)):
        if (sizes[types == wanted] != _SIZES[kind]).any():
            raise FormatError(f"a {kind} has not {_SIZES[kind]} corners", hint=EXPORT_AGAIN)
    groups = [("polygon", is_flat)]
    groups += [
        (_NAMES.get(one, f"cell of type {one}"), types == one)
        for one in np.unique(types[~is_flat]).tolist()
    ]
    for kind, chosen in groups:
        own = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes[chosen])])
        surface.add(kind, own, corners[np.repeat(chosen, sizes)])


def _strip_triangles(offsets: Longs, corners: Longs) -> tuple[Longs, Longs]:
    """Corners and sizes of the triangles of strips, each turned like the first."""
    sizes = np.diff(offsets)
    n_triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(offsets[:-1], n_triangles)
    inside = np.arange(len(first)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    odd = inside % 2
    at = first + inside
    triangles = np.stack([corners[at + odd], corners[at + 1 - odd], corners[at + 2]], axis=1)
    return triangles.reshape(-1), np.full(len(triangles), 3, dtype=np.int64)
