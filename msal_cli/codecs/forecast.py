"""What a file will need, forecast from its size and its first 64 KB before anything is loaded.

A forecast is for deciding who may run beside whom, and for refusing a file that cannot fit: it is
never below what was measured, and at most about twice as much.  It explains nothing: whatever is
damaged, hostile or not understood has no counts here, and the reader says what is wrong with it.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

from msal_cli.codecs.detection import content_format, format_of_name
from msal_cli.codecs.headers import read_header
from msal_cli.errors import MsalError
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED, GZIP_MAGIC, LARGEST_RATIO
from msal_cli.storage.regular import LOOKED_AT, open_regular
from msal_cli.storage.urls import is_url

BASE_BYTES = 50_000_000
"""Resident memory of a worker that has denoised a mesh of next to nothing: the interpreter, the
libraries and the compiled kernels (36 to 46 MB measured)."""

# Bytes of resident memory per byte of the file, and per vertex and per triangle together, at the
# peak of the default method.  From benchmarks/peak_memory.py on a torus with a million faces:
# the forecast is what was measured plus 8 to 20 %.
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
    "off": 15.0,
    "gltf": 19.0,
    "3mf": 52.0,
    "": 32.0,
}
_PER_BYTE_ELSE = 9.2
_PER_ELEMENT = {"glb": 75.0, "ply": 45.0, "stl": 45.0}
_PER_ELEMENT_ELSE = 60.0

# Where the counts are not known: a triangle for so many bytes, for what a method adds.  Fewer bytes
# than files have, that is, more triangles.
_BYTES_PER_FACE = {"obj": 30.0, "vtk": 24.0, "vtu": 12.0, "glb": 16.0, "gltf": 20.0, "3mf": 8.0}
_BYTES_PER_FACE["stl-ascii"] = 200.0
_BYTES_PER_FACE_ELSE = 24.0

# Bytes per triangle that writing another format takes, what was written being read back.
_CONVERTED = 450


@dataclass(frozen=True, slots=True)
class Forecast:
    """What is known of a file before it is loaded.

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

            head, size = remote.read_beginning(path, LOOKED_AT)
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
        head, size = expand_beginning(head, size)
    found = format_of_name(name) if format is None else format.lower().removeprefix(".")
    found = found or content_format(head)
    header = read_header(found, head, size, is_packed=bool(packed), beside=beside)
    flavour, triangles = header.flavour, header.n_triangles
    size = max(size + beside, header.least_bytes)
    if triangles is None:
        triangles = int(size / _BYTES_PER_FACE.get(flavour, _BYTES_PER_FACE_ELSE))
    per_byte = _PER_BYTE.get(flavour, _PER_BYTE[""])
    per_face = method_bytes_per_face
    if to is not None:
        per_face += _CONVERTED
    needed = BASE_BYTES + per_byte * size + 2 * packed + per_face * triangles
    if header.n_triangles is not None and header.n_vertices is not None:
        elements = header.n_vertices + header.n_triangles
        needed += _PER_ELEMENT.get(flavour, _PER_ELEMENT_ELSE) * elements
    elif flavour in _PER_ELEMENT:
        # Sizes alone say of these formats what they say of any.
        needed += (_PER_BYTE_ELSE - per_byte) * size
    return Forecast(found, header.vertices, header.faces, int(needed))


def _beside(head: bytes, path: str) -> int:
    """Bytes of the files that the .gltf at ``path`` names as its buffers."""
    if format_of_name(path) != "gltf" or is_url(path):
        return 0
    from msal_cli.codecs.gltf import names_of_buffers

    try:
        return sum((Path(path).parent / name).stat().st_size for name in names_of_buffers(head))
    except (OSError, ValueError):
        return 0  # the reader says why


def expand_beginning(head: bytes, size: int) -> tuple[bytes, int]:
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
