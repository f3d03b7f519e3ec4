"""Meshes in memory for the pipeline: from arrays, or from objects of other libraries.

Objects are recognised by the names of their classes: no library is imported for this.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.detection import READABLE
from msal_cli.codecs.mesh_file import Surface, cut_polygons
from msal_cli.errors import ContentError, InputError, MsalError, UnsupportedError, UsageError
from msal_cli.job.room import to_known_error
from msal_cli.job.settings import METRES

Array = NDArray[Any]

ARRAYS = "arrays"
"""The name of a mesh without a file."""


@dataclass(eq=False, kw_only=True)
class MemoryMesh(Surface):
    """A mesh that is not in a file.

    Attributes
    ----------
    dtype : number type of the given positions, and of those that are returned.
    name : its name in records and errors.
    properties : numbers at the vertices, (n,) each, by name.
    copy_object : makes a copy of the given object, from this mesh and other positions.
    """

    dtype: np.dtype[Any]
    name: str = ARRAYS
    properties: dict[str, Array] = field(default_factory=dict)
    copy_object: Callable[[MemoryMesh, Array], Any] | None = None

    def to_result(self, vertices: Array) -> Any:
        """A copy of the given object with other positions (n, 3); for arrays these alone."""
        return vertices if self.copy_object is None else self.copy_object(self, vertices)

    def renew_normals(self, vertices: Array, entries: Array, normals: Any) -> Array:
        """Recompute stored normals (g, 3) for new positions (n, 3), as the command does for files.

        ``entries`` (m, 3) are the indices of the normals that corners of triangles use.
        """
        from msal_cli.kernels.geometry import regroup_normals

        stored = np.asarray(normals)
        values = np.ascontiguousarray(stored, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int32)
        after = np.ascontiguousarray(vertices, dtype=np.float64)
        renewed, _ = regroup_normals(self.vertices, after, faces, entries.astype(np.int32), values)
        return renewed.astype(stored.dtype)

    def vertex_property(self, name: str) -> Floats:
        if name not in self.properties:
            known = ", ".join(self.properties)
            raise InputError(
                f"{self.name}: there is no vertex property {name!r}",
                code="E_PROPERTY",
                hint=f"it has: {known}" if known else "it has none; give an array (n,)",
            )
        given = as_array(self.properties[name], f"the values of {name}")
        return np.ascontiguousarray(given, dtype=np.float64).reshape(-1)

    def as_stored(self, vertices: Floats) -> Floats:
        is_same = self.dtype == vertices.dtype
        return vertices if is_same else self.to_given_type(vertices).astype(np.float64)

    def to_given_type(self, vertices: Floats) -> Array:
        """New positions (n, 3) in the number type of the given ones; ContentError (``E_RANGE``)."""
        with np.errstate(over="ignore"):
            rounded = vertices.astype(self.dtype)
        if self.dtype.itemsize < 8 and (np.isfinite(vertices) & ~np.isfinite(rounded)).any():
            raise ContentError(
                f"a new position is too large for {self.dtype}", code="E_RANGE", hint="give float64"
            )
        # Exact for vertices that did not move; always a new array.
        return rounded


def from_arrays(
    vertices: ArrayLike,
    faces: ArrayLike,
    name: str = ARRAYS,
    arrays: Mapping[str, Any] | None = None,
    copy_object: Callable[[MemoryMesh, Array], Any] | None = None,
) -> MemoryMesh:
    """The mesh of vertices (n, 3), any real numbers, and triangles (m, 3), any integers, which
    ``mesh.prepare_mesh`` checks later.

    ``arrays`` that have one real number for each vertex become properties.
    """
    positions, corners = as_array(vertices, "vertices"), as_array(faces, "faces")
    if positions.dtype.kind not in "fiu":
        raise ContentError(
            f"vertices are {positions.dtype}, not real numbers", hint="give float64 or float32"
        )
    properties = {}
    for key, values in (arrays or {}).items():
        # Masks are checked where the numbers are used.
        array = np.asanyarray(values)
        if array.dtype.kind in "fiub" and array.size == len(positions) == len(array):
            properties[str(key)] = array
    return MemoryMesh(
        np.ascontiguousarray(positions, dtype=np.float64),
        corners,
        dtype=positions.dtype if positions.dtype.kind == "f" else np.dtype(np.float64),
        name=name,
        properties=properties,
        copy_object=copy_object,
    )


def as_array(values: ArrayLike, name: str, error: type[MsalError] = ContentError) -> Array:
    """Convert values to an array; an ``error`` if rows differ in length, or if some values are
    masked: numpy would drop the mask, and use the values below it."""
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


def _fan_triangles(corners: Longs, sizes: Longs) -> Longs:
    """Triangles (m, 3) of polygons with ``sizes`` (p,) and ``corners`` (c,), cut as in files."""
    triangles: Longs = corners[cut_polygons(np.arange(len(corners), dtype=np.int32), sizes)]
    return triangles


def _read_trimesh(mesh: Any) -> MemoryMesh:
    """The mesh; the copy keeps colours, UVs, attributes and metadata, and gets new normals."""
    if any(base.__module__ == "trimesh.primitives" for base in type(mesh).__mro__):
        raise UnsupportedError(
            "the vertices of a trimesh.primitives object cannot be replaced",
            hint="give mesh.to_mesh()",
        )

    def copy_object(memory: MemoryMesh, vertices: Array) -> Any:
        copy = mesh.copy()
        copy.vertices = vertices
        return copy

    return from_arrays(mesh.vertices, mesh.faces, "Trimesh", mesh.vertex_attributes, copy_object)


def _read_pyvista(mesh: Any) -> MemoryMesh:
    """The mesh, its polygons cut into triangles for the computation only; the copy keeps all
    arrays, and gets new normals."""
    counts = {"lines": mesh.n_lines, "vertices": mesh.n_verts, "strips": mesh.n_strips}
    others = ", ".join(f"{n:,} {name}" for name, n in counts.items() if n)
    if others:
        raise UnsupportedError(
            f"the PolyData has cells that are no faces: {others}",
            hint="give its faces alone: pyvista.PolyData(mesh.points, mesh.faces); "
            "mesh.triangulate() makes faces of strips",
        )
    corners, sizes = _split(np.asarray(mesh.faces, dtype=np.int64))
    triangles = _fan_triangles(corners, sizes)
    # At each corner of a triangle the normal of its cell.
    of_cells = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))[:, None].repeat(3, axis=1)

    def copy_object(memory: MemoryMesh, vertices: Array) -> Any:
        copy = mesh.copy(deep=True)
        copy.points = vertices
        for data, entries in ((copy.point_data, triangles), (copy.cell_data, of_cells)):
            name = data.active_normals_name
            if name is not None:
                data[name] = memory.renew_normals(vertices, entries, data[name])
        return copy

    arrays = dict(mesh.point_data.items())
    return from_arrays(np.asarray(mesh.points), triangles, "PolyData", arrays, copy_object)


def _split(faces: Longs) -> tuple[Longs, Longs]:
    """Corners (c,) and sizes (p,) of polygons that follow each other as ``[size, corners...]``."""
    if not len(faces):
        return faces, faces
    size = int(faces[0])
    if len(faces) % (size + 1) == 0 and (faces[:: size + 1] == size).all():
        rows = faces.reshape(-1, size + 1)
        return rows[:, 1:].reshape(-1), rows[:, 0]
    starts, at = [], 0
    values = faces.tolist()
    while at < len(values):
        starts.append(at)
        at += values[at] + 1
    return np.delete(faces, starts), faces[starts]


_COMPONENTS = ("nx", "ny", "nz")


def _read_meshio(mesh: Any) -> MemoryMesh:
    """The mesh of all triangles, quads and polygons, which are cut into triangles for the
    computation only; the copy keeps all cells and data, and gets new normals."""
    blocks = [np.empty((0, 3), dtype=np.int64)]
    for block in mesh.cells:
        if block.type in ("triangle", "quad") or block.type.startswith("polygon"):
            rows = as_array(block.data, "faces").astype(np.int64, copy=False)
            sizes = np.full(len(rows), rows.shape[1], dtype=np.int64)
            blocks.append(_fan_triangles(rows.reshape(-1), sizes))
        # Points and lines use vertices of the surface, and move with it.
        elif block.type not in ("vertex", "line"):
            raise UnsupportedError(
                f"the meshio.Mesh has {len(block.data)} {block.type} cells",
                hint="msal denoises surfaces of triangles, quads and polygons of first order; "
                "extract the surface first",
            )
    triangles = np.concatenate(blocks)

    def copy_object(memory: MemoryMesh, vertices: Array) -> Any:
        copy = mesh.copy()
        copy.points, data = vertices, copy.point_data
        for name in data:
            if name.lower() in ("normal", "normals") and np.shape(data[name]) == vertices.shape:
                data[name] = memory.renew_normals(vertices, triangles, data[name])
        if all(name in data for name in _COMPONENTS):
            stored = np.stack([np.asarray(data[name]) for name in _COMPONENTS], axis=1)
            renewed = memory.renew_normals(vertices, triangles, stored)
            data.update(zip(_COMPONENTS, renewed.T.copy(), strict=True))
        return copy

    return from_arrays(mesh.points, triangles, "meshio.Mesh", mesh.point_data, copy_object)


def _read_open3d(mesh: Any) -> MemoryMesh:
    """The mesh; the copy keeps colours, UVs and textures, and gets new normals."""
    if hasattr(mesh, "vertex"):
        raise UnsupportedError(
            "an open3d.t.geometry.TriangleMesh is not denoised", hint="give mesh.to_legacy()"
        )
    triangles = np.asarray(mesh.triangles)

    def copy_object(memory: MemoryMesh, vertices: Array) -> Any:
        copy = type(mesh)(mesh)
        copy.vertices = type(mesh.vertices)(vertices)
        own = np.arange(len(triangles))[:, None].repeat(3, axis=1)
        for name, entries in (("vertex_normals", triangles), ("triangle_normals", own)):
            if getattr(mesh, f"has_{name}")():
                stored = getattr(mesh, name)
                renewed = memory.renew_normals(vertices, entries, stored)
                setattr(copy, name, type(stored)(renewed))
        return copy

    return from_arrays(np.array(mesh.vertices), triangles, "TriangleMesh", {}, copy_object)


_READERS: dict[tuple[str, str], Callable[[Any], MemoryMesh]] = {
    ("trimesh", "Trimesh"): _read_trimesh,
    ("pyvista", "PolyData"): _read_pyvista,
    ("meshio", "Mesh"): _read_meshio,
    ("open3d", "TriangleMesh"): _read_open3d,
}
"""Readers by the package and the name of a class."""


def read_mesh(vertices: Any, faces: Any = None) -> MemoryMesh:
    """The mesh of arrays or, without ``faces``, of an object of trimesh, pyvista, meshio or open3d;
    UnsupportedError for cells that are not faces, UsageError for anything else."""
    if isinstance(faces, str):
        raise UsageError(
            f"faces are {faces!r}, a text",
            hint=f"after a mesh object arguments are named: method={faces!r} (kind, of add_noise)",
        )
    if faces is not None:
        return from_arrays(vertices, faces)
    mesh = vertices
    for base in type(mesh).__mro__:
        if reader := _READERS.get((base.__module__.partition(".")[0], base.__name__)):
            return reader(mesh)
    if isinstance(mesh, str | bytes) or hasattr(mesh, "__fspath__"):
        raise UsageError(
            f"{mesh!r} is a path, not a mesh", hint="denoise_file and denoise_folder read files"
        )
    raise UsageError(
        f"a {type(mesh).__name__} alone is no mesh",
        hint="give vertices (n, 3) and faces (m, 3), or a trimesh.Trimesh (scene.to_mesh()), "
        "pyvista.PolyData (dataset.extract_surface()), meshio.Mesh or TriangleMesh of open3d",
    )


_FLAGS = ("--despike", "--force", "--fresh", "--in-place", "--retry-failed", "--strict")
_ARGUMENTS = {flag: f"{flag[2:].replace('-', '_')}=True" for flag in _FLAGS} | {
    "-K": "K=", "-n": "iterations=", "-o": "output=", "--set": "parameters=",
    "--auto": 'method="auto"', "--check self-intersections": "intersections=True",
}  # fmt: skip
_VALUES = "|".join(("auto", "ascii", "float64", "noise", "robust", "shape", *READABLE, *METRES))
_NAMES = "-[Kno]|--check self-intersections|--(?!scratch)[a-z-]+[a-z]"
_OPTION = re.compile(rf"(?<![\w-])({_NAMES})(?: ({_VALUES})| (?=\d))?\b")


def name_arguments(text: str) -> str:
    """A message that names options of the command with the arguments of functions instead."""

    def name(option: re.Match[str]) -> str:
        argument = _ARGUMENTS.get(option[1], f"{option[1][2:].replace('-', '_')}=")
        return argument + (f'"{option[2]}"' if option[2] else "")

    return _OPTION.sub(name, text)


@contextmanager
def explained_errors(name: str = ARRAYS, path: str = "") -> Iterator[None]:
    """Turn every error of the block into a ``MsalError`` with notes: its code, place and hint.

    ``name`` is for the log; ``path`` is the file, for errors that do not name one.
    """
    try:
        yield
    except Exception as error:
        known = to_known_error(error, path or name)
        if isinstance(known, InputError):
            known.path = known.path or path
        if not getattr(known, "__notes__", None):
            known.message, known.hint = name_arguments(known.message), name_arguments(known.hint)
            known.args = (known.message,)
            place = ", ".join(part for part in (known.path, known.where) if part)
            known.add_note(f"{known.code}{f' at {place}' if place else ''}")
            if known.hint:
                known.add_note(f"hint: {known.hint}")
        if known is error:
            raise
        raise known from error
