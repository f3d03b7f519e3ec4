"""Clay under a lamp: a mesh as an image that shows its texture."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Floats32, Ints
from msal_cli.view.camera import Camera

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Style:
    """Colours of a picture, (red, green, blue) in 0 to 255.

    ``clay`` is the side of a surface that looks outwards, ``inside`` the other one, which open
    scans show; ``text`` and ``faint`` are for titles and for the lines below.
    """

    background: Colour = (255, 255, 255)
    clay: Colour = (196, 190, 182)
    inside: Colour = (122, 138, 160)
    text: Colour = (28, 30, 34)
    faint: Colour = (96, 100, 108)


LIGHT = Style()

_LAMPS = (
    ((-0.56, 0.60, 0.57), 1.00, 0.20),
    ((0.85, -0.05, 0.45), 0.26, 0.40),
    ((0.10, -0.90, 0.30), 0.14, 0.50),
)
# Ambient light, light at edges, gloss, its sharpness; then the lamps, each with the direction
# towards it (right, up, towards the eye), its strength and how far it reaches round.
_LIGHTS = {
    "clay": ((0.12, 0.14, 0.08, 24.0), _LAMPS),
    # Colours that mean numbers keep their tone: more light from everywhere, no gloss.
    "map": ((0.56, 0.0, 0.0, 1.0), (((-0.55, 0.58, 0.60), 0.58, 0.30),)),
    # Colours of the file are lit as clay is, with less gloss and more light from everywhere,
    # because they may be dark.
    "paint": (
        (0.24, 0.05, 0.02, 24.0),
        tuple((towards, 0.72 * strength, reach) for towards, strength, reach in _LAMPS),
    ),
}

CREASE_DEG = 80.0

SAMPLES = 2
"""Samples along each side of a pixel."""

_HOLLOWS = ((0.008, 0.32), (0.022, 0.45), (0.055, 0.45))
"""How far round to look for what hides the sky, in picture sides, and how much that darkens."""

_UNNOTICED = 0.03
"""Share of that reach by which what is around does not count: facets of a round wall are so far."""

_DIRECTIONS = 8
"""Lines through a pixel on which to look."""


def shade(
    vertices: Floats,
    faces: Ints,
    camera: Camera,
    width: int,
    height: int,
    colours: Image | None = None,
    *,
    style: Style = LIGHT,
    crease_deg: float = CREASE_DEG,
    colours_are: str = "map",
) -> Image:
    """(height, width, 3) uint8: the mesh as the camera sees it.

    Parameters
    ----------
    vertices : (n, 3) in any unit; ``faces`` : (m, 3) integers, counter-clockwise from outside.
    camera : where from; it shows all that it was made for at any ``width`` and ``height``.
    colours : (n, 3) uint8, one for each vertex; None for clay, with the insides in another tone.
    crease_deg : edges that turn by more stay sharp, by less than half of it are round; 0 shows
        each face flat.
    colours_are : ``map`` for colours that mean numbers and keep their tone, ``paint`` for the
        object's own, which get more of the light and shadow.
    """
    from msal_cli.kernels import z_buffer

    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    clay, inside = (np.array(colour, dtype=np.float32) for colour in (style.clay, style.inside))
    if colours is None:
        if _is_inside_out(vertices, faces):
            clay, inside = inside, clay
        paint, colours_are = clay[None, :], "clay"
    else:
        paint = np.ascontiguousarray(colours, dtype=np.float32)
    surface, lamps = _LIGHTS[colours_are]
    rows = [(*surface, 0.0)]
    for direction, strength, reach in lamps:
        rows.append((*np.array(direction) / np.linalg.norm(direction), strength, reach))
    seen = camera.seen(vertices)
    normals = z_buffer.corner_normals(seen, faces, float(np.radians(crease_deg)))
    scale = SAMPLES * camera.pixels_per_unit(width, height)
    points = np.empty_like(seen)
    points[:, 0] = seen[:, 0] * scale + 0.5 * SAMPLES * width
    points[:, 1] = 0.5 * SAMPLES * height - seen[:, 1] * scale
    points[:, 2] = seen[:, 2] * scale
    nearness, front = z_buffer.nearest_faces(points, faces, SAMPLES * height, SAMPLES * width)
    sums, depth = z_buffer.light_samples(
        SAMPLES, points, faces, nearness, front, normals, paint, inside, np.array(rows)
    )
    # Colours 0 to 255 times the share of each pixel that shows the mesh, and that share.
    lit, covered = sums[..., :3], sums[..., 3]
    open_sky = _open_sky(depth / np.float32(SAMPLES), covered)
    if colours_are == "map":
        open_sky = 0.5 + 0.5 * open_sky
    behind = np.array(style.background, dtype=np.float32) * (1.0 - covered[..., None])
    image = np.rint(lit * open_sky[..., None] + behind)
    result: Image = image.clip(0, 255).astype(np.uint8)
    return result


def _is_inside_out(vertices: Floats, faces: Ints) -> bool:
    """Whether a closed surface is wound so that all of its normals look inwards."""
    from msal_cli.kernels.geometry import area_and_volume, face_normals_and_areas

    normals, areas = face_normals_and_areas(vertices, faces)
    total = float(areas.sum())
    # Over a closed surface the normals, weighted by area, add up to nothing.
    if np.linalg.norm(areas @ normals) > 0.01 * total:
        return False
    return area_and_volume(vertices - vertices.mean(axis=0), faces)[1] < 0.0


def _open_sky(depth: Floats32, covered: Floats32) -> Floats32:
    """(h, w) 0 to 1: how little of what is around each pixel is in front of it.

    ``depth`` is the nearness to the eye in pixels, 0 where nothing is.  Looks at the mean of two
    points on opposite sides of each pixel, which is before it in a hollow and beside a wall, but
    not on a plane, however it is tilted.  Where one of them shows nothing there is sky.
    """
    open_sky = np.ones(depth.shape, dtype=np.float32)
    height, width = depth.shape
    inside = (covered > 0.0).astype(np.float32)
    for reach, strength in _HOLLOWS:
        radius = max(2, round(reach * min(height, width)))
        around = np.pad(depth, radius)
        is_there = np.pad(covered > 0.0, radius)
        hidden: Floats32 = np.zeros(depth.shape, dtype=np.float32)
        for k in range(_DIRECTIONS):
            angle = np.pi * k / _DIRECTIONS
            across, down = round(radius * np.cos(angle)), round(radius * np.sin(angle))
            near, far = (
                (slice(radius + y, radius + y + height), slice(radius + x, radius + x + width))
                for y, x in ((down, across), (-down, -across))
            )
            before: Floats32 = np.float32(0.5) * (around[near] + around[far]) - depth
            counted = np.clip(before - np.float32(_UNNOTICED * radius), 0.0, radius)
            hidden += counted * (is_there[near] & is_there[far])
        # A few lines alone would leave copies of every outline.
        soft = max(1, radius // 4)
        seen = np.maximum(_blur(inside, soft), np.float32(1e-6))
        share = _blur(hidden, soft) * inside / seen
        share *= np.float32(1.0 / (_DIRECTIONS * radius))
        open_sky *= np.float32(1.0) - np.float32(strength) * share ** np.float32(0.75)
    return open_sky


def _blur(image: Floats32, radius: int) -> Floats32:
    """Mean over squares of ``2 radius + 1`` pixels; beyond the border there are zeros."""
    side = 2 * radius + 1
    height, width = image.shape
    sums = np.cumsum(np.pad(image, ((radius + 1, radius), (0, 0))), axis=0, dtype=np.float64)
    rows = sums[side:] - sums[:height]
    sums = np.cumsum(np.pad(rows, ((0, 0), (radius + 1, radius))), axis=1)
    blurred: Floats32 = ((sums[:, side:] - sums[:, :width]) / side**2).astype(np.float32)
    return blurred
