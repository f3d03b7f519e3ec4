"""What the parser of a format makes of a file: where its arrays are, and its surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.codecs.frames import transform
from msal_cli.codecs.slots import Slots
from msal_cli.codecs.tokens import require_indices
from msal_cli.errors import ContentError
from msal_cli.storage.regular import Buffer

Shift = Callable[[int], int]
"""By how many bytes a place of the input moves, new positions and normals being written."""


@dataclass(frozen=True, eq=False)
class Dependent:
    """Bytes that depend on positions: counts of bytes up to a place, or bounds.

    ``text(old, positions, shift)`` are the bytes that stand for ``old``.
    """

    start: int
    stop: int
    text: Callable[[bytes, Sequence[Floats], Shift], bytes]


def _empty() -> Longs:
    return np.empty(0, dtype=np.int64)


@dataclass(eq=False)
class Layout:
    """What a parser makes of a file.

    Attributes
    ----------
    encoding, precision : as in ``mesh_file.MeshFile``.
    positions : arrays of positions (n_i, 3), whose rows one behind the other are the vertices;
        ``RecordSlots`` in binary files, in which nothing else depends on them, else ``UnitSlots``.
    corners : (c,) int64, the vertices of all surface polygons, one polygon behind the other.
    sizes : (p,) int64, how many corners each polygon has, at least 3.
    faces : (m, 3) int32, the triangles, where the parser has made them and checked them and the
        positions; then ``corners`` and ``sizes`` are for the codec alone, empty where all polygons
        are triangles.
    vertices : (n, 3), where the parser has read them; the file takes them over.
    normals : arrays of normals (g_i, 3).
    normal_of_corner : (c,) int64, the normal that each corner uses, -1 for none; None where each
        vertex has its own.
    renew_normals : makes of the old and the new vertices each array of normals (g_i, 3), and says
        which rows changed (g_i,); None for the usual way.
    frames : for each array of positions, the transform (4, 4) from it to the vertices; empty where
        they are the same.
    held : what cells the file has, for the message where none is a surface.
    dependents : what else changes with positions, none of it inside a unit of theirs.
    """

    encoding: str
    precision: str
    positions: tuple[Slots, ...]
    corners: Longs | Ints = field(default_factory=_empty)
    sizes: Longs | Ints = field(default_factory=_empty)
    normals: tuple[Slots, ...] = ()
    normal_of_corner: Longs | None = None
    frames: tuple[Floats, ...] = ()
    properties: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    held: str = ""
    dependents: tuple[Dependent, ...] = ()
    faces: Ints | None = None
    vertices: Floats | None = None
    renew_normals: Callable[[Floats, Floats], Sequence[tuple[Floats, Flags]]] | None = None


Parse = Callable[[Buffer], Layout]


def build_triangles(layout: Layout, vertices: Floats) -> tuple[Ints, Longs]:
    """Triangles (m, 3), and the places of their corners among those of the polygons.

    Raises ContentError for a layout that is no mesh.
    """
    if not len(layout.sizes):
        raise ContentError(
            f"the file has no surface faces; it holds {layout.held or 'nothing'}",
            code="E_NO_FACES",
            hint="msal denoises surfaces; extract the surface of a volume mesh first",
        )
    require_finite(vertices)
    corners = layout.corners.astype(np.int64, copy=False)
    require_indices(corners, len(vertices))
    places = np.stack(fans(layout.sizes.astype(np.int64, copy=False)), axis=1)
    return corners[places].astype(np.int32), places


def build_vertices(layout: Layout) -> Floats:
    if not layout.frames:
        values = [one.values for one in layout.positions]
        return values[0] if len(values) == 1 else np.concatenate(values)
    return np.concatenate(
        [
            transform(one.values, frame)
            for one, frame in zip(layout.positions, layout.frames, strict=True)
        ]
    )


def require_finite(
    vertices: NDArray[Any], where: Callable[[int], str] = "vertex {}".format
) -> None:
    """Raise ContentError (``E_NONFINITE``) where a position (n, 3) is NaN or infinite.

    ``where`` says in words where a vertex is stored.
    """
    # A sum is finite only if all are, and quicker; it may overflow, too.
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(vertices.sum()):
            return
    is_finite = np.isfinite(vertices).all(axis=1)
    if not is_finite.all():
        vertex = int(np.argmin(is_finite))
        raise ContentError(
            f"vertex {vertex} has a coordinate that is not a finite number",
            where=where(vertex),
            hint="remove such vertices, or export the scan again",
            code="E_NONFINITE",
        )


def fans(sizes: Longs) -> tuple[Longs, Longs, Longs]:
    """Places among the corners of triangles that share each polygon's first corner."""
    n_triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(np.cumsum(sizes) - sizes, n_triangles)
    inside = np.arange(len(first)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    return first, first + inside + 1, first + inside + 2
