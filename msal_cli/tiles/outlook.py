"""What a text or a compressed file will be once it is converted, by its beginning and its size."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from msal_cli.codecs.detection import resolve_format
from msal_cli.codecs.forecast import expand_beginning
from msal_cli.codecs.headers import read_header
from msal_cli.codecs.ply_header import MOST_BYTES
from msal_cli.codecs.streamed.byte_ranges import file_size, read_range
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.storage.gzip_streams import GZIP_MAGIC, is_gzip_name, refuse_content
from msal_cli.storage.limits import LOOKED_AT

FORMATS = ("ply", "obj", "stl")
"""Those that can be read in pieces, as text or binary."""

# Less than files of scanners have, that is, more vertices.
_BYTES_PER_VERTEX = 50
_BYTES_PER_FACET = 200

_PER_BYTE = 2
"""Bytes of numbers per byte of text, at most about; those of few digits take more."""


@dataclass(frozen=True)
class Outlook:
    """What is expected of a file before its numbers are in a folder.

    Attributes
    ----------
    size : bytes of what is in the file, expanded.
    converted_bytes : what the conversion writes, at most about.

    The others are those of ``codecs.streamed_mesh.StreamedMesh``; counts are guesses where no
    header has them.
    """

    format: str
    size: int
    converted_bytes: int
    n_vertices: int
    n_polygons: int
    are_corners: bool
    has_normals = False
    vertex_type = np.float64


Found: TypeAlias = StreamedMesh | Outlook


def look_ahead(path: str, format: str | None = None) -> Outlook | None:
    """What to expect of a file that ``open_streamed`` converts; None for any other.

    Raises
    ------
    InputError
        if it cannot be read, or its beginning is of another format than its name says.
    """
    size = file_size(path)
    head = read_range(path, 0, min(size, max(LOOKED_AT, MOST_BYTES))).tobytes()
    is_packed = head[:2] == GZIP_MAGIC
    if is_packed:
        head, size = expand_beginning(head, size)
    elif is_gzip_name(path):
        raise refuse_content(size)
    wanted = resolve_format(head, path, format, size)
    header = read_header(wanted, head, size, is_packed=is_packed)
    is_text = wanted == "obj" or header.flavour.endswith("-ascii")
    if wanted not in FORMATS or not (is_text or is_packed):
        return None
    n_vertices, n_polygons = header.vertices, header.faces
    if n_polygons is None:
        per_face = _BYTES_PER_FACET if wanted == "stl" else _BYTES_PER_VERTEX // 2
        n_polygons = size // per_face
    if wanted == "stl":
        n_vertices = 3 * n_polygons
    elif n_vertices is None:
        n_vertices = size // _BYTES_PER_VERTEX
    return Outlook(
        wanted,
        size,
        size * (_PER_BYTE * is_text + is_packed),
        n_vertices,
        n_polygons,
        are_corners=wanted == "stl",
    )
