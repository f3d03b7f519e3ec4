"""A mesh in another format, and what that format cannot carry.

Positions, faces, vertex colours and the presence of vertex normals go across; everything else a
file has is named as lost.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.codecs.detection import SCENES
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.codecs.vertex_colours import vertex_colours
from msal_cli.errors import UnsupportedError
from msal_cli.storage.buffers import Buffer

_NORMAL_PROPERTIES = re.compile(
    r"vertex\.(n[xyz]( |$)|normal$)|normals$|point\.normals?$", re.IGNORECASE
)
_COLOUR_PROPERTIES = re.compile(
    r"vertex\.(diffuse_)?(red|green|blue|alpha)( |$)|vertex colours$", re.IGNORECASE
)
_DERIVED = ("facet normals",)
"""Properties that follow from the positions, so that nothing is lost without them."""

_ENCODINGS = {
    "ply": ("binary", "ascii"),
    "stl": ("binary", "ascii"),
    "obj": ("ascii",),
    "off": ("ascii",),
    "glb": ("binary",),
    "gltf": ("binary",),
    "vtk": ("binary", "ascii"),
    "vtu": ("binary", "ascii"),
    "msh": ("binary", "ascii"),
    "meshb": ("binary",),
    "vtp": ("binary",),
    "med": ("binary",),
    "3mf": ("binary",),
}
"""Encodings of each format, the default one first; the others are text."""

_SINGLE = ("glb", "gltf", "stl")


@dataclass(frozen=True, eq=False)
class _Content:
    """What goes across: positions (n, 3), triangles (m, 3), polygons or None where these are the
    triangles, colours (n, 3 or 4) or None, and unit normals (n, 3) or None."""

    vertices: Floats
    faces: Ints
    polygons: list[Any] | Ints | None
    colours: NDArray[np.uint8] | None
    normals: Floats | None


def writable() -> tuple[str, ...]:
    """Formats that can be written here."""
    from msal_cli.codecs import library_formats as other

    return ("ply", "obj", "stl", "gltf", "3mf", *other.writable())


def converted(
    mesh_file: MeshFile, vertices: Floats, to: str, encoding: str, precision: str
) -> tuple[Buffer, tuple[str, ...]]:
    """A mesh in another format.

    Parameters
    ----------
    mesh_file : what was read.
    vertices : (n, 3), the new positions, file units.
    to : the format, one of ``writable()``.
    encoding : ``same`` for the format's usual one, ``ascii`` or ``binary``.
    precision : ``same`` for float32 where the source has float32 and float64 otherwise;
        ``float32``, ``float64``.  Text has the shortest digits that give the number back.

    Returns
    -------
    The file, and what of the source it does not carry, one entry for each thing.

    Raises
    ------
    UnsupportedError
        for a format, encoding or precision that cannot be written.
    """
    to = to.lower().removeprefix(".")
    if to == mesh_file.format:
        encode = getattr(mesh_file, "encoded")  # noqa: B009 - not part of the protocol
        return encode(vertices, encoding, precision), ()
    if {to, mesh_file.format} == SCENES and encoding != "ascii" and precision != "float64":
        from msal_cli.codecs.gltf_file import SceneFile
        from msal_cli.codecs.gltf_repack import repacked

        scene = repacked(mesh_file, vertices, to) if isinstance(mesh_file, SceneFile) else None
        if scene is not None:
            return scene, ()
    if to not in writable():
        raise UnsupportedError(
            f"{to!r} cannot be written", hint=f"formats: {', '.join(writable())}"
        )
    encodings = _ENCODINGS.get(to, ("ascii",))
    encoding = encodings[0] if encoding == "same" else encoding
    if encoding not in encodings:
        raise UnsupportedError(
            f"{to} has no {encoding} encoding", hint=f"it has: {', '.join(encodings)}"
        )
    single = _is_single(mesh_file, to, encoding, precision)
    content, losses = _content(mesh_file, vertices, to)
    losses += _rounding(mesh_file, vertices, single)
    if to == "ply":
        return _as_ply(content, encoding, single), tuple(losses)
    if to == "obj":
        return _as_obj(content, single), tuple(losses)
    if to == "off":
        return _as_off(content, single), tuple(losses)
    if to == "stl":
        return _as_stl(content, encoding, single), tuple(losses)
    if to == "3mf":
        from msal_cli.codecs import threemf_writer

        points = _positions(content, single)
        return threemf_writer.written(points, content.faces, single=single), tuple(losses)
    return _through_library(content, to, encoding, single), tuple(losses)


def encode_mesh(vertices: Floats, faces: Ints, to: str) -> Buffer:
    """A new file of a mesh that no file held before, one of ``writable()``.

    Positions are float32, or float64 where float32 would round them by more than a millionth of
    the mesh's extent.
    """
    from msal_cli.codecs import ply

    single = not digits_lost(vertices)
    content = _Content(vertices, faces, None, None, None)
    data = _as_ply(content, "binary", single)
    if to == "ply":
        return data
    mesh_file = ply.read(data)
    return converted(mesh_file, mesh_file.vertices, to, "same", "same")[0]


def digits_lost(vertices: Floats) -> tuple[str, ...]:
    """What float32 would take from new positions (n, 3): nothing, or their digits, where it rounds
    them by more than a millionth of the mesh's extent."""
    extent = float(np.ptp(vertices, axis=0).max())
    largest = float(np.abs(vertices).max())
    step = float(np.spacing(np.float32(min(largest, 3e38))))
    if largest < 3e38 and step <= 1e-6 * extent:
        return ()
    return (f"digits (float32 rounds positions to {step:.1g} units)",)


def _is_single(mesh_file: MeshFile, to: str, encoding: str, precision: str) -> bool:
    if to == "med":
        # Its positions are double by definition.
        if precision == "float32":
            raise UnsupportedError("med has no float32", hint="write VTU with --to vtu")
        return False
    only_single = to in _SINGLE and encoding == "binary"
    if precision == "float64" and only_single:
        raise UnsupportedError(f"{encoding} {to} has no float64", hint="write PLY with --to ply")
    if precision == "same":
        return only_single or mesh_file.precision == "float32"
    return precision == "float32"


def _rounding(mesh_file: MeshFile, vertices: Floats, single: bool) -> list[str]:
    """The loss of digits, where it is one: float32 far from the origin ruins a scan."""
    if not single or mesh_file.precision == "float32" or not len(vertices):
        return []
    largest = float(np.abs(vertices).max())
    extent = float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)))
    step = float(np.spacing(np.float32(min(largest, 3e38))))
    if mesh_file.precision == "float64" or step > 1e-6 * extent:
        return [f"digits (float32 rounds positions to {step:.1g} units)"]
    return []


def _content(mesh_file: MeshFile, vertices: Floats, to: str) -> tuple[_Content, list[str]]:
    """What goes across into format ``to``, and what does not."""
    colours = vertex_colours(mesh_file) if to in ("ply", "obj", "glb", "gltf") else None
    has_normals = any(_NORMAL_PROPERTIES.match(one) for one in mesh_file.properties)
    carries_normals = has_normals and to in ("ply", "obj")
    losses = [
        one
        for one in mesh_file.properties
        if one not in _DERIVED
        and not (colours is not None and _COLOUR_PROPERTIES.match(one))
        and not (has_normals and _NORMAL_PROPERTIES.match(one) and to in ("ply", "obj", "stl"))
    ]
    faces = mesh_file.faces
    polygons: list[Any] | Ints | None = None
    if mesh_file.n_polygons != len(faces):
        if to in ("ply", "obj"):
            polygons = mesh_file.polygons()
        else:
            losses.append("polygons (triangulated)")
    if to == "stl":
        losses.append("vertex identity (STL stores corners)")
        used = np.zeros(len(vertices), dtype=bool)
        used[faces.reshape(-1)] = True
        if not used.all():
            losses.append(f"{np.count_nonzero(~used)} vertices that no face uses")
    normals = _vertex_normals(vertices, faces) if carries_normals else None
    return _Content(vertices, faces, polygons, colours, normals), losses


def _vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """The normalised sum of the unit normals of each vertex's faces (n, 3), zeros for none."""
    from msal_cli.kernels.geometry import face_normals

    sums = np.zeros_like(vertices)
    unit = face_normals(vertices, faces)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], unit)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    normals: Floats = sums / np.where(length > 1e-10, length, np.inf)
    return normals


def _corners(content: _Content) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """All corners of the polygons one behind the other, and the number of each polygon's."""
    polygons = content.faces if content.polygons is None else content.polygons
    if isinstance(polygons, np.ndarray):
        sizes = np.full(len(polygons), polygons.shape[1], dtype=np.int64)
        return polygons.reshape(-1).astype(np.int64), sizes
    sizes = np.array([len(one) for one in polygons], dtype=np.int64)
    return np.concatenate(polygons).astype(np.int64), sizes


def polygon_bytes(mesh_file: MeshFile) -> tuple[memoryview, int, str]:
    """The polygons of a file as binary little-endian PLY has them, how many they are, and the type
    of the count before each."""
    whole = mesh_file.n_polygons == len(mesh_file.faces)
    polygons = None if whole else mesh_file.polygons()
    corners, sizes = _corners(_Content(np.empty((0, 3)), mesh_file.faces, polygons, None, None))
    many = int(sizes.max()) > 255
    word, code = ("uint", "<u4") if many else ("uchar", "u1")
    return _face_bytes(corners, sizes, code), len(sizes), word


def _as_ply(content: _Content, encoding: str, single: bool) -> Buffer:
    """PLY, little endian; ascii through the codec, which knows how to print."""
    from msal_cli.codecs.slots import as_float32

    n = len(content.vertices)
    real, word = ("<f4", "float") if single else ("<f8", "double")
    fields: list[tuple[str, str]] = [(name, real) for name in "xyz"]
    if content.normals is not None:
        fields += [(name, "<f4") for name in ("nx", "ny", "nz")]
    if content.colours is not None:
        names = ("red", "green", "blue", "alpha")[: content.colours.shape[1]]
        fields += [(name, "u1") for name in names]
    rows = np.zeros(n, dtype=fields)
    positions = as_float32(content.vertices) if single else content.vertices
    for k, name in enumerate("xyz"):
        rows[name] = positions[:, k]
        if content.normals is not None:
            rows[f"n{name}"] = content.normals[:, k]
    if content.colours is not None:
        for k, name in enumerate(names):
            rows[name] = content.colours[:, k]
    corners, sizes = _corners(content)
    many = int(sizes.max()) > 255
    words = {real: word, "<f4": "float", "u1": "uchar"}
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {n}"]
    header += [f"property {words[code]} {name}" for name, code in fields]
    header += [f"element face {len(sizes)}"]
    header += [f"property list {'uint' if many else 'uchar'} int vertex_indices", "end_header", ""]
    data = b"".join(
        (
            "\n".join(header).encode(),
            rows.data,
            _face_bytes(corners, sizes, "<u4" if many else "u1"),
        )
    )
    if encoding == "binary":
        return data
    from msal_cli.codecs import ply

    file = ply.read(data)
    return file.encoded(file.vertices, "ascii", "same")


def _face_bytes(corners: NDArray[np.int64], sizes: NDArray[np.int64], count: str) -> memoryview:
    """Lists of corners as binary PLY has them: a count, then 32-bit indices."""
    if (sizes == sizes[0]).all():
        k = int(sizes[0])
        faces = np.empty(len(sizes), dtype=[("count", count), ("corners", "<i4", (k,))])
        faces["count"] = k
        faces["corners"] = corners.reshape(-1, k)
        return faces.view(np.uint8).data
    width = np.dtype(count).itemsize
    starts = np.cumsum(sizes * 4 + width) - (sizes * 4 + width)
    out = np.empty(int(starts[-1] + sizes[-1] * 4 + width), dtype=np.uint8)
    counts = sizes.astype(count).view(np.uint8).reshape(-1, width)
    out[starts[:, None] + np.arange(width)] = counts
    first = np.cumsum(sizes) - sizes
    place = np.arange(len(corners)) - np.repeat(first, sizes)
    at = np.repeat(starts + width, sizes) + 4 * place
    out[at[:, None] + np.arange(4)] = corners.astype("<i4").view(np.uint8).reshape(-1, 4)
    return out.data


def _number_lines(values: Floats, single: bool, prefix: bytes) -> bytes:
    from msal_cli.kernels import text
    from msal_cli.kernels import text_rows as rows

    digits, stops = text.printed_shortest(values.reshape(-1), single)
    ends = values.shape[1] * np.arange(1, len(values) + 1, dtype=np.int64)
    return rows.lines(digits, stops, ends, prefix).tobytes()


def _positions(content: _Content, single: bool) -> Floats:
    from msal_cli.codecs.slots import as_float32

    return as_float32(content.vertices).astype(np.float64) if single else content.vertices


def _as_obj(content: _Content, single: bool) -> Buffer:
    from msal_cli.kernels import text
    from msal_cli.kernels import text_rows as rows

    values = _positions(content, single)
    if content.colours is not None:
        # Five digits give back each of 256 steps.
        shades = np.round(content.colours[:, :3] / 255.0, 5)
        pieces = [_number_lines(np.concatenate([values, shades], axis=1), False, b"v ")]
    else:
        pieces = [_number_lines(values, single, b"v ")]
    if content.normals is not None:
        pieces.append(_number_lines(content.normals, True, b"vn "))
    corners, sizes = _corners(content)
    digits, stops = text.printed(corners.astype(np.float64) + 1.0, 0)
    faces = rows.lines(digits, stops, np.cumsum(sizes), b"f ", content.normals is not None)
    return b"".join([*pieces, faces.tobytes()])


def _as_off(content: _Content, single: bool) -> Buffer:
    from msal_cli.kernels import text
    from msal_cli.kernels import text_rows as rows

    corners, sizes = _corners(content)
    head = f"OFF\n{len(content.vertices)} {len(sizes)} 0\n".encode()
    digits, stops = text.printed(corners.astype(np.float64), 0)
    faces = rows.lines(digits, stops, np.cumsum(sizes), b"3 ")
    return b"".join(
        [head, _number_lines(_positions(content, single), single, b""), faces.tobytes()]
    )


def _as_stl(content: _Content, encoding: str, single: bool) -> Buffer:
    from msal_cli.codecs.stl_writer import ascii_stl, binary_stl
    from msal_cli.kernels.geometry import face_normals

    corners = content.vertices[content.faces].reshape(-1, 9)
    normals = face_normals(content.vertices, content.faces)
    if encoding == "ascii":
        return ascii_stl(corners, normals, "", single=single)
    return binary_stl(corners, normals, "")


def _through_library(content: _Content, to: str, encoding: str, single: bool) -> Buffer:
    from msal_cli.codecs import dae, vtk_xml, xdmf
    from msal_cli.codecs import library_formats as other

    points = _positions(content, single)
    if to == "dae":
        return dae.written(points, content.faces, single=single)
    if to == "xdmf":
        return xdmf.written(points, content.faces, single=single)
    if to == "vtp":
        return vtk_xml.written(points, content.faces, single=single)
    if to == "gltf":
        from msal_cli.codecs import glb
        from msal_cli.codecs.gltf_repack import repacked

        made = glb.read(other.surface_written(points, content.faces, content.colours, "glb"), "")
        scene = repacked(made, made.vertices, "gltf")
        assert scene is not None
        return scene
    if to == "glb":
        return other.surface_written(points, content.faces, content.colours, to)
    return other.cells_written(
        points.astype(np.float32) if single else points, content.faces, to, encoding
    )
