"""What a file will ask for, told from its size and its first 64 KB before anything is loaded.

A forecast is for deciding who may run beside whom, and for refusing a file that cannot fit: it is
never below what was measured, and at most about twice as much.  It explains nothing: whatever is
damaged, hostile or not understood has no counts here, and the reader says what is wrong with it.
"""

from __future__ import annotations

import json
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msal_cli.codecs import ply_header
from msal_cli.codecs.detection import content_format, format_of_name
from msal_cli.codecs.ply_header import Element, Header
from msal_cli.errors import MsalError
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED, GZIP_MAGIC, LARGEST_RATIO
from msal_cli.storage.limits import LOOKED_AT
from msal_cli.storage.regular import open_regular
from msal_cli.storage.urls import is_url

BASE_BYTES = 50_000_000
"""Resident memory of a worker that has denoised a mesh of next to nothing: the interpreter, the
libraries and the compiled kernels (36 to 46 MB measured)."""

_LIBRARY_BYTES = 75_000_000
"""What a library and all that it imports take on top, for formats that only it reads."""

_ALWAYS_BELIEVED = 256 << 20
"""Bytes that the header of a compressed file may always claim."""

# Bytes of resident memory per byte of the file, and per vertex and per triangle together, at the
# peak of the default method.  From benchmarks/peak_memory.py on a torus with a million faces:
# what is foreseen is what was measured plus 8 to 20 %.
_PER_BYTE = {
    "ply": 2.1,
    "ply-ascii": 6.0,
    "obj": 4.1,
    "stl": 1.6,
    "stl-ascii": 4.2,
    "glb": 4.0,
    "vtk": 12.0,
    "vtk-ascii": 13.0,
    "vtu": 16.0,
    "vtp": 12.0,
    "msh": 11.0,
    "mesh": 10.0,
    "meshb": 10.0,
    "off": 15.0,
    "inp": 9.0,
    "avs": 11.0,
    "vol": 11.0,
    "dae": 11.0,
    "xdmf": 11.0,
    "med": 18.0,
    "gltf": 19.0,
    "3mf": 52.0,
    "": 32.0,
}
_PER_BYTE_ELSE = 9.2
_PER_ELEMENT = {"glb": 75.0, "ply": 45.0, "stl": 45.0}
_PER_ELEMENT_ELSE = 60.0

# Where the counts are not told: a triangle for so many bytes, for what a method adds.  Fewer bytes
# than files have, that is, more triangles.
_BYTES_PER_FACE = {"obj": 30.0, "vtk": 24.0, "vtu": 12.0, "glb": 16.0, "gltf": 20.0, "3mf": 8.0}
_BYTES_PER_FACE["stl-ascii"] = 200.0
_BYTES_PER_FACE_ELSE = 24.0

# Bytes per triangle that writing another format takes, what was written being read back.
_CONVERTED = 450
_CONVERTED_AS = {"avs": 500, "inp": 500, "vol": 500}

_GLB_CHUNK = 20
_VTK_TEXT = re.compile(rb"[^\n]*\n[^\n]*\n\s*ASCII", re.IGNORECASE)
_FACET = re.compile(rb"\bfacet\s+(?:normal|outer)\b", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Forecast:
    """What can be told of a file from outside.

    Attributes
    ----------
    format : such as ``ply``; empty if it is not known.
    vertices, faces : what the header says, polygons as the file counts them; None where it does
        not say, or says what the file has no bytes for.
    memory_bytes : resident memory of a process that denoises it, at the peak; None if there is no
        such file.
    """

    format: str = ""
    vertices: int | None = None
    faces: int | None = None
    memory_bytes: int | None = None


def forecast(
    path: str,
    *,
    format: str | None = None,
    to: str | None = None,
    method_bytes_per_face: int = 0,
) -> Forecast:
    """What the file at ``path`` will ask for; reads ``LOOKED_AT`` bytes at most, never raises.

    Parameters
    ----------
    format : the format, over the name's.
    to : the format to be written where it is another, or the same in another encoding.
    method_bytes_per_face : what the method needs per triangle beyond what all do; see
        ``Method.bytes_per_face``.
    """
    try:
        if is_url(path):
            from msal_cli.storage import objects as remote

            head, size = remote.beginning(path, LOOKED_AT)
        else:
            with open_regular(path) as file:
                head = file.read(LOOKED_AT)
                size = max(file.seek(0, 2), len(head))
    except (OSError, ValueError, MsalError):
        return Forecast()
    return of_beginning(
        head,
        size,
        path,
        format=format,
        to=to,
        method_bytes_per_face=method_bytes_per_face,
        beside=_beside(head, path) if len(head) == size else 0,
    )


def of_beginning(
    head: bytes,
    size: int,
    name: str,
    *,
    format: str | None = None,
    to: str | None = None,
    method_bytes_per_face: int = 0,
    beside: int = 0,
) -> Forecast:
    """What a file of ``size`` bytes that begins with ``head`` will ask for; see ``forecast``.

    ``beside`` are the bytes of files that hold a part of it.
    """
    packed = 0
    if head[:2] == GZIP_MAGIC:
        packed = size
        head, size = _expanded(head, size)
    found = format_of_name(name) if format is None else format.lower().removeprefix(".")
    found = found or content_format(head)
    counts = _Counts(found)
    try:
        if found == "ply":
            counts = _of_ply(head, size, is_packed=bool(packed))
        elif found == "stl":
            counts = _of_stl(head, size, is_packed=bool(packed))
        elif found == "glb":
            counts = _of_glb(head, size)
        elif found == "vtk" and _VTK_TEXT.match(head):
            counts = _Counts("vtk-ascii")
        elif found == "gltf" and beside:
            counts = _of_description(json.loads(head), size + beside)
    except (MsalError, ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError):
        # The reader will refuse it, and say why.
        counts = _Counts(found)
    size = max(size + beside, counts.size)
    triangles = counts.triangles
    if triangles is None:
        triangles = int(size / _BYTES_PER_FACE.get(counts.kind, _BYTES_PER_FACE_ELSE))
    per_byte = _PER_BYTE.get(counts.kind, _PER_BYTE[""])
    per_face = method_bytes_per_face
    if to is not None:
        per_face += _CONVERTED_AS.get(to, _CONVERTED)
    needed = BASE_BYTES + per_byte * size + 2 * packed + per_face * triangles
    if counts.kind not in _PER_BYTE:
        needed += _LIBRARY_BYTES
    if counts.triangles is not None and counts.vertices is not None:
        elements = counts.vertices + counts.triangles
        needed += _PER_ELEMENT.get(counts.kind, _PER_ELEMENT_ELSE) * elements
    elif counts.kind in _PER_ELEMENT or counts.kind in ("ply", "stl"):
        # Sizes alone tell of these formats what they tell of any.
        needed += (_PER_BYTE_ELSE - per_byte) * size
    return Forecast(found, counts.told_vertices, counts.faces, int(needed))


@dataclass(frozen=True, slots=True)
class _Counts:
    """``kind`` is the key of the tables above; ``vertices`` and ``triangles`` may be estimates,
    ``told_vertices`` and ``faces`` stand in the file, and ``size`` is what it must have."""

    kind: str
    vertices: int | None = None
    triangles: int | None = None
    told_vertices: int | None = None
    faces: int | None = None
    size: int = 0


def _beside(head: bytes, path: str) -> int:
    """Bytes of the files that the .gltf at ``path`` names as its buffers."""
    if format_of_name(path) != "gltf" or is_url(path):
        return 0
    from msal_cli.codecs.gltf import names_of_buffers

    try:
        return sum((Path(path).parent / name).stat().st_size for name in names_of_buffers(head))
    except (OSError, ValueError):
        return 0  # the reader says why


def _expanded(head: bytes, size: int) -> tuple[bytes, int]:
    """The beginning of what is compressed, and how large the whole may be.

    The last bytes of the file would tell its size, but only modulo 4 GB and of its last member:
    that the rest compresses like the beginning is the better guess, with a quarter on top.
    """
    member = zlib.decompressobj(wbits=31)
    try:
        beginning = member.decompress(head, LOOKED_AT)
    except zlib.error:
        return b"", size
    used = len(head) - len(member.unconsumed_tail) - len(member.unused_data)
    if len(head) == size and member.eof and not member.unused_data:
        return beginning, len(beginning)
    ratio = 1.25 * len(beginning) / max(1, used)
    return beginning, int(min(ratio * size, max(ALWAYS_EXPANDED, LARGEST_RATIO * size)))


def _of_ply(head: bytes, size: int, *, is_packed: bool) -> _Counts:
    header = ply_header.parsed(memoryview(head))
    vertex, face = header.find("vertex"), header.find("face")
    strips = header.find("tristrips") if face is None else None
    n_vertices = vertex.count if vertex is not None else 0
    n_faces = face.count if face is not None else 0
    is_text = header.encoding == "ascii"
    kind = "ply-ascii" if is_text else "ply"
    least = header.size + sum(_least_bytes(one, is_text) for one in header.elements)
    if least > size and not is_packed:
        return _Counts(kind)
    if is_packed and least > max(_ALWAYS_BELIEVED, 4 * size):
        # A header that claims so much more than its compressed bytes lies.
        return _Counts(kind)
    triangles = n_faces
    if face is not None and not is_text and not is_packed:
        triangles = max(triangles, _triangles(header, face, size - least))
    if strips is not None:
        # Each item of a strip but its first two is a triangle; how many there are, only reading
        # the strips tells.
        items = 4 * strips.count if is_packed else max(0, size - least) // (2 if is_text else 4)
        return _Counts(kind, n_vertices, items, n_vertices, None, least)
    if is_packed and not is_text:
        # Triangles, as nearly all scans are.
        lists = [one for one in face.properties if one.is_list] if face is not None else []
        least += n_faces * sum(3 * _item_bytes(one.code) for one in lists)
    return _Counts(kind, n_vertices, triangles, n_vertices, n_faces, least)


def _least_bytes(element: Element, is_text: bool) -> int:
    """The fewest bytes that an element can take: its lists empty."""
    if is_text:
        return 2 * element.count * len(element.properties)
    return element.count * sum(
        _item_bytes(one.count_code if one.is_list else one.code) for one in element.properties
    )


def _item_bytes(code: str) -> int:
    return int(code[1])


def _triangles(header: Header, face: Element, rest: int) -> int:
    """The triangles that the polygons can be cut into, if all list items are their corners."""
    lists = [_item_bytes(one.code) for one in face.properties if one.is_list]
    others = (one.properties for one in header.elements if one is not face)
    if not lists or any(one.is_list for properties in others for one in properties):
        return 0
    return max(0, rest // sum(lists) - 2 * face.count)


def _of_stl(head: bytes, size: int, *, is_packed: bool) -> _Counts:
    count = int.from_bytes(head[80:84], "little")
    if b"\0" in head[:1024] or (len(head) >= 84 and size == 84 + 50 * count):
        if len(head) < 84 or (size < 84 + 50 * count and not is_packed):
            return _Counts("stl")
        if is_packed and 84 + 50 * count > max(_ALWAYS_BELIEVED, 4 * size):
            return _Counts("stl")
        # A closed surface has half as many vertices as facets, once its corners are welded.
        return _Counts("stl", count // 2, count, 3 * count, count, 84 + 50 * count)
    facets = len(_FACET.findall(head))
    if not facets:
        return _Counts("stl-ascii")
    # A facet that is cut off at the end of what was read does not count as one.
    estimate = int(size * facets / len(head)) + 1
    return _Counts("stl-ascii", estimate // 2, estimate)


def _of_glb(head: bytes, size: int) -> _Counts:
    length = int.from_bytes(head[12:16], "little")
    if head[:4] != b"glTF" or _GLB_CHUNK + length > len(head):
        return _Counts("glb")
    return _of_description(json.loads(head[_GLB_CHUNK : _GLB_CHUNK + length]), size)


def _of_description(document: dict[str, Any], size: int) -> _Counts:
    """The counts of a glTF scene whose description and buffers have ``size`` bytes."""
    accessors = document["accessors"]
    positions: set[int] = set()
    triangles = 0
    for mesh in document["meshes"]:
        for part in mesh["primitives"]:
            position = part["attributes"]["POSITION"]
            positions.add(position)
            corners = part.get("indices", position)
            triangles += int(accessors[corners]["count"]) // 3
    vertices = sum(int(accessors[one]["count"]) for one in positions)
    if not 0 <= vertices <= size or not 0 <= triangles <= size:
        return _Counts("glb")
    return _Counts("glb", vertices, triangles, vertices, triangles)
