"""What a codec gives to the rest of the program: a mesh, and the power to write it back.

A codec parses what it must (positions, faces), keeps the original bytes, and replaces positions
(and normals, where the file has them) inside a copy of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.codecs.slots import Slots
from msal_cli.errors import ContentError
from msal_cli.storage.regular import Buffer
from msal_cli.structs import dataclass


@dataclass(frozen=True, eq=False)
class Companion:
    """A file that an output needs in its folder: the relative path, with slashes, and the bytes."""

    name: str
    data: Buffer


class Surface(Protocol):
    """What can be denoised: a mesh file, several as one, or one in memory; see ``MeshFile`` for the
    attributes."""

    faces: NDArray[np.int32]
    merged_vertices: int

    @property
    def vertices(self) -> NDArray[np.float64]:
        """The positions (n, 3) of the vertices."""
        ...

    def forget_vertices(self) -> None:
        """Let go of ``vertices`` where they can be read again in little time."""
        ...


class MeshFile(Surface, Protocol):
    """An opened mesh file; every codec returns one.

    Attributes
    ----------
    format : ``"ply"``, ``"obj"``, ``"stl"``, or the suffix of a format read by a library.
    encoding : ``"ascii"``, ``"binary_little_endian"``, ``"binary_big_endian"`` or ``"binary"``.
    precision : ``"float32"``, ``"float64"``, ``"text"`` or ``"integer"``: how positions are stored.
    vertices : (n, 3) float64, file units, in file order, exactly the values that the file stores.
    faces : (m, 3) int32, indices into ``vertices``, counter-clockwise seen from outside; polygons
        are cut into triangles and strips are unrolled, for the mathematics only.
    merged_vertices : vertices of the file that ``vertices`` leaves out because an earlier one is at
        the same position, as corners of STL's facets are; then no two of ``vertices`` are alike.
    n_polygons : faces as the file counts them (a quad is one).
    properties : what else is carried along unchanged, for reports: ``"vertex.quality float"``,
        ``"element camera"``, ``"texture coordinates"``, ``"materials"``, ``"groups"`` ...
    references : other files that this one names (materials, textures), as written in the file.
    warnings : what a user should know about this file although it could be read.
    """

    format: str
    encoding: str
    precision: str
    n_polygons: int
    properties: tuple[str, ...]
    references: tuple[str, ...]
    warnings: tuple[str, ...]

    def replaced(self, vertices: NDArray[np.float64]) -> Buffer:
        """The file with its positions replaced and its normals, where it has them, recomputed.

        ``vertices`` is (n, 3) float64 in file order.  A vertex equal to the stored one keeps its
        very bytes; with no vertex moved the result is the input byte for byte.
        """
        ...

    def check(self, output: Buffer, vertices: NDArray[np.float64]) -> None:
        """Raise InternalError unless ``output`` is this file with only positions (and normals)
        replaced, by ``vertices`` up to the rounding that the file's number type asks for."""
        ...

    def encoded(self, vertices: NDArray[np.float64], encoding: str, precision: str) -> Buffer:
        """The file in the same format with new positions, re-encoded.

        ``encoding`` is ``same``, ``ascii`` or ``binary``, ``precision`` ``same``, ``float32`` or
        ``float64``.  Raises UnsupportedError where the format cannot.
        """
        ...

    def polygons(self) -> list[Any] | NDArray[np.int32]:
        """The faces as the file has them, for conversion: an (m, k) array or a list of arrays."""
        ...


def has_same_grid(mesh: object, other: object) -> bool:
    """Whether both are range grids of the same samples.

    Their vertices correspond, even where their triangles, which depend on positions, differ.
    """
    own, others = getattr(mesh, "grid", None), getattr(other, "grid", None)
    return own is not None and others is not None and np.array_equal(own, others)


def corner_count(mesh_file: MeshFile) -> int | None:
    """Corners that a file stores where it has no vertices of its own (STL), None for others."""
    n_merged = mesh_file.merged_vertices
    return len(mesh_file.vertices) + n_merged if n_merged else None


_MAX_CONDITION = 1e6
_MAX_ENTRY = 1e30
"""Larger entries of a frame could take float32 positions beyond what can be computed with."""

_IDENTITY = np.eye(4)

PLACEMENT = "placement in the scene"
"""Among the properties of a scene whose only mesh is denoised in its own frame, while the scene
turns, scales or shifts it."""


def is_usable(frame: Floats) -> bool:
    """Whether positions can be taken through a frame and back without harm."""
    try:
        with np.errstate(all="ignore"):
            is_steep = not np.linalg.cond(frame[:3, :3]) < _MAX_CONDITION
    except np.linalg.LinAlgError:
        return False
    return not is_steep and bool(np.abs(frame).max() < _MAX_ENTRY)


def is_placed(frame: Floats) -> bool:
    """Whether a frame puts a mesh elsewhere than where its own numbers put it."""
    return not np.array_equal(frame, _IDENTITY)


def transform(points: Floats, frame: Floats) -> Floats:
    """Points (n, 3) after a transform; bit for bit the same for the identity.

    Those that are too large for it become infinite.
    """
    if not is_placed(frame):
        return points
    with np.errstate(over="ignore", invalid="ignore"):
        result: Floats = points @ frame[:3, :3].T + frame[:3, 3]
    return result


_NONE = np.empty(0, dtype=np.int64)


@dataclass(eq=False)
class Layout:
    """What a parser makes of a file.

    Attributes
    ----------
    encoding, precision : as in ``mesh_file.MeshFile``.
    positions : arrays of positions (n_i, 3), whose rows one behind the other are the vertices;
        ``RecordSlots`` in binary files.
    corners : (c,) int64, the vertices of all surface polygons, one polygon behind the other.
    sizes : (p,) int64, how many corners each polygon has, at least 3.
    faces : (m, 3) int32, the triangles, where the parser has made them and checked them and the
        positions; then ``corners`` and ``sizes`` are for the codec alone, empty where all polygons
        are triangles.
    vertices : (n, 3), where the parser has read them; the file takes them over.
    normals : arrays of normals (g_i, 3); the usual renewal takes one for each vertex.
    renew_normals : makes of the old and the new vertices each array of normals (g_i, 3), and says
        which rows changed (g_i,); None for the usual way, which knows no ``frames``.
    frames : for each array of positions, the transform (4, 4) from it to the vertices; empty where
        they are the same.
    held : what cells the file has, for the message where none is a surface.
    """

    encoding: str
    precision: str
    positions: tuple[Slots, ...]
    corners: Longs | Ints = field(default_factory=lambda: _NONE)
    sizes: Longs | Ints = field(default_factory=lambda: _NONE)
    normals: tuple[Slots, ...] = ()
    frames: tuple[Floats, ...] = ()
    properties: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    held: str = ""
    faces: Ints | None = None
    vertices: Floats | None = None
    renew_normals: Callable[[Floats, Floats], Sequence[tuple[Floats, Flags]]] | None = None


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


def cut_polygons(corners: Ints, sizes: Ints | Longs) -> Ints:
    """Triangles (m, 3) that share each polygon's first corner; a view where all are triangles.

    ``corners`` (c,) are those of the polygons one behind the other, ``sizes`` (p,) how many each
    has; a polygon of fewer than three gives none.
    """
    if len(corners) == 3 * len(sizes) and bool((sizes == 3).all()):
        return corners.reshape(-1, 3)
    from msal_cli.kernels import ply_scan

    triangles = np.empty((int(np.maximum(sizes - 2, 0).sum()), 3), dtype=np.int32)
    ply_scan.fans(corners, np.ascontiguousarray(sizes), triangles)
    return triangles
