"""Formats of files: by their names, and by their first bytes; and the names of outputs."""

import os
import re

from msal_cli.errors import FormatError, TruncatedError, UnsupportedError, UsageError, cut_short
from msal_cli.storage.gzip_streams import is_gzip_name
from msal_cli.storage.regular import LOOKED_AT, Buffer
from msal_cli.storage.urls import is_url, split

BYTE_ORDER_MARK = b"\xef\xbb\xbf"

READABLE = ("ply", "obj", "stl", "glb", "gltf", "3mf", "off", "vtk", "vtu", "vtp")
"""Suffixes of the formats that are read, in the order of help."""

ENCODINGS = {
    "ply": ("binary", "ascii"),
    "obj": ("ascii",),
    "stl": ("binary", "ascii"),
    "gltf": ("binary",),
    "3mf": ("binary",),
    "off": ("ascii",),
    "vtp": ("binary",),
    "vtk": ("binary", "ascii"),
    "vtu": ("binary", "ascii"),
    "glb": ("binary",),
}
"""Encodings in which each format is written, the default one first."""

WRITABLE = tuple(ENCODINGS)  # formats that can be written, in the order of help

OWN_FORMATS = ("ply", "obj", "stl", "glb", "gltf", "3mf")
"""Formats whose readers describe damaged content themselves."""

_MESHIO = "convert it to PLY, for example with: meshio convert {name} mesh.ply"
_MODELLER = "convert it to PLY or glTF, for example with Blender or MeshLab"
_CONVERTERS = {
    **dict.fromkeys(("msh", "mesh", "meshb", "inp", "avs", "vol", "med", "xdmf"), _MESHIO),
    **dict.fromkeys(("dae", "3ds"), _MODELLER),
    "gii": "convert it to VTK, for example with mris_convert of FreeSurfer",
}
"""Formats that are known but not read, and how to convert them."""

SCENES = {"glb", "gltf"}  # two containers for the same content

_WIDE_TEXT = re.compile(rb"\xff\xfe(?:[^\0]\0){4}|\xfe\xff(?:\0[^\0]){4}")
"""The beginning of a text in UTF-16; no binary format has it."""

_GIT_LFS = b"version https://git-lfs.github.com/spec/"

_NUMBER = rb"[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?"
_OBJ_VERTEX = rb"(?m)^[ \t]*v(?:[ \t]+" + _NUMBER + rb"){3}"
_OBJ_LINE = (
    rb"(?:\#.*|v|vt|vn|vp|f|l|p|o|g|s|mg|usemtl|mtllib|usemap|maplib|vertexcolor)?(?:[ \t].*)?"
)
_XML = (
    rb"(?s)(?:\xef\xbb\xbf)?\s*+(?:<\?xml[^>]*+>\s*+)?"
    rb"(?>(?:(?:<!--.*?-->|<![A-Z][^>]*+>)\s*+)*)"
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
    (rb"(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*+)*+(?:(?:ST)?C?N?|NC?(?:ST)?)4?n?OFF(?:\d|\b)", "off"),
    (rb"\s*MeshVersionFormatted", "mesh"),
    (rb"\s*(?:<\?xml[^>]*>\s*)?<VTKFile[^>]*[\"']PolyData[\"']", "vtp"),
    (rb"\s*(?:<\?xml[^>]*>\s*)?<VTKFile", "vtu"),
    (_XML + rb"<COLLADA\b", "dae"),
    (_XML + rb"<Xdmf\b", "xdmf"),
    (rb"(?is)(?:\xef\xbb\xbf)?\s*solid\b.*?\b(?:facet|endsolid)\b", "stl"),
)


# Names


def suffix(name: str) -> str:
    """The last suffix in lower case with its dot, without a final ``.gz``; empty if none."""
    base = os.path.basename(name).lower()
    return os.path.splitext(base.removesuffix(".gz"))[1]


def format_of_name(name: str) -> str:
    """The format of a file name, without ``.gz``; empty if it is that of no mesh."""
    ending = suffix(name)[1:]
    return ending if ending in READABLE else ""


def output_name(name: str, to: str | None) -> str:
    """The name of the output for an input's name: another suffix for ``to``; ``.gz`` is kept."""
    if to is None:
        return name
    packed = name[-3:] if is_gzip_name(name) else ""
    stem = name[: len(name) - len(packed)]
    return stem[: len(stem) - len(suffix(name))] + "." + to.lower().lstrip(".") + packed


def refuse_unknown_format(output: str) -> None:
    """Raise UsageError for an output file whose suffix is that of no format that can be written.

    A name without a suffix is that of a folder, or of a device such as ``/dev/null``.
    """
    # A bucket may have a dot in its name.
    name = os.path.basename(split(output)[1].partition("/")[2] if is_url(output) else output)
    ending = suffix(name) or os.path.splitext(name)[1]
    if len(ending) < 2 or format_of_name(name):
        return
    raise UsageError(
        f"the output {output!r}: {ending!r} is the suffix of no mesh format; "
        f"those that can be written are {', '.join(WRITABLE)}",
        hint=f"give the file one of these suffixes, or write {output + '/'!r} for a folder",
    )


# Content


def content_format(data: Buffer, expected: str = "", size: int | None = None) -> str:
    """The format that the bytes look like; empty if it is not known.

    ``expected`` is the format of the name.  To detect an OBJ all of its lines are matched, which
    takes longest; so where one is expected, this is left to its reader.  ``size`` is that of the
    file if ``data`` is only its beginning.
    """
    head = bytes(memoryview(data)[:LOOKED_AT])
    size = len(data) if size is None else size
    if size >= 134 and size == 84 + 50 * int.from_bytes(head[80:84], "little"):
        return "stl"
    for pattern, name in _BEGINNINGS:
        if re.match(pattern, head):
            return name
    is_obj = expected != "obj" and _looks_like_obj(head, is_cut=size > LOOKED_AT)
    return "obj" if is_obj else ""


def refuse_no_mesh(head: Buffer) -> None:
    """Raise FormatError for content of no format: text in UTF-16, and the pointer that Git LFS
    leaves in place of a file that was not fetched."""
    if bytes(memoryview(head)[: len(_GIT_LFS)]) == _GIT_LFS:
        raise FormatError(
            "the file is a pointer of Git LFS, and the mesh was not fetched",
            where="line 1",
            hint="run git lfs pull, or in CI check out with LFS (lfs: true of actions/checkout)",
        )
    if _WIDE_TEXT.match(head):
        raise FormatError(
            "the file is UTF-16 text, which mesh formats are not written in",
            where="byte 0",
            hint="save it again with the encoding UTF-8, in an editor or with iconv -t UTF-8",
        )


def _looks_like_obj(head: bytes, *, is_cut: bool) -> bool:
    """Whether every line begins with a keyword of OBJ.  The last line may be cut off; the rest of a
    continued line belongs to the line before."""
    head = re.sub(rb"\\\r?\n", b" ", head.removeprefix(BYTE_ORDER_MARK))
    lines = head.splitlines()
    if is_cut:
        lines = lines[:-1]
    return re.search(_OBJ_VERTEX, head) is not None and all(
        re.fullmatch(_OBJ_LINE, line.strip()) for line in lines
    )


def resolve_format(data: Buffer, name: str, format: str | None) -> str:
    """The format to read a file in; its content must agree.  Parameters are those of ``open_mesh``.

    Raises UnsupportedError for an unknown format; FormatError or TruncatedError for content of
    another format than the name, for content that is no mesh, and for an empty file.
    """
    refuse_no_mesh(data)
    wanted = _wanted(data, name, format)
    if not len(data):
        raise cut_short("the file is empty")
    found = content_format(data, wanted)
    _refuse_unread(found, name)
    if found and found != wanted and (wanted in OWN_FORMATS or found != "obj"):
        said = "--format" if format else "the name"
        article = "an" if found[0] in "os" else "a"
        raise FormatError(
            f"this is {article} {found.upper()} file, but {said} says {wanted.upper()}",
            where="byte 0",
            hint=f"pass --format {found}"
            + (", or none where the name is right" if format else f", or rename it to .{found}"),
        )
    return wanted


def _wanted(data: Buffer, name: str, format: str | None) -> str:
    known = f"known are: {', '.join(READABLE)}"
    if format is not None:
        wanted = format.lower().removeprefix(".")
        _refuse_unread(wanted, name)
        if wanted not in READABLE:
            raise UnsupportedError(f"the format {format!r} is not known", hint=known)
        return wanted
    wanted = format_of_name(name)
    if wanted:
        return wanted
    stem = name[: -len(".gz")] if is_gzip_name(name) else name
    suffix = re.search(r"[^./\\](\.[^./\\]+)$", stem)
    if suffix:
        _refuse_unread(suffix[1][1:].lower(), name)
    found = content_format(data) if len(data) else ""
    _refuse_unread(found, name)
    if suffix:
        raise UnsupportedError(
            f"files that end in {suffix[1]!r} are not read",
            hint=f"it looks like {found.upper()}; pass --format {found}" if found else known,
        )
    if not len(data):
        raise TruncatedError("the input is empty", hint="check the program that writes it")
    if not found:
        raise FormatError(
            "neither a suffix nor the content says which format this is",
            hint=f"pass --format with one of: {', '.join(READABLE)}",
        )
    return found


def _refuse_unread(format: str, name: str) -> None:
    if format in _CONVERTERS:
        hint = _CONVERTERS[format].format(name=re.split(r"[/\\]", name)[-1] or f"mesh.{format}")
        raise UnsupportedError(f"{format.upper()} files are not read", hint=hint)
