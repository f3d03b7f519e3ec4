"""What the beginning of a file says of the whole: counts, and how many bytes they ask for.

``header_check`` refuses by it a file that cannot be what it says, ``forecast`` foresees what a
file costs.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from msal_cli.codecs import ply_header
from msal_cli.codecs.detection import refuse_utf16
from msal_cli.errors import MsalError, TruncatedError

_ALWAYS_BELIEVED = 256 << 20
"""Bytes that the header of a compressed file may always claim."""

_GLB_CHUNK = 20
_VTK_TEXT = re.compile(rb"[^\n]*\n[^\n]*\n\s*ASCII", re.IGNORECASE)
_FACET = re.compile(rb"\bfacet\s+(?:normal|outer)\b", re.IGNORECASE)


_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Header:
    """What the beginning of a file says.

    Attributes
    ----------
    flavour : the format, with ``-ascii`` for a text of a format that has both.
    is_text : whether the file is text, which has no zero bytes; None where that was not looked at.
    least_bytes, most_bytes : how many bytes the file must and may have; None for no limit.
    vertices, faces : what the header counts, polygons as the file does; None where it does not.
    n_vertices, n_triangles : the same, estimated where the header does not count them.
    error : why the reader will refuse the file.
    """

    flavour: str
    is_text: bool | None = None
    least_bytes: int = 0
    most_bytes: int | None = None
    vertices: int | None = None
    faces: int | None = None
    n_vertices: int | None = None
    n_triangles: int | None = None
    error: MsalError | None = None


def read_header(
    format: str, head: bytes, size: int, *, is_packed: bool = False, beside: int = 0
) -> Header:
    """The header of a file of ``size`` bytes that begins with ``head``; never raises.

    ``is_packed`` is set where the file is compressed, so that its size is a guess; ``beside`` are
    the bytes of other files that hold a part of it.
    """
    readers: dict[str, Callable[[], Header]] = {
        "ply": lambda: _read_ply(head, size, is_packed),
        "stl": lambda: _read_stl(head, size, is_packed),
        "glb": lambda: _read_glb(head, size, is_packed),
        "obj": lambda: _read_obj(head),
        "vtk": lambda: Header("vtk-ascii" if _VTK_TEXT.match(head) else "vtk"),
    }
    if beside:
        readers["gltf"] = lambda: Header("glb", **_described(head, size + beside))
    try:
        refuse_utf16(head)
        return readers[format]() if format in readers else Header(format)
    except MsalError as error:
        return Header(format, error=error)


def _believed(size: int, is_packed: bool) -> int:
    """The bytes that a header may claim."""
    return max(_ALWAYS_BELIEVED, 4 * size) if is_packed else size


def _read_ply(head: bytes, size: int, is_packed: bool) -> Header:
    is_whole = is_packed or len(head) >= size
    view = memoryview(head)
    header, error = _try(lambda: ply_header.parsed(view, is_whole))
    if header is None:
        # The end of the last line may be all that was not read.
        header, _ = _try(lambda: ply_header.parsed(view))
    if header is None:
        return Header("ply", error=error)
    vertex, face = header.find("vertex"), header.find("face")
    strips = header.find("tristrips") if face is None else None
    grid = header.find("range_grid") if face is None else None
    n_vertices = vertex.count if vertex is not None else 0
    n_faces = face.count if face is not None else 0
    is_text = header.encoding == "ascii"
    flavour = "ply-ascii" if is_text else "ply"
    most = None if is_text else header.most_bytes()
    least = header.least_bytes() + is_text
    if least > _believed(size, is_packed):
        if error is None and least - is_text > size:
            error = _too_short(size, least - is_text)
        return Header(flavour, is_text, most_bytes=most, error=error)
    n_triangles: int = n_faces
    if strips is not None:
        # Each item of a strip but its first two is a triangle; how many there are, only reading
        # the strips tells.
        n_triangles = 4 * strips.count if is_packed else (size - least) // (2 if is_text else 4)
    elif grid is not None:
        # Most of its samples may be empty; a vertex has two triangles.
        n_triangles = 2 * min(grid.count, n_vertices)
    elif face is not None and not is_text and not is_packed:
        n_triangles = max(n_faces, _most_triangles(header, face, size - least))
    elif face is not None and not is_text:
        # Triangles, as nearly all scans are.
        items = (int(one.code[1]) for one in face.properties if one.is_list)
        least += n_faces * 3 * sum(items)
    faces = None if strips is not None else n_faces
    counts = n_vertices, faces, n_vertices, n_triangles
    return Header(flavour, is_text, least, most, *counts, error)


def _most_triangles(header: ply_header.Header, face: ply_header.Element, rest: int) -> int:
    """The triangles that the polygons can be cut into, if all list items are their corners."""
    items = [int(one.code[1]) for one in face.properties if one.is_list]
    others = (one.properties for one in header.elements if one is not face)
    if not items or any(one.is_list for properties in others for one in properties):
        return 0
    return max(0, rest // sum(items) - 2 * face.count)


def _read_stl(head: bytes, size: int, is_packed: bool) -> Header:
    from msal_cli.codecs import stl

    is_text = stl.is_text(head, size)
    most, error = (None, None) if is_text else _try(lambda: stl.wanted_bytes(head, size))
    count = int.from_bytes(head[80:84], "little")
    least = 84 + 50 * count
    # A text with zeros behind it is forecast as a binary file whose count is not known.
    if b"\0" in head[:1024] or (len(head) >= 84 and size == least):
        if len(head) < 84 or least > _believed(size, is_packed):
            return Header("stl", is_text, error=error)
        # A closed surface has half as many vertices as facets, once its corners are welded.
        counts = 3 * count, count, count // 2, count
        return Header("stl", is_text, least, most, *counts, error)
    facets = len(_FACET.findall(head))
    if not facets:
        return Header("stl-ascii", is_text, most_bytes=most, error=error)
    # A facet that is cut off at the end of what was read does not count as one.
    n_facets = int(size * facets / len(head)) + 1
    return Header(
        "stl-ascii",
        is_text,
        most_bytes=most,
        n_vertices=n_facets // 2,
        n_triangles=n_facets,
        error=error,
    )


def _read_glb(head: bytes, size: int, is_packed: bool) -> Header:
    from msal_cli.codecs import gltf

    most, error = _try(
        lambda: size if is_packed else gltf.expected_bytes(memoryview(head), size),
    )
    stop = _GLB_CHUNK + int.from_bytes(head[12:16], "little")
    is_there = head[:4] == b"glTF" and stop <= len(head)
    counts = _described(head[_GLB_CHUNK:stop], size) if is_there else {}
    return Header("glb", False, most_bytes=most, error=error, **counts)


def _try(read: Callable[[], _T]) -> tuple[_T | None, MsalError | None]:
    """What ``read`` returns, or its error."""
    try:
        return read(), None
    except MsalError as error:
        return None, error


def _described(text: bytes, size: int) -> dict[str, Any]:
    """The counts of a glTF scene whose description and buffers have ``size`` bytes; nothing where
    the description is damaged, as the reader will say."""
    try:
        document = json.loads(text)
        accessors = document["accessors"]
        parts = [part for mesh in document["meshes"] for part in mesh["primitives"]]
        # What is shared is read once.
        corners = {(part["attributes"]["POSITION"], part.get("indices")) for part in parts}
        n_vertices = sum(int(accessors[each]["count"]) for each in {each for each, _ in corners})
        n_triangles = sum(
            int(accessors[position if indices is None else indices]["count"]) // 3
            for position, indices in corners
        )
    except (ValueError, KeyError, IndexError, TypeError, AttributeError, RecursionError):
        return {}
    if not 0 <= n_vertices <= size or not 0 <= n_triangles <= size:
        return {}
    counts = {"vertices": n_vertices, "faces": n_triangles}
    return {**counts, "n_vertices": n_vertices, "n_triangles": n_triangles}


def _read_obj(head: bytes) -> Header:
    from msal_cli.codecs.obj import refuse_binary

    refuse_binary(head)
    return Header("obj", True)


def _too_short(size: int, least: int) -> TruncatedError:
    return TruncatedError(
        f"the header counts {least:,} bytes at the least, but the file has {size:,}",
        where=f"byte {size}",
        hint="the file was cut short or its header counts are wrong; copy or export it again",
    )
