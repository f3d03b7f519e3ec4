"""Formats without a codec of our own: read and written again by trimesh and meshio.

The libraries keep less than our codecs do; what is not kept is said in the file's warnings.  A
file in which no vertex moved comes back byte for byte all the same.
"""

from __future__ import annotations

import importlib.util
import io
import re
from dataclasses import field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.dataclass import dataclass
from msal_cli.errors import (
    ContentError,
    FormatError,
    InternalError,
    MsalError,
    UnsupportedError,
)
from msal_cli.files.base import Buffer
from msal_cli.files.guard import guarded

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

THROUGH_MESHIO = {
    "vtk": "vtk",
    "vtu": "vtu",
    "msh": "gmsh",
    "mesh": "medit",
    "meshb": "medit",
    "inp": "abaqus",
    "avs": "avsucd",
    "vol": "netgen",
    "med": "med",
    "xdmf": "xdmf",
}
"""Suffixes and meshio's names for their formats."""

THROUGH_TRIMESH = ("off", "dae")

_NEEDED = {"med": ("h5py",), "xdmf": ("h5py",), "dae": ("collada",)}

_FLAT = {"triangle": 3, "quad": 4, "polygon": 0}
"""Surface cells and their corners; a polygon has any number."""

_OFF = rb"(?:\s|#[^\r\n]*)*(?:ST)?C?N?(4?n?)OFF\b(?:[ \t]+(BINARY))?"
_CONVERT = "convert it to PLY"
_CURVED = r"(triangle|quad)\d+$"
_ENTITIES = "gmsh:dim_tags"
_NORMALS = ("normals", "normal", "point_normals", "vertex_normals")


def readable() -> tuple[str, ...]:
    """Formats that are read through a library, in the order in which help names them."""
    return (*THROUGH_TRIMESH, *THROUGH_MESHIO)


def writable() -> tuple[str, ...]:
    """Formats that can be written here, with the packages that are installed."""
    return tuple(
        name
        for name in (*readable(), "glb")
        if all(importlib.util.find_spec(package) for package in _NEEDED.get(name, ()))
    )


def read(data: Buffer, name: str, format: str) -> OtherFile:
    """Read a mesh of one of the formats in ``readable()``.

    Raises
    ------
    FormatError
        if the library cannot read it.
    UnsupportedError
        for a feature that cannot be written back, or a package that is not installed.
    ContentError
        ``E_NO_FACES`` or ``E_NONFINITE``.
    TooLargeError, ResourceError
        if reading it takes too much memory or does not end.
    """
    if format in THROUGH_TRIMESH:
        return _from_scene(data, format)
    return _from_cells(data, format)


@dataclass(eq=False)
class OtherFile:
    """A mesh that a library has read; see ``files.base.MeshFile``.

    ``content`` is the library's own object: a meshio ``Mesh`` or a trimesh ``Scene``.
    """

    data: Buffer = field(repr=False)
    content: Any = field(repr=False)
    format: str
    encoding: str
    precision: str
    vertices: Floats
    faces: Ints
    n_polygons: int
    properties: tuple[str, ...]
    warnings: tuple[str, ...]
    references: tuple[str, ...] = ()
    merged_vertices: int = 0

    def polygons(self) -> list[Any] | Ints:
        """The faces as the file has them: an (m, k) array or a list of (k,) arrays."""
        if self.format in THROUGH_TRIMESH:
            return self.faces
        rows: list[Any] = []
        for block in self.content.cells:
            if block.type in _FLAT:
                rows.extend(np.asarray(row, dtype=np.int32) for row in block.data)
        if len({len(row) for row in rows}) == 1:
            return np.array(rows, dtype=np.int32)
        return rows

    def forget_vertices(self) -> None:
        """Do nothing: to read them again takes long."""

    def replaced(self, vertices: Floats) -> Buffer:
        """The file written again with ``vertices`` (n, 3); the very bytes if none moved."""
        if not (vertices != self.vertices).any():
            return self.data
        if self.format in THROUGH_TRIMESH:
            return _scene_written(self.content, self.format, vertices, len(self.data))
        return _cells_written(self, vertices, self.encoding)

    def encoded(self, vertices: Floats, encoding: str, precision: str) -> Buffer:
        """The file with ``vertices`` (n, 3) as ``encoding`` (same, ascii, binary).

        Raises
        ------
        UnsupportedError
            for an encoding or precision that the library does not write.
        """
        own = "ascii" if self.encoding == "ascii" else "binary"
        if precision not in ("same", self.precision):
            raise UnsupportedError(
                f"the precision of {self.format} files cannot be changed",
                hint="use --to ply, which has float32 and float64",
            )
        if encoding in ("same", own):
            return self.replaced(vertices)
        if self.format not in ("vtk", "vtu", "msh"):
            raise UnsupportedError(
                f"{self.format} files are written as {own} only", hint="leave --encoding away"
            )
        return _cells_written(self, vertices, encoding)

    def check(self, output: Buffer, vertices: Floats) -> None:
        """Raise InternalError unless ``output``, read again, has these vertices and the faces."""
        if output is self.data or bytes(output) == bytes(self.data):
            if (vertices != self.vertices).any():
                raise InternalError("the positions were not replaced")
            return
        try:
            there = read(output, "", self.format)
        except MsalError as failure:
            raise InternalError(
                f"the {self.format} file that was made cannot be read: {failure}"
            ) from failure
        if not np.array_equal(there.faces, self.faces):
            raise InternalError(f"the {self.format} file that was made has other faces")
        if there.vertices.shape != vertices.shape:
            raise InternalError(f"the {self.format} file that was made has other vertices")
        # float32 where the format has it, and seven digits where a text format has no more.
        largest = float(np.abs(vertices).max())
        if np.abs(there.vertices - vertices).max() > 2e-7 * largest:
            raise InternalError(f"positions were lost in the {self.format} file that was made")


def _needs_surface(n_faces: int, found: str) -> None:
    if not n_faces:
        raise ContentError(
            f"the file has no surface faces; it holds {found or 'nothing'}",
            code="E_NO_FACES",
            hint="msal denoises surfaces; extract the surface of a volume mesh first",
        )


def _checked(vertices: Floats, faces: Ints) -> None:
    finite = np.isfinite(vertices).all(axis=1)
    if not finite.all():
        raise ContentError(
            "a position is not finite",
            code="E_NONFINITE",
            where=f"vertex {int(np.argmin(finite))}",
            hint="remove the vertex, or export the mesh again",
        )
    wrong = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if wrong.any():
        raise ContentError(
            f"a face names a vertex that is not among the {len(vertices)}",
            code="E_INDEX",
            where=f"triangle {int(np.argmax(wrong))}",
            hint="the file is damaged; export it again",
        )


# meshio


def _from_cells(data: Buffer, format: str) -> OtherFile:
    what = f"read this {format.upper()} file"
    mesh, notes = guarded(lambda: _meshio_read(data, format), "meshio", what, len(data))
    points = np.asarray(mesh.points)
    held = ", ".join(f"{len(block.data)} {block.type}" for block in mesh.cells)
    blocks = [block for block in mesh.cells if block.type in _FLAT]
    if any(re.match(_CURVED, block.type) for block in mesh.cells):
        raise UnsupportedError(
            f"the file has second-order surface cells ({held})",
            hint="write it with first-order triangles or quads",
        )
    _needs_surface(sum(len(block.data) for block in blocks), held)
    if points.ndim != 2 or points.shape[1] != 3:
        raise UnsupportedError(
            f"points have {points.shape[-1]} coordinates, not three", hint="write a 3D mesh"
        )
    vertices = np.ascontiguousarray(points, dtype=np.float64)
    faces = np.concatenate([_triangles(block) for block in blocks]).astype(np.int64)
    # Before they become 32 bits wide, so that nothing wraps round.
    _checked(vertices, faces)  # type: ignore[arg-type]
    warnings = [
        *notes,
        f"{format}: rewritten through meshio; comments, titles and layout are not kept",
    ]
    volumes = [b for b in mesh.cells if b.type not in (*_FLAT, "line", "vertex")]
    if volumes:
        cells = ", ".join(f"{len(b.data)} {b.type}" for b in volumes)
        warnings.append(f"other cells ({cells}) are kept; their corners move with the surface")
    if _has_bare_entities(mesh):
        warnings.append("the geometric entities of the nodes are not kept")
    if any(key.lower() in _NORMALS for key in mesh.cell_data):
        warnings.append("normals of cells are kept as they are")
    properties = (
        *(f"point.{key}" for key in mesh.point_data),
        *(f"cell.{key}" for key in mesh.cell_data),
    )
    return OtherFile(
        data,
        mesh,
        format,
        _meshio_encoding(data, format),
        {4: "float32", 8: "float64"}.get(points.dtype.itemsize, "text"),
        vertices,
        faces.astype(np.int32),
        sum(len(block.data) for block in blocks),
        properties,
        tuple(warnings),
    )


def _has_bare_entities(mesh: Any) -> bool:
    """Gmsh entities without physical groups, which meshio reads but fails to write."""
    return _ENTITIES in mesh.point_data and "gmsh:physical" not in mesh.cell_data


def _triangles(block: Any) -> NDArray[np.int64]:
    """A block's polygons cut into triangles that share each polygon's first corner, (m, 3)."""
    if _FLAT[block.type]:
        corners = np.asarray(block.data, dtype=np.int64)
        cuts = [corners[:, [0, k, k + 1]] for k in range(1, corners.shape[1] - 1)]
        return np.stack(cuts, axis=1).reshape(-1, 3)
    rows = [[row[0], row[k], row[k + 1]] for row in block.data for k in range(1, len(row) - 1)]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def _meshio_read(data: Buffer, format: str) -> Any:
    import tempfile

    import meshio

    # Several readers take a path only, so that all get one.
    with tempfile.TemporaryDirectory(prefix="msal-") as folder:
        path = Path(folder) / f"mesh.{format}"
        path.write_bytes(data)
        return meshio.read(path, file_format=THROUGH_MESHIO[format])


def _meshio_encoding(data: Buffer, format: str) -> str:
    head = bytes(memoryview(data)[:4096])
    if format == "vtk":
        return "ascii" if re.search(rb"^ASCII\s*$", head, re.MULTILINE) else "binary_big_endian"
    if format == "msh":
        found = re.search(rb"\$MeshFormat\s+\S+\s+(\d)", head)
        return "binary" if found and found[1] == b"1" else "ascii"
    if format == "vtu":
        return "ascii" if b'format="ascii"' in head else "binary"
    return "binary" if format in ("meshb", "med", "xdmf") else "ascii"


def _meshio_options(head: bytes, format: str, encoding: str) -> tuple[str, dict[str, Any]]:
    """meshio's format name and options that come nearest to what the file has."""
    name = THROUGH_MESHIO[format]
    binary = encoding != "ascii"
    if format == "vtk":
        found = re.match(rb"# vtk DataFile Version (\d+)", head)
        # Not "vtk51", under which meshio writes 4.2; new files get the version that more can read.
        return ("vtk" if found and int(found[1]) >= 5 else "vtk42"), {"binary": binary}
    if format == "msh":
        found = re.search(rb"\$MeshFormat\s+(\d+)", head)
        return ("gmsh22" if found and int(found[1]) < 4 else "gmsh"), {"binary": binary}
    if format == "vtu":
        options: dict[str, Any] = {"binary": binary}
        if binary:
            options["compression"] = "zlib" if b"vtkZLibDataCompressor" in head else None
        return name, options
    return name, {}


def _meshio_written(mesh: Any, format: str, encoding: str, head: bytes, size: int) -> bytes:
    """A meshio mesh as the bytes of a file; ``head`` is the beginning of a file to be like."""
    name, options = _meshio_options(head, format, encoding)

    def write() -> bytes:
        import tempfile

        with tempfile.TemporaryDirectory(prefix="msal-") as folder:
            path = Path(folder) / f"mesh.{format}"
            mesh.write(path, file_format=name, **options)
            return path.read_bytes()

    return guarded(write, "meshio", f"write a {format.upper()} file", size)[0]


def _cells_written(file: OtherFile, vertices: Floats, encoding: str) -> bytes:
    import copy

    mesh = copy.copy(file.content)
    mesh.points = vertices.astype(file.content.points.dtype)
    mesh.point_data = dict(mesh.point_data)
    if _has_bare_entities(mesh):
        del mesh.point_data[_ENTITIES]
    for key, normals in mesh.point_data.items():
        if key.lower() in _NORMALS and np.shape(normals) == vertices.shape:
            from msal_cli.core.geometry import regrouped_normals

            renewed, _ = regrouped_normals(
                file.vertices, vertices, file.faces, file.faces, np.asarray(normals, np.float64)
            )
            mesh.point_data[key] = renewed.astype(np.asarray(normals).dtype)
    head = bytes(memoryview(file.data)[:4096])
    return _meshio_written(mesh, file.format, encoding, head, len(file.data))


def cells_written(points: NDArray[Any], faces: Ints, format: str, encoding: str) -> bytes:
    """A new file of one of meshio's formats, of points (n, 3) and triangles (m, 3)."""

    def mesh() -> Any:
        import meshio

        return meshio.Mesh(points, [("triangle", faces)])

    made, _ = guarded(mesh, "meshio", "be loaded", points.nbytes)
    return _meshio_written(made, format, encoding, b"vtkZLibDataCompressor", points.nbytes)


# trimesh


def _from_scene(data: Buffer, format: str) -> OtherFile:
    scene, notes = guarded(
        lambda: _trimesh_read(data, format),
        "trimesh",
        f"read this {format.upper()} file",
        len(data),
    )
    parts = _parts(scene)
    kinds = ", ".join(sorted({type(part).__name__ for part in scene.geometry.values()}))
    _needs_surface(sum(len(part.faces) for part in parts), kinds)
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([np.asarray(part.vertices, np.float64) for part in parts])
    faces = np.concatenate(
        [np.asarray(part.faces) + start for part, start in zip(parts, starts, strict=False)]
    )
    _checked(vertices, faces)
    warnings = [*notes, _trimesh_losses(format)]
    if len(parts) < len(scene.geometry):
        warnings.append("geometry that is not a surface is kept as it is")
    if any(_is_skewed(scene.graph[node][0]) for node in scene.graph.nodes_geometry):
        warnings.append(
            "a part is placed with a scale that differs by direction; it is denoised in its own "
            "frame, before that"
        )
    return OtherFile(
        data,
        scene,
        format,
        "ascii",
        "text",
        vertices,
        faces.astype(np.int32),
        len(faces),
        _trimesh_properties(parts),
        tuple(warnings),
    )


def _trimesh_read(data: Buffer, format: str) -> Any:
    import trimesh

    content = bytes(data)
    if format == "off":
        _refuse_strange_off(content)
        # Only comments hold other letters, and for these trimesh wants one more package.
        content = content.decode("ascii", "replace").replace("\ufffd", "?").encode()
    return trimesh.load_scene(io.BytesIO(content), file_type=format, process=False)


def _refuse_strange_off(content: bytes) -> None:
    """The kinds of OFF that trimesh takes for the plain one, or for no OFF at all."""
    found = re.match(_OFF, content)
    if not found:
        raise FormatError("the file does not begin with OFF", where="line 1", hint=_CONVERT)
    if found[1]:
        raise UnsupportedError(f"{found[0].split()[-1].decode()} files are not read", hint=_CONVERT)
    if found[2]:
        raise UnsupportedError("binary OFF is not read", hint=_CONVERT)


def _parts(scene: Any) -> list[Any]:
    return [part for part in scene.geometry.values() if hasattr(part, "faces")]


def _is_skewed(matrix: Floats) -> bool:
    """Whether a transform (4, 4) is something else than a similarity."""
    squares = matrix[:3, :3].T @ matrix[:3, :3]
    return bool(np.abs(squares - np.eye(3) * np.trace(squares) / 3).max() > 1e-4 * squares.max())


def _trimesh_losses(format: str) -> str:
    lost = {
        "off": "polygons are triangulated; colours and comments are not kept",
        "dae": "animations, cameras and extra data are not kept",
    }
    return f"{format}: rewritten through trimesh; {lost[format]}"


def _trimesh_properties(parts: list[Any]) -> tuple[str, ...]:
    found = [f"{len(parts)} parts"] if len(parts) > 1 else []
    kinds = {part.visual.kind for part in parts}
    for kind, word in (
        ("texture", "texture coordinates"),
        ("vertex", "vertex colours"),
        ("face", "face colours"),
    ):
        if kind in kinds:
            found.append(word)
    return tuple(found)


def _scene_written(scene: Any, format: str, vertices: Floats, size: int) -> bytes:
    def write() -> bytes:
        copy = scene.copy()
        start = 0
        for part in _parts(copy):
            normals = part._cache.cache.get("vertex_normals") is not None
            stop = start + len(part.vertices)
            part.vertices = vertices[start:stop]
            if normals:
                part.vertex_normals  # noqa: B018 - computing them makes the writer keep them
            start = stop
        return _scene_as_bytes(copy, format)

    return guarded(write, "trimesh", f"write a {format.upper()} file", size)[0]


def _scene_as_bytes(scene: Any, format: str) -> bytes:
    """A trimesh scene as the bytes of a file."""
    if format == "off":
        (part,) = _parts(scene)
        result = part.export(file_type="off", digits=17)
    else:
        result = scene.export(file_type=format)
    return result.encode() if isinstance(result, str) else bytes(result)


def surface_written(
    points: Floats, faces: Ints, colours: NDArray[np.uint8] | None, format: str
) -> bytes:
    """A new file of one of trimesh's formats: points (n, 3), triangles (m, 3), colours (n, k)."""

    def write() -> bytes:
        import trimesh

        mesh = trimesh.Trimesh(points, faces, vertex_colors=colours, process=False, validate=False)
        return _scene_as_bytes(trimesh.Scene(mesh), format)

    return guarded(write, "trimesh", f"write a {format.upper()} file", points.nbytes)[0]
