"""What a codec gives to the rest of the program: a mesh, and the power to write it back.

A codec parses what it must (positions, faces), keeps the original bytes, and replaces positions
(and normals, where the file has them) inside a copy of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from msal_cli.storage.regular import Buffer


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


@runtime_checkable
class HasVertexProperties(Protocol):
    """A mesh with more numbers at its vertices than positions."""

    def vertex_property(self, name: str) -> NDArray[np.float64]:
        """The scalar property ``name`` of the vertices, (n,); InputError (``E_PROPERTY``) if there
        is none."""
        ...


class MeshFile(Protocol):
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
    faces: NDArray[np.int32]
    merged_vertices: int
    n_polygons: int
    properties: tuple[str, ...]
    references: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def vertices(self) -> NDArray[np.float64]:
        """The positions of the vertices, see above."""
        ...

    def forget_vertices(self) -> None:
        """Let go of ``vertices`` where they can be read again in little time."""
        ...

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
