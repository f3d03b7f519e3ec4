"""Colours of vertices, for conversions and pictures, and colour maps for numbers.  The codecs
themselves keep colours as bytes."""

import functools
import re

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats
from msal_cli.codecs.detection import SCENES
from msal_cli.codecs.mesh_file import MeshFile

Colours = NDArray[np.uint8]

UNPAINTED = (204, 204, 204)  # the colour of parts without colours beside parts that have some

_PLY_NAMES = (
    ("red", "green", "blue", "alpha"),
    ("diffuse_red", "diffuse_green", "diffuse_blue", "diffuse_alpha"),
)
_CONTINUED = re.compile(rb"\\\r?\n")

_GLTF_TYPES = {5126: "<f4", 5121: "<u1", 5123: "<u2"}
"""Number types of colours; the largest whole number of a type means 1."""


def vertex_colours(mesh_file: MeshFile) -> Colours | None:
    """Colours (n, 3) or (n, 4) of the vertices of a PLY, OBJ or glTF file; None if it has none.

    Floating-point colours are assumed to be from 0 to 1.
    """
    if mesh_file.format == "ply":
        return _of_ply(mesh_file)
    if mesh_file.format == "obj" and "vertex colours" in mesh_file.properties:
        return _of_obj(mesh_file)
    if mesh_file.format in SCENES:
        return _of_gltf(mesh_file)
    return None


def _to_bytes(colours: Floats, scale: float = 1.0) -> Colours:
    """``colours`` times ``scale`` as whole numbers from 0 to 255; NaN becomes 0."""
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
    rows = []
    for line in _CONTINUED.sub(b" ", bytes(mesh_file.data)).splitlines():
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


def _of_gltf(mesh_file: MeshFile) -> Colours | None:
    """COLOR_0 of all parts, which is linear light, converted to sRGB bytes; with alpha if any of it
    is not opaque."""
    from msal_cli.codecs.gltf import SceneFile
    from msal_cli.codecs.gltf_scene import as_dict, as_dicts

    assert isinstance(mesh_file, SceneFile)
    scene, has_colours = mesh_file.scene, False
    primitives = [
        as_dict(primitive.get("attributes"))
        for mesh in as_dicts(scene.content.get("meshes"))
        for primitive in as_dicts(mesh.get("primitives"))
    ]
    whole = []
    for part in scene.parts.values():
        shown = np.tile(np.array((*UNPAINTED, 255), dtype=np.uint8), (part.positions.count, 1))
        for attributes in primitives:
            if attributes.get("POSITION") not in [*part.accessors] or "COLOR_0" not in attributes:
                continue
            index = attributes["COLOR_0"]
            kind = scene.entry("accessors", index).get("type")
            if kind not in ("VEC3", "VEC4"):
                continue
            rows = scene.find_rows(index, _GLTF_TYPES, kind, f"accessor {index!r}")
            if rows is None or rows.count != len(shown):
                continue
            largest = np.iinfo(rows.code).max if rows.code != "<f4" else 1.0
            shares = np.clip(rows.rows(scene.data).astype(np.float64) / largest, 0.0, 1.0)
            value = shares[:, :3]
            # The format says linear, but programs for scans write sRGB bytes unconverted.
            if rows.code != "<u1":
                # IEC 61966-2-1
                curve = 1.055 * value ** (1.0 / 2.4) - 0.055
                value = np.where(value <= 0.0031308, 12.92 * value, curve)
            value, has_colours = np.hstack([value, shares[:, 3:]]), True
            shown[:, : value.shape[1]] = _to_bytes(value, 255.0)
        whole.append(shown)
    colours = np.concatenate(whole)
    return (colours if colours[:, 3].min() < 255 else colours[:, :3]) if has_colours else None


# Colour maps: two maps that are perceptually uniform and safe for the colour-blind.
#
# The points, in sRGB, are evenly spaced between a few in OKLab (Ottosson 2020), where equal steps
# look equally large.  Lightness is monotonic within a map (within each half of the diverging one),
# so that values can be ordered without telling hues apart, and in print.

SHADES = 256  # colours in a map
UNKNOWN = (128, 128, 128)  # the colour of NaN

# Maps for values from a minimum, and for values with a sign.  Small values are pale, so that the
# shading of a surface stays visible there.
_POINTS = {
    "sequential": "eeedd2 efe2b7 efd79b eecc7d eec05b edae4e ec9b41 e98834 e67425"
    " d8632e ca5234 bc4038 ad2c3a 942540 7c1e43 651545 4f0a45",
    "diverging": "123780 1d4c93 2a60a6 3775ba 458ace 71a3d7 9abbdf c2d3e5 ebebeb"
    " ebcfc0 e9b396 e6976a e07937 c6642b ac501f 933d13 7a2a06",
}


@functools.cache
def colour_table(map_name: str) -> Colours:
    """The colours of a map, (SHADES, 3) from the lowest to the highest; read-only."""
    points = np.array([list(bytes.fromhex(point)) for point in _POINTS[map_name].split()])
    at = np.linspace(0.0, len(points) - 1.0, SHADES)
    channels = [np.interp(at, np.arange(len(points)), channel) for channel in points.T]
    colours: Colours = np.round(np.stack(channels, axis=1)).astype(np.uint8)
    colours.setflags(write=False)
    return colours


def map_colours(values: Floats, low: float, high: float, map_name: str = "sequential") -> Colours:
    """Colours (n, 3) of values (n,): ``low`` gets the map's first one, ``high`` its last.

    Values beyond these get the colour of the nearer end, NaN gets ``UNKNOWN``.  If ``low`` equals
    ``high``, all values up to it get the first colour (of the diverging map, the middle one), and
    greater ones the last.
    """
    colours = colour_table(map_name)
    values = np.asarray(values, dtype=np.float64)
    if high > low:
        with np.errstate(invalid="ignore", over="ignore"):
            share = (values - low) / (high - low)
    else:
        share = np.where(values > high, 1.0, 0.5 if map_name == "diverging" else 0.0)
    is_number = ~np.isnan(values)
    share = np.clip(np.where(is_number, share, 0.0), 0.0, 1.0)
    shades = np.minimum((share * SHADES).astype(np.intp), SHADES - 1)
    result: Colours = colours[shades]
    result[~is_number] = UNKNOWN
    return result
