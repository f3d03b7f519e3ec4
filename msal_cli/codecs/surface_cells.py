"""Cells of simulation formats: the polygons of a surface in the order of the file, others counted.

Each format has a table from its own names of cells to those used here.
"""

from __future__ import annotations

from collections import Counter

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.slots import UnitSlots
from msal_cli.errors import UnsupportedError

CORNERS = {"triangle": 3, "quad": 4, "pixel": 4}
"""Surface cells of one size; a pixel has its corners row by row."""

CURVED = "curved"
"""Surface cells of second order, which are refused."""

_FLAT = (*CORNERS, "polygon", "strip", "line", "edge", "vertex", "corner")
_PIXEL = np.array([0, 1, 3, 2])
_NONE = np.zeros(0, dtype=np.int64)


class SurfaceCells:
    """Polygons collected block by block, and how many cells of each kind there are."""

    def __init__(self) -> None:
        self._corners: list[Longs] = [_NONE]
        self._sizes: list[Longs] = [_NONE]
        self._counts: Counter[str] = Counter()
        self._small = 0

    def add(self, kind: str, rows: Longs) -> None:
        """Add cells of one size, ``rows`` (p, k) being their corners."""
        if kind == "pixel":
            rows = rows[:, _PIXEL]
        self.add_polygons(kind, rows.reshape(-1), np.full(len(rows), rows.shape[1], np.int64))

    def add_polygons(self, kind: str, corners: Longs, sizes: Longs) -> None:
        """Add polygons of ``sizes`` (p,) with ``corners`` (c,); those of fewer than three corners
        are left out."""
        self._counts[kind] += len(sizes)
        is_face = sizes >= 3
        if not is_face.all():
            self._small += int(np.count_nonzero(~is_face))
            corners, sizes = corners[np.repeat(is_face, sizes)], sizes[is_face]
        self._corners.append(corners)
        self._sizes.append(sizes)

    def add_strips(self, corners: Longs, sizes: Longs) -> None:
        """Add triangle strips of ``sizes`` (p,) with ``corners`` (c,) as triangles."""
        self._counts["strip"] += len(sizes)
        triangles = corners[strip_triangles(sizes)]
        self._corners.append(triangles.reshape(-1))
        self._sizes.append(np.full(len(triangles), 3, dtype=np.int64))

    def count(self, kind: str, count: int) -> None:
        """Count cells that are no surface."""
        self._counts[kind] += count

    def sort(self, kind: str, count: int, name: str = "") -> int:
        """How many corners ``count`` cells of a kind have that are to be added; 0 for others.

        Those that are no surface are counted; UnsupportedError for curved ones, which the file
        calls ``name``.
        """
        if kind == CURVED:
            self.refuse_curved(name, count)
        elif kind not in CORNERS:
            self.count(kind, count)
        return CORNERS.get(kind, 0)

    def refuse_curved(self, name: str, count: int) -> None:
        """Raise UnsupportedError where there are surface cells of second order."""
        if count:
            raise UnsupportedError(
                f"the file has second-order surface cells ({count} {name})",
                hint="write it with first-order triangles or quads",
            )

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
        """What a user should know of the cells."""
        others = {kind: n for kind, n in self._counts.items() if n and kind not in _FLAT}
        listed = ", ".join(f"{n} {kind}" for kind, n in others.items())
        n_strips = self._counts["strip"]
        warnings = (
            listed and f"other cells ({listed}) are kept; their corners move with the surface",
            n_strips and f"{n_strips} triangle strips are read as triangles, and kept",
            self._small
            and f"{self._small} polygons of fewer than three corners are kept and left out",
        )
        return tuple(str(one) for one in warnings if one)

    def content(
        self,
        positions: UnitSlots,
        precision: str = "text",
        *,
        encoding: str = "",
        corners: Longs | None = None,
        normals: tuple[UnitSlots, ...] = (),
        properties: tuple[str, ...] = (),
        warnings: tuple[str, ...] = (),
    ) -> Layout:
        """What a file of these cells holds; ``corners`` (c,) count vertices from 0, by default
        they are the file's own numbers."""
        return Layout(
            encoding or ("ascii" if precision == "text" else "binary"),
            precision,
            (positions,),
            self.corners() if corners is None else corners,
            self.sizes(),
            normals,
            properties=properties,
            warnings=(*self.warnings(), *warnings),
            held=self.describe(),
        )


def strip_triangles(sizes: Longs, *, is_fan: bool = False) -> Longs:
    """The triangles (m, 3) of strips, or fans, of ``sizes`` (p,) as places among their corners.

    Each triangle of a strip is turned like the first.
    """
    n_triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(np.cumsum(sizes) - sizes, n_triangles)
    inside = np.arange(len(first)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    if is_fan:
        return np.stack([first, first + inside + 1, first + inside + 2], axis=1)
    odd, at = inside % 2, first + inside
    return np.stack([at + odd, at + 1 - odd, at + 2], axis=1)


def runs_of(values: Longs) -> list[slice]:
    """Runs of equal numbers among ``values`` (n,), in order; none are negative."""
    starts = np.flatnonzero(np.diff(values, prepend=-1))
    return [slice(*pair) for pair in zip(starts, [*starts[1:], len(values)], strict=False)]
