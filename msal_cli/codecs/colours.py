"""Colours of vertices, for conversions and for pictures; the codecs themselves keep bytes."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats
from msal_cli.codecs.mesh_file import MeshFile

Colours = NDArray[np.uint8]

_PLY_NAMES = (
    ("red", "green", "blue", "alpha"),
    ("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"),
)
_CONTINUED = re.compile(rb"\\\r?\n")


def vertex_colours(mesh_file: MeshFile) -> Colours | None:
    """Colours (n, 3) or (n, 4) of a PLY or OBJ file's vertices, or None where it has none.

    Colours as floating-point numbers are taken to go from 0 to 1.
    """
    if mesh_file.format == "ply":
        return _of_ply(mesh_file)
    if mesh_file.format == "obj" and "vertex colours" in mesh_file.properties:
        return _of_obj(mesh_file)
    return None


def _to_bytes(colours: Floats, scale: float = 1.0) -> Colours:
    """``colours`` times ``scale`` as whole numbers from 0 to 255; 0 for what is no number."""
    scaled = np.nan_to_num(colours * scale, posinf=255.0, neginf=0.0)
    return np.rint(np.clip(scaled, 0.0, 255.0)).astype(np.uint8)


def _of_ply(mesh_file: MeshFile) -> Colours | None:
    from msal_cli.codecs.ply import PlyFile

    assert isinstance(mesh_file, PlyFile)
    scalar = mesh_file.vertex_scalars()
    for names in _PLY_NAMES:
        present = tuple(name for name in names if name in scalar)
        codes = {scalar[name] for name in present}
        if present[:3] != names[:3] or len(codes) != 1:
            continue
        (code,) = codes
        if code not in ("u1", "f4", "f8"):
            return None
        return _to_bytes(mesh_file.read_scalars(present), 255.0 if code != "u1" else 1.0)
    return None


def _of_obj(mesh_file: MeshFile) -> Colours | None:
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
    return _to_bytes(colours, 255.0 if colours.max(initial=0.0) <= 1.0 else 1.0)
