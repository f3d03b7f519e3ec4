"""Files to meshes and back: one codec per format, and whole files in and out of the disk."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.codecs.header_check import read_input
from msal_cli.codecs.mesh_file import Buffer, MeshFile, corner_count
from msal_cli.errors import FormatError, TruncatedError, UnsupportedError
from msal_cli.storage.allocator import give_back_large_arrays
from msal_cli.storage.atomic import write_whole
from msal_cli.storage.digests import sha256_meanwhile
from msal_cli.storage.gzip_streams import compressed, expanded, is_gzip_name, read_whole
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.codecs.companions import Companion

__all__ = [
    "Buffer",
    "MeshFile",
    "compressed",
    "content_format",
    "converted",
    "corner_count",
    "digits_lost",
    "encode_mesh",
    "expanded",
    "format_of_name",
    "give_back_large_arrays",
    "is_url",
    "normal_warnings",
    "open_mesh",
    "read_input",
    "read_whole",
    "readable_suffixes",
    "sha256_meanwhile",
    "vertex_property",
    "with_companions",
    "writable_formats",
    "write_whole",
]

OWN_FORMATS = ("ply", "obj", "stl", "glb", "gltf", "3mf")
"""Formats with a codec of our own, which keeps everything but positions and normals."""

SCENES = {"glb", "gltf"}
"""Containers of one format, which hold the same."""

_LOOKED_AT = 1 << 16
_NUMBER = rb"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_OBJ_VERTEX = rb"(?m)^[ \t]*v(?:[ \t]+" + _NUMBER + rb"){3}"
_OBJ_LINE = (
    rb"(?:\#.*|v|vt|vn|vp|f|l|p|o|g|s|mg|usemtl|mtllib|usemap|maplib|vertexcolor)?(?:[ \t].*)?"
)
_XML = (
    rb"(?s)(?:\xef\xbb\xbf)?\s*+(?:<\?xml[^>]*+>\s*+)?"
    rb"(?:(?:<!--(?:(?!-->).)*+-->|<![A-Z][^>]*+>)\s*+)*+"
)
"""What may come before the root element: a declaration, comments and a document type."""

_BEGINNINGS = (
    (rb"ply[ \t]*[\r\n]", "ply"),
    (rb"glTF", "glb"),
    (rb"PK\x03\x04", "3mf"),
    (
        rb'(?:\xef\xbb\xbf)?\s*\{\s*"(?:asset|accessors|animations|buffers|bufferViews|cameras|'
        rb'extensions|extensionsUsed|images|materials|meshes|nodes|samplers|scenes?|skins|textures)"',
        "gltf",
    ),
    (rb"# vtk DataFile", "vtk"),
    (rb"\s*\$MeshFormat", "msh"),
    (rb"(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*+)*+(?:ST)?C?N?4?n?OFF\b", "off"),
    (rb"\s*MeshVersionFormatted", "mesh"),
    (rb"\s*(?:<\?xml[^>]*>\s*)?<VTKFile[^>]*[\"']PolyData[\"']", "vtp"),
    (rb"\s*(?:<\?xml[^>]*>\s*)?<VTKFile", "vtu"),
    (_XML + rb"<COLLADA\b", "dae"),
    (_XML + rb"<Xdmf\b", "xdmf"),
    (rb"(?is)(?:\xef\xbb\xbf)?\s*solid\b.*?\b(?:facet|endsolid)\b", "stl"),
)


def readable_suffixes() -> tuple[str, ...]:
    """Suffixes, with their dot, of the files that can be read; each may be followed by ``.gz``."""
    from msal_cli.codecs import library_formats as other

    return tuple(f".{name}" for name in (*OWN_FORMATS, *other.readable()))


def writable_formats() -> tuple[str, ...]:
    """Formats that ``converted`` can write here; some depend on packages that are installed."""
    from msal_cli.codecs import conversion as convert

    return convert.writable()


def format_of_name(name: str) -> str:
    """The format that a file name stands for, ``.gz`` disregarded; empty if none that is known."""
    stem = name[: -len(".gz")] if is_gzip_name(name) else name
    suffix = re.search(r"\.[^./\\]*$", stem)
    known = suffix is not None and suffix[0].lower() in readable_suffixes()
    return suffix[0][1:].lower() if suffix and known else ""


def content_format(data: Buffer, expected: str = "") -> str:
    """The format that the bytes themselves look like; empty if none can be told.

    ``expected`` is the format that the name says.  An OBJ is known by all of its lines, which takes
    longer than the rest, so that where one is expected its reader has to find out.
    """
    head = bytes(memoryview(data)[:_LOOKED_AT])
    if len(data) >= 134 and len(data) == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return "stl"
    for pattern, name in _BEGINNINGS:
        if re.match(pattern, head):
            return name
    is_obj = expected != "obj" and _looks_like_obj(head, is_cut=len(data) > _LOOKED_AT)
    return "obj" if is_obj else ""


def _looks_like_obj(head: bytes, *, is_cut: bool) -> bool:
    """Whether every line begins with a keyword of OBJ: the last one looked at may be cut off, and
    the rest of a continued line is no line of its own."""
    head = re.sub(rb"\\\r?\n", b" ", head.removeprefix(b"\xef\xbb\xbf"))
    lines = head.splitlines()
    if is_cut:
        lines = lines[:-1]
    return re.search(_OBJ_VERTEX, head) is not None and all(
        re.fullmatch(_OBJ_LINE, line.strip()) for line in lines
    )


def open_mesh(data: Buffer, name: str, format: str | None = None) -> MeshFile:
    """Read a mesh from the bytes of its file.

    Parameters
    ----------
    data : the content, not compressed (see ``expanded``).
    name : the file's name; its suffix says the format, in any case and before ``.gz``.
    format : the format's name, over the suffix; needed for a stream whose content does not tell.

    Raises
    ------
    UnsupportedError
        for a format, or a feature of one, that is not read.
    FormatError, TruncatedError, ContentError, TooLargeError
        for a file that is not what it should be; a content of another format than the name says
        is a FormatError.
    """
    wanted = _wanted(data, name, format)
    if not len(data):
        raise TruncatedError("the file is empty", hint="copy or export it again")
    found = content_format(data, wanted)
    if found and found != wanted and (wanted in OWN_FORMATS or found != "obj"):
        said = "--format" if format else "the name"
        raise FormatError(
            f"this is {_article(found)} {found.upper()} file, but {said} says {wanted.upper()}",
            where="byte 0",
            hint=f"rename the file to .{found}, or pass --format {found}",
        )
    # Codecs are imported where they are used, so that one bad format costs only its own time.
    if wanted == "ply":
        from msal_cli.codecs import ply

        return ply.read(data, name)
    if wanted == "obj":
        from msal_cli.codecs import obj

        return obj.read(data, name)
    if wanted == "stl":
        from msal_cli.codecs import stl

        return stl.read(data, name)
    if wanted == "glb":
        from msal_cli.codecs import glb

        return glb.read(data, name)
    if wanted == "gltf":
        from msal_cli.codecs import gltf

        return gltf.read(data, name)
    if wanted == "3mf":
        from msal_cli.codecs import threemf

        return threemf.read(data, name)
    from msal_cli.codecs import library_formats as other

    return other.read(data, wanted)


def _wanted(data: Buffer, name: str, format: str | None) -> str:
    """The format to read, by the option, the suffix or, where there is no suffix, the content."""
    known = tuple(suffix[1:] for suffix in readable_suffixes())
    if format is not None:
        wanted = format.lower().removeprefix(".")
        if wanted not in known:
            raise UnsupportedError(
                f"the format {format!r} is not known", hint=f"known are: {', '.join(known)}"
            )
        return wanted
    wanted = format_of_name(name)
    if wanted:
        return wanted
    found = content_format(data) if len(data) else ""
    stem = name[: -len(".gz")] if is_gzip_name(name) else name
    suffix = re.search(r"[^./\\](\.[^./\\]+)$", stem)
    if suffix:
        raise UnsupportedError(
            f"files that end in {suffix[1]!r} are not read",
            hint=f"it looks like {found.upper()}; pass --format {found}"
            if found
            else f"known are: {', '.join(known)}",
        )
    if not len(data):
        raise TruncatedError("the input is empty", hint="check the program that writes it")
    if not found:
        raise FormatError(
            "neither a suffix nor the content says which format this is",
            hint=f"pass --format with one of: {', '.join(known)}",
        )
    return found


def _article(format: str) -> str:
    return "an" if format[0] in "aeiomsfx" and format not in ("mesh", "med", "fem") else "a"


def converted(
    mesh_file: MeshFile,
    vertices: NDArray[np.float64],
    to: str,
    encoding: str = "same",
    precision: str = "same",
) -> tuple[Buffer, tuple[str, ...]]:
    """The mesh with ``vertices`` (n, 3) in another format, and what that format cannot carry.

    See ``convert.converted``.
    """
    from msal_cli.codecs import conversion as convert

    return convert.converted(mesh_file, vertices, to, encoding, precision)


def encode_mesh(vertices: NDArray[np.float64], faces: NDArray[np.int32], to: str) -> Buffer:
    """A new file of vertices (n, 3) and faces (m, 3); see ``convert.encode_mesh``."""
    from msal_cli.codecs import conversion as convert

    return convert.encode_mesh(vertices, faces, to)


def digits_lost(vertices: NDArray[np.float64]) -> tuple[str, ...]:
    """What single precision would take from new positions (n, 3), in words; empty if nothing."""
    from msal_cli.codecs import conversion as convert

    return convert.digits_lost(vertices)


def normal_warnings(mesh_file: MeshFile, vertices: NDArray[np.float64]) -> tuple[str, ...]:
    """What a user should know of the normals that the file stores once its vertices are there.

    Only an OBJ stores normals that several places of the surface share.
    """
    from msal_cli.codecs import obj

    return mesh_file.normal_warnings(vertices) if isinstance(mesh_file, obj.ObjFile) else ()


def with_companions(
    mesh_file: MeshFile, output: Buffer, vertices: NDArray[np.float64], path: str | None
) -> tuple[Buffer, tuple[Companion, ...]]:
    """``output``, which ``mesh_file`` made of ``vertices`` (n, 3), as it is to be at ``path``, and
    the files that it needs in its folder; see ``gltf.GltfFile.beside``."""
    if mesh_file.format != "gltf":
        return output, ()
    from msal_cli.codecs import gltf

    assert isinstance(mesh_file, gltf.GltfFile)
    return mesh_file.beside(output, vertices, path)


def vertex_property(mesh_file: MeshFile, name: str) -> NDArray[np.float64]:
    """A number that the file has for each vertex, (n,) in the order of its vertices.

    Raises
    ------
    InputError
        with code ``E_PROPERTY`` if it has no such property; the hint lists those that it has.
    UnsupportedError
        for a format other than PLY.
    """
    from msal_cli.codecs import ply

    if not isinstance(mesh_file, ply.PlyFile):
        raise UnsupportedError(
            f"vertex properties such as {name!r} are read from PLY, not from "
            f"{mesh_file.format.upper()}",
            hint="give a PLY, or leave out for this file what names a property",
        )
    return mesh_file.vertex_property(name)
