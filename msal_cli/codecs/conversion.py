"""Conversion of a mesh to another format, with a list of what that format cannot store.

Positions, faces and vertex colours are converted, and vertex normals are recomputed if the file has
some.  Everything else in the file is listed as lost."""

import contextlib
import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.codecs.colours import vertex_colours
from msal_cli.codecs.detection import ENCODINGS, SCENES, WRITABLE
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.codecs.ply_write import write_ply
from msal_cli.codecs.slots import as_float32
from msal_cli.errors import InputError, UnsupportedError, format_count
from msal_cli.light_dataclass import dataclass
from msal_cli.storage.regular import Buffer

_NORMAL_PROPERTIES = re.compile(
    r"vertex\.(n[xyz]( |$)|normal$)|normals$|point\.normals?$", re.IGNORECASE
)
_COLOUR_PROPERTIES = re.compile(
    r"vertex\.(diffuse_)?(red|green|blue|alpha)( |$)|vertex( colours|\.color_0)$", re.IGNORECASE
)
_DERIVED = ("facet normals",)
"""Properties that follow from the positions, so that they are not lost."""

_SINGLE = ("glb", "gltf", "stl")


@dataclass(frozen=True, eq=False)
class _Mesh:
    """What is converted: positions (n, 3), triangles (m, 3), polygons as of ``MeshFile.polygons``,
    colours (n, 3 or 4) or None, and unit normals (n, 3) or None."""

    vertices: Floats
    faces: Ints
    polygons: tuple[Longs | Ints, Longs]
    colours: NDArray[np.uint8] | None
    normals: Floats | None


def convert(
    mesh_file: MeshFile, vertices: Floats, to: str, encoding: str = "same", precision: str = "same"
) -> tuple[Buffer, tuple[str, ...]]:
    """Convert a mesh to another format.

    Parameters
    ----------
    mesh_file : the file that was read.
    vertices : (n, 3), the new positions, file units.
    to : the format, one of ``WRITABLE``.
    encoding : ``same`` for the format's default, ``ascii`` or ``binary``.
    precision : ``same`` for float32 if the source has float32, else float64; ``float32``,
        ``float64``.  Text has the shortest digits from which the number can be read exactly.

    Returns the file, and what it lacks of the source, one entry for each loss.
    Raises UnsupportedError for a format, encoding or precision that cannot be written.
    """
    single = _is_single(mesh_file, to, encoding, precision)
    digits = _lost_digits(mesh_file, vertices, to) if single else ()
    if to == mesh_file.format:
        lost = mesh_file.losses_by_encoding() if _is_recoded(mesh_file, encoding) else ()
        return mesh_file.encoded(vertices, encoding, precision), (*lost, *digits)
    if {to, mesh_file.format} == SCENES and encoding != "ascii" and precision != "float64":
        from msal_cli.codecs.gltf import SceneFile, repack

        scene = repack(mesh_file, vertices, to) if isinstance(mesh_file, SceneFile) else None
        if scene is not None:
            return scene, ()
    if to not in WRITABLE:
        raise UnsupportedError(f"{to!r} cannot be written", hint=f"formats: {', '.join(WRITABLE)}")
    encodings = ENCODINGS[to]
    encoding = encodings[0] if encoding == "same" else encoding
    if encoding not in encodings:
        raise UnsupportedError(
            f"{to} has no {encoding} encoding", hint=f"it has: {', '.join(encodings)}"
        )
    if precision == "float64" and to in _SINGLE and encoding == "binary":
        raise UnsupportedError(f"{encoding} {to} has no float64", hint="write PLY with --to ply")
    mesh, losses = _build_mesh(mesh_file, vertices, to)
    return _write(mesh, to, encoding, single), (*losses, *digits)


def stale_warnings(mesh_file: MeshFile, to: str, encoding: str, precision: str) -> list[str]:
    """The warnings of the source about what ``convert`` does not keep, or round."""
    words = ["rounded"] * (precision != "same")
    words += [" behind the last ", "facet"] * _is_recoded(mesh_file, encoding)
    if to != mesh_file.format:
        words = ["kept", "rounded", "facet"] * ({to, mesh_file.format} != SCENES)
    return [text for text in mesh_file.warnings if any(word in text for word in words)]


def _is_recoded(mesh_file: MeshFile, encoding: str) -> bool:
    """Whether ``encoding`` is another than that of a file that keeps its format."""
    return encoding != "same" and (encoding == "ascii") != (mesh_file.encoding == "ascii")


def as_stored(
    mesh_file: MeshFile, vertices: Floats, to: str, encoding: str, precision: str
) -> Floats:
    """New positions (n, 3) rounded to the number type that ``convert`` writes."""
    if (to == mesh_file.format and precision == "same") or {to, mesh_file.format} == SCENES:
        vertices = mesh_file.as_stored(vertices)
        if mesh_file.precision != "text":
            return vertices
    is_single = _is_single(mesh_file, to, encoding, precision)
    return as_float32(vertices).astype(np.float64) if is_single else vertices


def _is_single(mesh_file: MeshFile, to: str, encoding: str, precision: str) -> bool:
    """Whether ``convert`` rounds positions to float32."""
    if encoding == "same":
        own = "ascii" if mesh_file.encoding == "ascii" else "binary"
        encoding = own if to == mesh_file.format else ENCODINGS.get(to, ("",))[0]
    wanted = mesh_file.precision if precision == "same" else precision
    return wanted == "float32" or (to in _SINGLE and encoding == "binary")


def _lost_digits(mesh_file: MeshFile, vertices: Floats, to: str) -> tuple[str, ...]:
    """The loss of digits in float32, if it matters: far from the origin it ruins a scan."""
    if mesh_file.precision == "float32" or not len(vertices):
        return ()
    step = float(np.spacing(np.float32(min(float(np.abs(vertices).max()), 3e38))))
    extent = float(np.linalg.norm(vertices.max(axis=0) - vertices.min(axis=0)))
    # For the same format, the user has named the type.
    is_unnamed = mesh_file.precision == "float64" and to != mesh_file.format
    is_lost = is_unnamed or step > 1e-6 * extent
    return (f"digits (float32 rounds positions to {step:.1g} units)",) if is_lost else ()


def _build_mesh(mesh_file: MeshFile, vertices: Floats, to: str) -> tuple[_Mesh, list[str]]:
    """What can be converted to the format ``to``, and the losses."""
    colours = None
    # Colours that cannot be read are listed as lost.
    with contextlib.suppress(InputError):
        colours = vertex_colours(mesh_file) if to in ("ply", "obj", "glb", "gltf") else None
    has_normals = any(_NORMAL_PROPERTIES.match(prop) for prop in mesh_file.properties)
    carries_normals = has_normals and to in ("ply", "obj")
    losses = [
        prop
        for prop in mesh_file.properties
        if prop not in _DERIVED
        and not (colours is not None and _COLOUR_PROPERTIES.match(prop))
        and not (has_normals and _NORMAL_PROPERTIES.match(prop) and to in ("ply", "obj", "stl"))
    ] + mesh_file.things_kept()
    # OBJ has three numbers for a colour.
    if to == "obj" and colours is not None and (colours[:, 3:] < 255).any():
        losses.append("alpha of the vertex colours")
    faces = mesh_file.faces
    polygons = mesh_file.polygons()
    if (polygons[1] > 3).any() and to not in ("ply", "obj", "off"):
        losses.append("polygons (triangulated)")
    if to == "stl":
        from msal_cli.kernels.welding import used_vertices

        losses.append("vertex identity (STL stores corners)")
        used = used_vertices(len(vertices), faces)
        if not used.all():
            losses.append(f"{format_count(int((~used).sum()), 'vertex')} that no face uses")
    normals = _vertex_normals(vertices, faces) if carries_normals else None
    stored = mesh_file.with_unplaced(vertices)
    if to == "ply":
        vertices = stored
    elif stored is not vertices and to != "stl":
        losses.append("positions that are not finite")
    return _Mesh(vertices, faces, polygons, colours, normals), losses


def _vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """The normalised sum of the unit normals of each vertex's faces (n, 3); zeros if that is 0."""
    from msal_cli.kernels.geometry import face_normals

    sums = np.zeros_like(vertices)
    unit = face_normals(vertices, faces)
    for corner in range(3):
        np.add.at(sums, faces[:, corner], unit)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    normals: Floats = sums / np.where(length > 1e-10, length, np.inf)
    return normals


def _write(mesh: _Mesh, to: str, encoding: str, single: bool) -> Buffer:
    """A new file; ``single`` rounds positions to float32."""
    from msal_cli.codecs import stl, threemf, vtk_xml

    if to == "ply":
        return _as_ply(mesh, encoding, single)
    if to == "stl":
        from msal_cli.kernels.geometry import face_normals

        rows = mesh.vertices[mesh.faces].reshape(-1, 9)
        normals = face_normals(mesh.vertices, mesh.faces)
        if encoding == "ascii":
            return stl.ascii_stl(rows, normals, "", single=single)
        return stl.binary_stl(rows, normals, "")
    points = as_float32(mesh.vertices).astype(np.float64) if single else mesh.vertices
    if to == "obj":
        return _as_obj(mesh, points, single)
    if to == "off":
        return _as_off(mesh, points, single)
    writers = {"3mf": threemf.to_3mf, "vtp": vtk_xml.to_vtp}
    if to in writers:
        return writers[to](points, mesh.faces, single=single)
    if to in SCENES:
        return _as_scene(points, mesh, to)
    return _as_cells(points.astype(np.float32) if single else points, mesh.faces, to, encoding)


def _as_cells(points: NDArray[Any], faces: Ints, to: str, encoding: str) -> bytes:
    """A VTK or VTU file; VTK in the version that most programs read."""
    import io
    import tempfile
    from pathlib import Path

    import meshio

    mesh = meshio.Mesh(points, [("triangle", faces)])
    with tempfile.TemporaryDirectory(prefix="msal-") as folder:
        path = Path(folder) / f"mesh.{to}"
        # meshio prints a warning for text.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            mesh.write(path, file_format={"vtk": "vtk42"}.get(to, to), binary=encoding != "ascii")
        return path.read_bytes()


def _as_scene(points: Floats, mesh: _Mesh, to: str) -> Buffer:
    import trimesh

    from msal_cli.codecs import gltf

    surface = trimesh.Trimesh(
        points, mesh.faces, vertex_colors=mesh.colours, process=False, validate=False
    )
    scene: Any = trimesh.Scene(surface)
    data = bytes(scene.export(file_type="glb"))
    if to == "glb":
        return data
    file = gltf.GlbFile(data)
    text = gltf.repack(file, file.vertices, to)
    assert text is not None
    return text


def _as_ply(mesh: _Mesh, encoding: str, single: bool) -> Buffer:
    """PLY, little endian; ascii is made by the codec, which formats the numbers."""
    from msal_cli.codecs import ply

    data = write_ply(
        mesh.vertices, *mesh.polygons, single=single, normals=mesh.normals, colours=mesh.colours
    )
    if encoding == "binary":
        return data
    file = ply.read(data)
    return file.encoded(file.vertices, "ascii", "same")


def _as_obj(mesh: _Mesh, points: Floats, single: bool) -> Buffer:
    if mesh.colours is not None:
        # Five digits distinguish 256 steps.
        shades = np.round(mesh.colours[:, :3] / 255.0, 5)
        points, single = np.concatenate([points, shades], axis=1), False
    pieces = [float_lines(points, single=single, prefix=b"v ")]
    if mesh.normals is not None:
        pieces.append(float_lines(mesh.normals, single=True, prefix=b"vn "))
    corners, sizes = mesh.polygons
    faces = integer_lines(corners + 1, sizes, b"f ", doubled=mesh.normals is not None)
    return b"".join([*pieces, faces])


def _as_off(mesh: _Mesh, points: Floats, single: bool) -> Buffer:
    corners, sizes = mesh.polygons
    head = f"OFF\n{len(points)} {len(sizes)} 0\n".encode()
    if (sizes == 3).all():
        faces = integer_lines(corners, sizes, b"3 ")
    else:
        items: Longs = np.insert(corners, np.cumsum(sizes) - sizes, sizes)
        faces = integer_lines(items, sizes + 1)
    return b"".join([head, float_lines(points, single=single), faces])


def float_lines(values: Floats, *, single: bool, prefix: bytes = b"") -> memoryview:
    """Numbers (n, k), a line per row, as the shortest text that is read as the same number, of
    float32 if ``single``."""
    from msal_cli.kernels import text

    blanks = [b" "] * (values.shape[1] - 1)
    return text.fill_rows(
        (prefix, *blanks, b"\n"), *text.print_shortest(values.reshape(-1), single)
    )


def integer_lines(
    values: Longs | Ints, sizes: Longs, prefix: bytes = b"", *, doubled: bool = False
) -> memoryview:
    """Whole numbers (c,) in lines of ``sizes`` (p,); each as ``t//t`` if ``doubled``, as OBJ names
    a corner with a normal."""
    from msal_cli.kernels import text

    which = np.full(len(values), 2, dtype=np.uint8)
    which[np.cumsum(sizes) - 1] = 3
    tokens = text.print_numbers(values.astype(np.float64), 0)
    return text.fill_rows((prefix, b"//", b" ", b"\n"), *tokens, which, doubled)
