"""What the size of a file and its first 64 KB show: counts, a forecast of memory, and false counts.

A header may count more than the file contains.  Files that are refused here would also be refused
by the codec, after all was read; except very large files with very much after their mesh.

A forecast decides which files may run at the same time, and refuses a file that cannot fit: it is
never below what was measured, and at most about twice as much.  It reports no errors: damaged,
hostile or unknown content has no counts, and the reader says what is wrong with it.
"""

import json
import os
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TypeVar

from msal_cli.codecs import ply_header
from msal_cli.codecs.detection import content_format, format_of_name, refuse_no_mesh
from msal_cli.errors import MsalError, TooLargeError, cut_short
from msal_cli.light_dataclass import dataclass, field
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED, GZIP_MAGIC, MAX_RATIO, read_whole
from msal_cli.storage.regular import LOOKED_AT, Buffer, largest_bytes, open_regular, too_large
from msal_cli.storage.urls import is_url

_ALWAYS_BELIEVED = 256 << 20  # bytes that the header of a compressed file may claim in any case

_GLB_CHUNK = 20
_VTK_TEXT = re.compile(rb"[^\n]*\n[^\n]*\n\s*ASCII", re.IGNORECASE)
_FACET = re.compile(rb"\bfacet\s+(?:normal|outer)\b", re.IGNORECASE)


_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Header:
    flavour: str  # the format, with ``-ascii`` for the text of a format that also has binary
    # least_bytes, most_bytes: how many bytes the file must and may have; None is unlimited
    least_bytes: int = 0
    most_bytes: int | None = None
    # vertices, faces: counts of the header, polygons as the file counts them; None without counts
    vertices: int | None = None
    faces: int | None = None
    # n_vertices, n_triangles: the same, or estimates if the header has no counts
    n_vertices: int | None = None
    n_triangles: int | None = None
    error: MsalError | None = None  # the error with which the reader will refuse the file


def read_header(
    format: str, head: bytes, size: int, *, is_packed: bool = False, beside: int = 0
) -> Header:
    """The header of a file of ``size`` bytes that begins with ``head``; never raises.

    ``is_packed`` means that the file is compressed, so that its size is a guess; ``beside`` are the
    bytes of other files that contain a part of it.
    """
    view = memoryview(head)
    try:
        refuse_no_mesh(head)
        if format == "obj":
            from msal_cli.codecs.obj import refuse_binary

            refuse_binary(head)
            return Header("obj")
        if format == "ply":
            return _read_ply(head, size, is_packed)
        if format == "stl":
            return _read_stl(head, size, is_packed)
        if format == "glb":
            from msal_cli.codecs.gltf import expected_bytes

            most, error = _try(lambda: size if is_packed else expected_bytes(view, size))
            stop = _GLB_CHUNK + int.from_bytes(head[12:16], "little")
            is_there = head[:4] == b"glTF" and stop <= len(head)
            counts = _count_scene(head[_GLB_CHUNK:stop], size) if is_there else {}
            return Header("glb", most_bytes=most, error=error, **counts)
        if format == "gltf" and beside:
            return Header("glb", **_count_scene(head, size + beside))
        is_vtk_text = format == "vtk" and _VTK_TEXT.match(head)
        return Header("vtk-ascii" if is_vtk_text else format)
    except MsalError as error:
        return Header(format, error=error)


def _max_claim(size: int, is_packed: bool) -> int:
    return max(_ALWAYS_BELIEVED, 4 * size) if is_packed else size


def _read_ply(head: bytes, size: int, is_packed: bool) -> Header:
    view, is_whole = memoryview(head), is_packed or len(head) >= size
    header, error = _try(lambda: ply_header.parse_header(view, is_whole))
    # Perhaps only the end of the last line was not read.
    header = header or _try(lambda: ply_header.parse_header(view))[0]
    if header is None:
        return Header("ply", error=error)
    counts = {element.name: element.count for element in header.elements}
    n_vertices, n_faces = counts.get("vertex", 0), counts.get("face", 0)
    is_text = header.encoding == "ascii"
    flavour = "ply-ascii" if is_text else "ply"
    least, most = header.byte_range()
    if least + is_text > _max_claim(size, is_packed):
        if error is None and least > size:
            error = cut_short(
                f"the header counts {least:,} bytes at the least, but the file has {size:,}",
                f"byte {size}",
            )
        return Header(flavour, most_bytes=most, error=error)
    least += is_text
    has_strips = "face" not in counts and "tristrips" in counts
    n_triangles = n_faces
    if has_strips:
        # Each item of a strip but the first two is a triangle; without reading the strips, their
        # number is only limited.
        n_triangles = (size - least) // (2 if is_text else 4)
        n_triangles = 4 * counts["tristrips"] if is_packed else n_triangles
    elif "face" not in counts and "range_grid" in counts:
        # Most of its samples may be empty; a vertex has two triangles.
        n_triangles = 2 * min(counts["range_grid"], n_vertices)
    elif not is_text and (face := header.find("face")) is not None:
        item_bytes = sum(int(prop.code[1]) for prop in face.properties if prop.is_list)
        others = [prop for each in header.elements if each is not face for prop in each.properties]
        if is_packed:
            # Assume triangles, as nearly all scans have.
            least += n_faces * 3 * item_bytes
        elif item_bytes and not any(prop.is_list for prop in others):
            # All list items are corners of polygons.
            n_triangles = max(n_faces, (size - least) // item_bytes - 2 * n_faces)
    faces = None if has_strips else n_faces
    shown = n_vertices, faces, n_vertices, n_triangles
    return Header(flavour, least, most, *shown, error)


def _read_stl(head: bytes, size: int, is_packed: bool) -> Header:
    from msal_cli.codecs import stl

    most, error = None, None
    if not stl.is_text(head, size):
        most, error = _try(lambda: stl.require_bytes(head, size))
    least = stl.wanted_bytes(head)
    count = (least - 84) // 50
    # A text followed by zeros is forecast as a binary file with an unknown count.
    if b"\0" in head[:1024] or (len(head) >= 84 and size == least):
        if len(head) < 84 or least > _max_claim(size, is_packed):
            return Header("stl", error=error)
        # A closed surface has half as many vertices as facets, once its corners are welded.
        counts = 3 * count, count, count // 2, count
        return Header("stl", least, most, *counts, error)
    n_seen = len(_FACET.findall(head))
    if not n_seen:
        return Header("stl-ascii", most_bytes=most, error=error)
    # The last facet that was read may be cut off, and is not counted.
    n_facets = int(size * n_seen / len(head)) + 1
    return Header("stl-ascii", 0, most, None, None, n_facets // 2, n_facets, error)


def _try(read: Callable[[], _T]) -> tuple[_T | None, MsalError | None]:
    try:
        return read(), None
    except MsalError as error:
        return None, error


def _count_scene(text: bytes, size: int) -> dict[str, Any]:
    """The counts of a glTF scene whose description and buffers have ``size`` bytes; empty if the
    description is damaged, which the reader will report."""
    try:
        document = json.loads(text)
        accessors = document["accessors"]
        parts = [part for mesh in document["meshes"] for part in mesh["primitives"]]
        # Shared accessors are read once.
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


MAX_BEHIND = 256 << 20  # bytes after the mesh that are kept, whatever the size of the mesh


def read_input(
    path: str | os.PathLike[str], format: str | None = None, size: int | None = None
) -> Buffer:
    """The bytes of an input file, unless its size and beginning show that it is no mesh.

    ``format`` is the format's name, over the suffix; ``size`` is the size of an object at a
    URL, if known.

    Raises InputError (``E_READ``) if the system cannot read it; FormatError, TruncatedError,
    TooLargeError and UnsupportedError as ``open_mesh`` does, and TooLargeError for a file that can
    never fit into memory.
    """
    name = os.fspath(path)
    return read_whole(
        path, size, check=lambda file, n_bytes: check_beginning(file, n_bytes, name, format)
    )


def check_beginning(file: BinaryIO, size: int, name: str, format: str | None) -> None:
    """Raise for an open file of ``size`` bytes if its size and beginning show that it is invalid;
    small files are left to the codec."""
    if size <= LOOKED_AT:
        return
    if size > largest_bytes():
        raise too_large(size)
    head = file.read(LOOKED_AT)
    said = format.lower().removeprefix(".") if format else format_of_name(name)
    seen = content_format(head, said)
    # The codec explains a format other than that of the name.
    if head[:2] == GZIP_MAGIC or seen not in ("", said or seen):
        return
    header = read_header(said or seen, head, size)
    if header.error is not None:
        raise header.error
    most = header.most_bytes
    if most is not None and size > 2 * most + MAX_BEHIND:
        raise TooLargeError(
            f"the header counts {most:,} bytes at the most, but the file has {size:,}",
            where=f"byte {most}",
            hint="cut off what follows, or export the mesh again",
        )


BASE_BYTES = 52_000_000
"""Resident memory of a worker that has denoised a tiny mesh: the interpreter, the libraries and the
compiled kernels (36 to 48 MB measured)."""


class _Cost(NamedTuple):
    """Bytes of resident memory per byte of the file, and per vertex and per triangle together, at
    the peak of the default method.

    Without counts, a triangle is assumed for every ``bytes_per_face`` bytes, to add the memory of a
    method: fewer bytes than real files have, so that triangles are overestimated.
    """

    per_byte: float
    per_element: float = 60.0
    bytes_per_face: float = 24.0


# From benchmarks/peak_memory.py on a torus with a million faces and two cores.  The forecast is at
# least the measured value, and for PLY, STL, OBJ and VTU at most a tenth more.
_COSTS = {
    "ply": _Cost(2.1),
    "ply-ascii": _Cost(6.0),
    "obj": _Cost(4.5, bytes_per_face=30.0),
    "stl": _Cost(1.6, 62.0),
    "stl-ascii": _Cost(4.2, bytes_per_face=200.0),
    "glb": _Cost(4.0, 75.0, bytes_per_face=16.0),
    "vtk": _Cost(12.0),
    "vtk-ascii": _Cost(13.0),
    "vtu": _Cost(20.5, bytes_per_face=12.0),
    "vtp": _Cost(12.0),
    "off": _Cost(15.0),
    "gltf": _Cost(19.0, bytes_per_face=20.0),
    "3mf": _Cost(52.0, bytes_per_face=8.0),
}
_UNKNOWN = _Cost(32.0)
_PER_BYTE_OF_ANY = 9.2
"""Bytes per byte of a file whose format has counts, but which has none that are valid."""

_CONVERTED = 450  # bytes per triangle for writing another format, and reading it back


@dataclass(frozen=True, slots=True)
class Forecast:
    format: str = ""  # such as ``ply``; empty if it is not known
    # vertices, faces: counts of the header, polygons as the file counts them; None if it has none,
    # or counts more than the file has bytes for
    vertices: int | None = None
    faces: int | None = None
    # an estimate if the header has no count
    n_triangles: int = field(default=0, repr=False)
    # peak resident memory of a process that denoises the file; None if there is no such file
    memory_bytes: int | None = None


def forecast(path: str, **options: Any) -> Forecast:
    """What the file at ``path`` will ask for; reads ``LOOKED_AT`` bytes at most, never raises.

    ``options`` are ``format``, ``to`` and ``method_bytes_per_face`` of ``of_beginning``.
    """
    try:
        if is_url(path):
            from msal_cli.storage import objects as remote

            head, size = remote.read_beginning(path, LOOKED_AT)
        else:
            with open_regular(path) as file:
                head = file.read(LOOKED_AT)
                size = max(file.seek(0, 2), len(head))
    except (OSError, ValueError, MsalError):
        return Forecast()
    beside = _beside(head, path) if len(head) == size else 0
    return of_beginning(head, size, path, beside=beside, **options)


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
    """Forecast a file of ``size`` bytes that begins with ``head``.

    Parameters
    ----------
    format : the format, over that of the name.
    to : the format to write, if it is another one, or the same in another encoding.
    method_bytes_per_face : memory of the method per triangle beyond that of all methods; see
        ``Method.bytes_per_face``.
    beside : the bytes of other files that contain a part of it.
    """
    packed = size if head[:2] == GZIP_MAGIC else 0
    if packed:
        head, size = expand_beginning(head, size)
    format = format_of_name(name) if format is None else format.lower().removeprefix(".")
    format = format or content_format(head)
    header = read_header(format, head, size, is_packed=bool(packed), beside=beside)
    cost = _COSTS.get(header.flavour, _UNKNOWN)
    size = max(size + beside, header.least_bytes)
    n_triangles = header.n_triangles
    if n_triangles is None:
        n_triangles = int(size / cost.bytes_per_face)
    per_face = method_bytes_per_face + (0 if to is None else _CONVERTED)
    needed = BASE_BYTES + cost.per_byte * size + 4 * packed + per_face * n_triangles
    if header.n_triangles is not None and header.n_vertices is not None:
        needed += cost.per_element * (header.n_vertices + header.n_triangles)
    elif header.flavour in ("ply", "stl", "glb"):
        # Without counts, these formats are forecast like any format.
        needed += (_PER_BYTE_OF_ANY - cost.per_byte) * size
    return Forecast(format, header.vertices, header.faces, n_triangles, int(needed))


def _beside(head: bytes, path: str) -> int:
    """Bytes of the files that the .gltf at ``path`` names as its buffers."""
    if format_of_name(path) != "gltf" or is_url(path):
        return 0
    from msal_cli.codecs.gltf import names_of_buffers

    try:
        return sum((Path(path).parent / name).stat().st_size for name in names_of_buffers(head))
    except (OSError, ValueError):
        return 0  # the reader reports the error


def expand_beginning(head: bytes, size: int) -> tuple[bytes, int]:
    """The beginning of a compressed file, expanded, and an estimate of the expanded size.

    The end of a gzip file has a size, but modulo 4 GB and only of the last member.  It is a better
    guess that the rest compresses like the beginning; a quarter is added.
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
    return beginning, int(min(ratio * size, max(ALWAYS_EXPANDED, MAX_RATIO * size)))
