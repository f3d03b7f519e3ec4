"""Meshes in memory as the pipeline reads them: from arrays, or from objects of other libraries."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msal_cli.api.explanations import ARRAYS
from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.layout import fans
from msal_cli.errors import ContentError, InputError, MsalError

Array = NDArray[Any]


@dataclass(eq=False)
class MemoryMesh:
    """A mesh that is not in a file; ``codecs.mesh_file.Surface`` says what the pipeline reads.

    Attributes
    ----------
    vertices : (n, 3) float64.
    faces : (m, 3) integers, triangles.
    dtype : number type of the positions that were given, and of those that go back.
    name : what records and errors call it.
    properties : numbers at the vertices, (n,) each, by name.
    copy_with : makes a copy of the object that was given with other positions (n, 3).
    """

    vertices: Floats
    faces: Array
    dtype: np.dtype[Any]
    name: str = ARRAYS
    properties: Mapping[str, Array] = field(default_factory=dict)
    copy_with: Callable[[Array], Any] = lambda vertices: vertices
    merged_vertices: int = 0

    def forget_vertices(self) -> None:
        """Nothing: they cannot be read again."""

    def vertex_property(self, name: str) -> Floats:
        """The numbers (n,) of one name; InputError (``E_PROPERTY``) if there are none."""
        if name not in self.properties:
            known = ", ".join(self.properties)
            raise InputError(
                f"{self.name}: there is no vertex property {name!r}",
                code="E_PROPERTY",
                hint=f"it has: {known}" if known else "it has none; give an array (n,)",
            )
        given = as_array(self.properties[name], f"the values of {name}")
        values = np.ascontiguousarray(given, dtype=np.float64).reshape(-1)
        if len(values) != len(self.vertices):
            raise ContentError(
                f"{name}: there are {len(values)} values for {len(self.vertices)} vertices"
            )
        return values

    def to_given_type(self, vertices: Floats) -> Array:
        """New positions (n, 3) in the number type of those that were given."""
        with np.errstate(over="ignore"):
            rounded = vertices.astype(self.dtype)
        if self.dtype.itemsize < 8 and not np.isfinite(rounded).all():
            raise ContentError(
                f"a new position is too large for {self.dtype}",
                code="E_RANGE",
                hint="give float64",
            )
        # What did not move is what was given, to the last bit; an own array in any case.
        return rounded


def from_arrays(
    vertices: ArrayLike,
    faces: ArrayLike,
    name: str = ARRAYS,
    properties: Mapping[str, Array] | None = None,
    copy_with: Callable[[Array], Any] = lambda vertices: vertices,
) -> MemoryMesh:
    """The mesh of vertices (n, 3), any real numbers, and triangles (m, 3), any integers.

    Raises
    ------
    ContentError
        for other shapes and types, and where there are no faces (``E_NO_FACES``).
    """
    positions, corners = as_array(vertices, "vertices"), as_array(faces, "faces")
    if positions.dtype.kind not in "fiu":
        raise ContentError(
            f"vertices are {positions.dtype}, not real numbers", hint="give float64 or float32"
        )
    if not corners.size:
        raise ContentError(
            "there are no faces",
            code="E_NO_FACES",
            hint="msal denoises surfaces; make a mesh of the point cloud first",
        )
    _require_shape(positions, corners)
    is_float = positions.dtype.kind == "f"
    return MemoryMesh(
        np.ascontiguousarray(positions, dtype=np.float64),
        corners,
        positions.dtype if is_float else np.dtype(np.float64),
        name,
        properties or {},
        copy_with,
    )


def _require_shape(vertices: Array, faces: Array) -> None:
    """Refuse what is no (n, 3) and (m, 3), and indices beyond the vertices, with what to give
    instead; ContentError."""
    n = len(vertices)
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ContentError(
            f"vertices have shape {vertices.shape}, not (n, 3)", hint=_hint(vertices, "vertices")
        )
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ContentError(
            f"faces have shape {faces.shape}, not (m, 3)", hint=_hint(faces, "faces")
        )
    if faces.dtype.kind not in "iu":
        raise ContentError(
            f"face indices are {faces.dtype}, not integers",
            code="E_INDEX",
            hint="give faces.astype(int) if they are whole numbers",
        )
    low, high = int(faces.min()), int(faces.max())
    if low < 0 or high >= n:
        at, corner = np.argwhere((faces < 0) | (faces >= n))[0]
        from_one = low == 1 and high == n
        raise ContentError(
            f"a face names vertex {int(faces[at, corner])} of {n}",
            code="E_INDEX",
            where=f"face {int(at)}",
            hint="the faces count from 1: give faces - 1"
            if from_one
            else f"indices go from 0 to {n - 1}: give the vertices that these faces belong to",
        )


def _hint(array: Array, name: str) -> str:
    """What to give in place of an array of a wrong shape."""
    if array.ndim == 2 and array.shape[0] == 3:
        return f"each row must be one of them: give {name}.T"
    if array.ndim == 1 and array.size % 3 == 0:
        return f"give {name}.reshape(-1, 3)"
    if name == "faces" and array.ndim == 2 and array.shape[1] == 4:
        if (array[:, 0] == 3).all():
            return "each row begins with the number of its corners: give faces[:, 1:]"
        return (
            "cut each quad into two triangles: "
            "numpy.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])"
        )
    return f"give a row of three numbers for each of the {name}"


def as_array(values: ArrayLike, name: str, error: type[MsalError] = ContentError) -> Array:
    """An array of what was given; an ``error`` where its rows are not of one length, or where some
    of it is masked: numpy would drop the mask, and take what is below it for numbers."""
    parts = values if isinstance(values, list | tuple) else (values,)
    if any(isinstance(part, np.ma.MaskedArray) and np.ma.is_masked(part) for part in parts):
        raise error(
            f"{name} have masked values",
            hint="leave the masked elements out, or give them values with .filled()",
        )
    try:
        return np.asarray(values)
    except (TypeError, ValueError) as reason:
        raise error(f"{name} cannot be read as an array: {reason}") from None


def scalar_properties(arrays: Mapping[str, Any], n_vertices: int) -> dict[str, Array]:
    """Those of the arrays that have one real number for each vertex."""
    found = {}
    for name, values in arrays.items():
        # Masks are looked at where the numbers are used.
        array = np.asanyarray(values)
        if array.dtype.kind in "fiub" and array.size == n_vertices == len(array):
            found[str(name)] = array
    return found


def fan_triangles(corners: Longs, sizes: Longs) -> tuple[Longs, Longs]:
    """Triangles (m, 3) of polygons of ``sizes`` (p,) with ``corners`` (c,), cut as the command cuts
    polygons of files, and the polygon (m,) that each is of."""
    triangles = corners[np.stack(fans(sizes), axis=1)]
    return triangles, np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))


def renewed_normals(mesh: MemoryMesh, vertices: Array, entries: Array, normals: Array) -> Array:
    """Stored normals (g, 3) for new positions (n, 3), as the command renews those of files.

    ``entries`` (m, 3) is the normal that each corner of a triangle uses.
    """
    from msal_cli.kernels.geometry import regrouped_normals

    values = np.ascontiguousarray(normals, dtype=np.float64)
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int32)
    after = np.ascontiguousarray(vertices, dtype=np.float64)
    renewed, _ = regrouped_normals(mesh.vertices, after, faces, entries.astype(np.int32), values)
    return renewed.astype(normals.dtype)
