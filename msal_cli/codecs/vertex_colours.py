"""Vertex colours of PLY and OBJ files, for conversions; our codecs themselves keep bytes."""

from __future__ import annotations

import functools
import re

import numpy as np
from numpy.typing import NDArray

from msal_cli.codecs.mesh_file import MeshFile

_PLY_NAMES = (
    ("red", "green", "blue", "alpha"),
    ("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"),
)
_CONTINUED = re.compile(rb"\\\r?\n")


def vertex_colours(mesh_file: MeshFile) -> NDArray[np.uint8] | None:
    """Colours (n, 3) or (n, 4) of a PLY or OBJ file's vertices, or None where it has none.

    Colours as floating-point numbers are taken to go from 0 to 1.
    """
    if mesh_file.format == "ply":
        return _of_ply(mesh_file)
    if mesh_file.format == "obj" and "vertex colours" in mesh_file.properties:
        return _of_obj(mesh_file)
    return None


def _of_ply(mesh_file: MeshFile) -> NDArray[np.uint8] | None:
    from msal_cli.codecs.ply_header import parsed
    from msal_cli.codecs.ply_sections import located
    from msal_cli.kernels.text import as_bytes

    # With no vertex moved every codec gives back its very input.
    data = memoryview(mesh_file.replaced(mesh_file.vertices)).cast("B")
    header = parsed(data)
    element = next(one for one in header.elements if one.name == "vertex")
    scalar = {one.name: one.code for one in element.properties if not one.is_list}
    for names in _PLY_NAMES:
        present = tuple(name for name in names if name in scalar)
        codes = {scalar[name] for name in present}
        if present[:3] != names[:3] or len(codes) != 1:
            continue
        (code,) = codes
        if code not in ("u1", "f4", "f8"):
            return None
        wanted = functools.partial(_always, present)
        sections, _ = located(as_bytes(data), header, wanted, last="vertex")
        return _as_bytes(sections["vertex"].slots(present).values, 255.0 if code != "u1" else 1.0)
    return None


def _always(names: tuple[str, ...], _: object) -> tuple[str, ...]:
    return names


def _of_obj(mesh_file: MeshFile) -> NDArray[np.uint8] | None:
    data = bytes(mesh_file.replaced(mesh_file.vertices))
    rows = []
    for line in _CONTINUED.sub(b" ", data).splitlines():
        words = line.split(None, 8)
        if words and words[0] == b"v":
            # x y z r g b, or x y z w r g b
            rows.append(words[-3:] if len(words) in (7, 8) else (b"1", b"1", b"1"))
    try:
        colours = np.array(rows, dtype=np.float64)
    except ValueError:
        return None
    if colours.shape != mesh_file.vertices.shape or not np.isfinite(colours).all():
        return None
    return _as_bytes(colours, 255.0 if colours.max(initial=0.0) <= 1.0 else 1.0)


def _as_bytes(colours: NDArray[np.float64], scale: float) -> NDArray[np.uint8]:
    return np.rint(np.clip(np.nan_to_num(colours) * scale, 0.0, 255.0)).astype(np.uint8)
