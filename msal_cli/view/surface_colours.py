"""Colours of an opened file's vertices, for pictures: one colour (red, green, blue) at each vertex.

Colours of faces and samples of textures become means at the vertices.  What cannot be read is a
note, never an error: a picture of clay is better than none.
"""

from __future__ import annotations

import logging
import re
from dataclasses import replace

import numpy as np

from msal_cli.codecs.colour_values import (
    UNPAINTED,
    Colours,
    SurfaceColours,
    average_at_vertices,
    to_bytes,
)
from msal_cli.codecs.gltf_buffers import folder_of
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.job import comparison
from msal_cli.job.comparison import Surface

log = logging.getLogger("msal")

_DARKEST = 16
"""One colour of all vertices that is darker hides the shape; programs write it where none is
meant."""

_OFF_HEADER = re.compile(r"\s*(?:ST)?(C)?(N)?OFF\b")
_VALID = 0x8000
_MATERIALISE = b"COLOR="


def open_coloured_surface(path: str, format: str | None = None) -> Surface:
    """The surface in the file at ``path`` with its colours."""
    return coloured_surface_of(comparison.opened(path, format), path)


def coloured_surface_of(mesh_file: MeshFile, path: str) -> Surface:
    """The surface in an open file, which is at ``path``, with its colours."""
    return replace(comparison.surface_of(mesh_file), colours=read_surface_colours(mesh_file, path))


def read_surface_colours(mesh_file: MeshFile, path: str) -> SurfaceColours:
    """The colours that the file at ``path``, already open, has for its vertices."""
    try:
        colours, notes = _read(mesh_file, path)
    except Exception as failure:  # colours are an extra, and files come from strangers
        log.info("%s: no colours", path, exc_info=True)
        return SurfaceColours(None, (f"its colours cannot be read: {str(failure)[:200]}",))
    if colours is None:
        return SurfaceColours(None, notes)
    if len(colours) != len(mesh_file.vertices):
        return SurfaceColours(None, (*notes, "its colours do not fit its vertices"))
    if int(colours.max(initial=0)) < _DARKEST:
        return SurfaceColours(None, (*notes, "all of its colours are black, and are not shown"))
    return SurfaceColours(colours, notes)


def _read(mesh_file: MeshFile, path: str) -> tuple[Colours | None, tuple[str, ...]]:
    from msal_cli.codecs.gltf_file import SceneFile
    from msal_cli.codecs.vertex_colours import vertex_colours

    if isinstance(mesh_file, SceneFile):
        from msal_cli.view.gltf_colours import scene_colours

        return scene_colours(mesh_file, folder_of(path))
    if mesh_file.format == "off":
        return _of_off(mesh_file), ()
    if mesh_file.format == "stl":
        return _of_stl(mesh_file), ()
    notes: dict[str, None] = {}
    textured = None
    if mesh_file.format in ("obj", "ply"):
        from msal_cli.view import texture_colours

        read = texture_colours.obj_colours if mesh_file.format == "obj" else None
        textured = (read or texture_colours.ply_colours)(mesh_file, folder_of(path), notes)
    if textured is not None:
        return textured, tuple(notes)
    colours = vertex_colours(mesh_file)
    return None if colours is None else colours[:, :3], tuple(notes)


def _of_off(mesh_file: MeshFile) -> Colours | None:
    """Behind the positions (and normals): whole numbers to 255, or others to 1."""
    text = bytes(mesh_file.replaced(mesh_file.vertices)).decode("latin-1")
    lines = [plain for line in text.splitlines() if (plain := line.partition("#")[0].strip())]
    header = _OFF_HEADER.match(lines[0].lstrip("\xef\xbb\xbf"))
    if header is None:
        return None
    has_colours, has_normals = header.groups()
    n_vertices = len(mesh_file.vertices)
    n_heads, n_counts = 0, 0
    for line in lines:
        n_counts += len(line.split()) - (n_heads == 0)
        n_heads += 1
        if n_counts >= 2:
            break
    first = 6 if has_normals else 3
    rows = [line.split()[first : first + 3] for line in lines[n_heads : n_heads + n_vertices]]
    if len(rows) != n_vertices or any(len(row) < 3 for row in rows):
        return None
    values = np.array(rows, dtype=np.float64)
    if not has_colours and (values.min() < 0.0 or values.max() > 255.0):
        return None  # other numbers, such as normals
    are_whole = not any("." in word for row in rows for word in row)
    return to_bytes(values, 1.0 if are_whole or values.max() > 1.0 else 255.0)


def _of_stl(mesh_file: MeshFile) -> Colours | None:
    """The words of a binary file's facets: 15 bits as VisCAM (and SolidView) or, where the header
    has the colour of all, Materialise Magics writes them."""
    from msal_cli.codecs.stl_facets import FACET, HEADER_BYTES

    properties = mesh_file.properties
    has_default = "colour in the header" in properties
    if mesh_file.encoding == "ascii" or not ("facet attribute words" in properties or has_default):
        return None
    data = bytes(mesh_file.replaced(mesh_file.vertices))
    count = len(mesh_file.faces)
    facets = np.frombuffer(data, dtype=FACET, count=count, offset=HEADER_BYTES + 4)
    words = facets["attribute"].reshape(count, -1)[:, 0].astype(np.int64)
    fifths = np.stack([(words >> shift) & 31 for shift in (10, 5, 0)], axis=1)
    own = (words & _VALID) != 0
    colours = np.tile(np.array(UNPAINTED, dtype=np.float64), (count, 1))
    at = data[:HEADER_BYTES].find(_MATERIALISE)
    if at >= 0:
        default = np.frombuffer(data, np.uint8, 3, at + len(_MATERIALISE))
        colours[:] = default
        fifths, own = fifths[:, ::-1], ~own
    elif not own.any():
        return None
    colours[own] = fifths[own] * (255.0 / 31.0)
    return average_at_vertices(mesh_file.faces, colours[:, None, :], len(mesh_file.vertices))
