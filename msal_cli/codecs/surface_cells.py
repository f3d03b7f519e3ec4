"""Elements of simulation formats: those that are a surface, in the order of the file."""

from __future__ import annotations

from collections import Counter

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.errors import UnsupportedError


class SurfaceCells:
    """Polygons (p, k) collected block by block, and what else there is."""

    def __init__(self) -> None:
        self._polygons: list[Longs] = []
        self._counts: Counter[str] = Counter()

    def add(self, kind: str, polygons: Longs) -> None:
        """Add triangles (p, 3) or quadrilaterals (p, 4)."""
        self._counts[kind] += len(polygons)
        self._polygons.append(polygons)

    def count(self, kind: str, count: int) -> None:
        """Count cells that are no surface."""
        self._counts[kind] += count

    def refuse_curved(self, kind: str, count: int) -> None:
        """Raise UnsupportedError where there are second-order surface cells."""
        if count:
            raise UnsupportedError(
                f"the file has second-order surface cells ({count} {kind})",
                hint="write it with first-order triangles or quads",
            )

    def corners(self) -> Longs:
        """The corners (c,) of all polygons, as the file numbers them."""
        none = np.zeros(0, dtype=np.int64)
        return np.concatenate([none, *(one.reshape(-1) for one in self._polygons)])

    def sizes(self) -> Longs:
        """How many corners each polygon (p,) has."""
        none = np.zeros(0, dtype=np.int64)
        rows = (np.full(len(one), one.shape[1], dtype=np.int64) for one in self._polygons)
        return np.concatenate([none, *rows])

    def held(self) -> str:
        """What cells there are, such as ``"3 tetra, 1 line"``."""
        return ", ".join(f"{count} {kind}" for kind, count in self._counts.items() if count)

    def warnings(self) -> tuple[str, ...]:
        """What a user should know of the cells."""
        flat = ("triangle", "quad", "line", "vertex", "corner", "edge")
        others = [
            f"{count} {kind}" for kind, count in self._counts.items() if count and kind not in flat
        ]
        if not others:
            return ()
        return (f"other cells ({', '.join(others)}) are kept; their corners move with the surface",)
