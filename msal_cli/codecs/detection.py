"""Which format a file has, by its name and by its first bytes."""

from __future__ import annotations

import re

from msal_cli.storage.buffers import Buffer
from msal_cli.storage.gzip_streams import is_gzip_name
from msal_cli.storage.limits import LOOKED_AT

BYTE_ORDER_MARK = b"\xef\xbb\xbf"

OWN_FORMATS = ("ply", "obj", "stl", "glb", "gltf", "3mf")
"""Formats with a codec of our own, which keeps everything but positions and normals."""

SCENES = {"glb", "gltf"}
"""Containers of one format, which hold the same."""

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


def format_of_name(name: str) -> str:
    """The format that a file name stands for, ``.gz`` disregarded; empty if none that is known."""
    stem = name[: -len(".gz")] if is_gzip_name(name) else name
    suffix = re.search(r"\.[^./\\]*$", stem)
    known = suffix is not None and suffix[0].lower() in readable_suffixes()
    return suffix[0][1:].lower() if suffix and known else ""


def content_format(data: Buffer, expected: str = "") -> str:
    """The format that the bytes themselves look like; empty if it is not known.

    ``expected`` is the format that the name says.  An OBJ is known by all of its lines, which takes
    longer than the rest, so that where one is expected its reader has to find out.
    """
    head = bytes(memoryview(data)[:LOOKED_AT])
    if len(data) >= 134 and len(data) == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return "stl"
    for pattern, name in _BEGINNINGS:
        if re.match(pattern, head):
            return name
    is_obj = expected != "obj" and _looks_like_obj(head, is_cut=len(data) > LOOKED_AT)
    return "obj" if is_obj else ""


def _looks_like_obj(head: bytes, *, is_cut: bool) -> bool:
    """Whether every line begins with a keyword of OBJ: the last one looked at may be cut off, and
    the rest of a continued line is no line of its own."""
    head = re.sub(rb"\\\r?\n", b" ", head.removeprefix(BYTE_ORDER_MARK))
    lines = head.splitlines()
    if is_cut:
        lines = lines[:-1]
    return re.search(_OBJ_VERTEX, head) is not None and all(
        re.fullmatch(_OBJ_LINE, line.strip()) for line in lines
    )
