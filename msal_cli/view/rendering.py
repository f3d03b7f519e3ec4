"""Draw a mesh as an image: choose a camera, and light the surface so that its texture shows.

Cameras are parallel projections, and all panels of a picture have the same one.
"""

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Floats32, Ints
from msal_cli.kernels import z_buffer
from msal_cli.kernels.geometry import area_and_volume, face_normals_and_areas
from msal_cli.kernels.welding import used_vertices
from msal_cli.light_dataclass import dataclass

# The camera

MARGIN = 0.04  # share of the picture's width and height that is left free on each side
_MAX_GUESS_FACES = 60_000  # faces that are examined to guess up and front


@dataclass(frozen=True, eq=False)
class Camera:
    """A parallel projection, and the size of what it shows."""

    # (3, 3), rows: right, up and towards the eye, unit vectors in the mesh's coordinates
    axes: Floats
    centre: Floats  # (3,) the point in the middle of the picture
    half_width: float  # half_width, half_height: half the extent to show, in the mesh's unit
    half_height: float

    def seen(self, vertices: Floats) -> Floats:
        """(n, 3): right, up and towards the eye from the centre, in the mesh's unit."""
        return np.ascontiguousarray((vertices - self.centre) @ self.axes.T)

    def pixels_per_unit(self, width: int, height: int) -> float:
        """The scale at which all that must be visible fits, with a margin."""
        room = 1.0 - 2.0 * MARGIN
        return room * min(width / (2.0 * self.half_width), height / (2.0 * self.half_height))


def frame_vertices(axes: Floats, vertices: Floats) -> Camera:
    """The camera with these ``axes`` that shows all ``vertices`` (n, 3)."""
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    seen = (vertices - middle) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    half = 0.5 * (high - low)
    min_half = 1e-6 * max(float(half.max()), 1e-300)
    return Camera(
        axes=axes,
        centre=middle + (0.5 * (low + high)) @ axes,
        half_width=max(float(half[0]), min_half),
        half_height=max(float(half[1]), min_half),
    )


_ANGLES = {
    "front": (0.0, 0.0),
    "back": (180.0, 0.0),
    "left": (-90.0, 0.0),
    "right": (90.0, 0.0),
    "top": (0.0, 90.0),
    "bottom": (0.0, -90.0),
}
"""Turn to the right and tilt upwards from the front, in degrees."""


def choose_camera(
    vertices: Floats,
    faces: Ints,
    view: str = "auto",
    *,
    turn_deg: float | None = None,
    tilt_deg: float | None = None,
    up: str = "auto",
    also: Floats | None = None,
) -> Camera:
    """The camera for a named view; all vertices that have a face are in the picture.

    Parameters
    ----------
    vertices : (n, 3); ``faces`` : (m, 3), at least one.
    view : one of ``_ANGLES``, relative to the guessed up and front; or ``auto``, which shows solids
        from the front, a little from the right and from above, but scans of one side and reliefs
        straight from the front.
    turn_deg : more turns to the mesh's right; None is 0, or the choice of ``auto``.
    tilt_deg : more tilts upwards; None likewise.
    up : an axis with its sign, such as ``-y``, if the guess is wrong.
    also : (k, 3) other points to show, such as the same mesh before.
    """
    stance = _with_up(_stance(vertices, faces), up)
    if view == "auto":
        # Given angles replace the guess, but are added to a named view.
        turn = stance.turn_deg if turn_deg is None else turn_deg
        tilt = stance.tilt_deg if tilt_deg is None else tilt_deg
    else:
        turn, tilt = _ANGLES[view]
        turn, tilt = turn + (turn_deg or 0.0), tilt + (tilt_deg or 0.0)
    points = vertices[used_vertices(len(vertices), faces)]
    if also is not None:
        points = np.concatenate([points, also])
    return frame_vertices(rotate(stance.front, stance.up, turn, tilt), points)


def rotate(front: Floats, up: Floats, turn_deg: float, tilt_deg: float) -> Floats:
    """(3, 3) axes of an eye turned and tilted from ``front``; seen from straight above, the front
    is at the bottom of the picture."""
    forward, right, upward = _frame(front, up)
    turn, tilt = np.radians([turn_deg, tilt_deg])
    ahead = np.cos(turn) * forward + np.sin(turn) * right
    towards = np.cos(tilt) * ahead + np.sin(tilt) * upward
    higher = np.cos(tilt) * upward - np.sin(tilt) * ahead
    return np.stack([np.cross(higher, towards), higher, towards])


def _frame(front: Floats, up: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit vectors forward, to the viewer's right, and up, perpendicular to each other."""
    upward = up / np.linalg.norm(up)
    forward = front - (front @ upward) * upward
    forward = forward / np.linalg.norm(forward)
    return forward, np.cross(upward, forward), upward


@dataclass(frozen=True, eq=False)
class _Stance:
    """The guessed pose of a mesh: directions (3,), and the turn and tilt of the view."""

    front: Floats
    up: Floats
    turn_deg: float = 0.0
    tilt_deg: float = 0.0


_ONE_SIDED = 0.2
"""Length of the mean normal above which a surface is a one-sided scan; closed surfaces have 0."""

_RELIEF = 0.3
"""Ratio of the least to the middle extent along principal axes below which a solid is a relief."""

_STANDS = 0.015
"""Share of the area at one end of an axis, minus that at the other end, that makes it the base."""

_STANDS_ON_HEAD = 0.1
"""The same for a base at the top of the file's coordinates, such as a cut-off head."""

_LIES = 0.62
"""Ratio of height to breadth below which an object lies flat, and is seen from higher up."""

_X, _Y, _Z = np.eye(3)


def _stance(vertices: Floats, faces: Ints) -> _Stance:
    """Guess up, front and view of a mesh.

    Files have y or z upwards, few have neither.  A mesh with a base stands on it; a flat one lies
    on its broad side; all others are upright.  With y upwards the front is +z, with z upwards -y,
    as modellers and scanners have it, but objects far longer that way show their long side.
    """
    # A sample of the faces is enough.
    corner = vertices[faces[:: 1 + len(faces) // _MAX_GUESS_FACES]]
    doubled = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    areas = np.linalg.norm(doubled, axis=1)
    total = float(areas.sum())
    if not total > 0.0 or not np.isfinite(total):
        return _Stance(_Z, _Y)
    centres = corner.mean(axis=1)
    facing = doubled.sum(axis=0) / total
    if np.linalg.norm(facing) > _ONE_SIDED:
        return _one_sided(facing)
    spread = centres - areas @ centres / total
    _, principal = np.linalg.eigh((spread * areas[:, None]).T @ spread)
    extents = np.sort(np.ptp(spread @ principal, axis=0))
    if extents[0] < _RELIEF * extents[1]:
        return _relief(principal[:, 0], doubled, areas)
    return _solid(centres, areas)


def _with_up(stance: _Stance, word: str) -> _Stance:
    """The stance with the axis ``word`` upwards; the front changes if it is no longer level."""
    if word == "auto":
        return stance
    axis = np.eye(3)["xyz".index(word[-1])]
    up = -axis if word.startswith("-") else axis
    front = stance.front
    if abs(front @ up) > 0.9 * np.linalg.norm(front):
        # The direction that was taken for up now faces the viewer.
        front = stance.up if stance.up @ up == 0.0 else -_Y
    return _Stance(front, up, stance.turn_deg, stance.tilt_deg)


def _one_sided(facing: Floats) -> _Stance:
    """A one-sided scan is seen from the side that it faces."""
    # A head seen from above is still not an object that lies on its back.
    is_upward = abs(facing[1]) > abs(facing[2]) + 0.5 * np.linalg.norm(facing)
    nearest = _nearest_axis(facing)
    up = _Z if is_upward or nearest[0] else _Y
    if nearest[2] < 0.0:
        # Depth cameras look along z with y downwards, so the surface that they see faces -z.
        up = -_Y
    front, _, _ = _frame(facing, up)
    axis = _nearest_axis(front)
    level = front @ axis
    return _Stance(axis if level > np.cos(np.radians(30.0)) else front, up)


def _relief(thin: Floats, doubled: Floats, areas: Floats) -> _Stance:
    """A relief is seen from the side that has more detail."""
    lean = doubled @ thin / np.maximum(areas, 1e-300)
    shown = [float((areas * (1.0 - lean**2))[sign * lean > 0.2].sum()) for sign in (1.0, -1.0)]
    front = thin if shown[0] >= shown[1] else -thin
    axis = _nearest_axis(front)
    front = axis if front @ axis > np.cos(np.radians(15.0)) else front
    # Up is y, but z if the relief faces along y or x.
    up = _Y if abs(front[2]) >= max(abs(front[0]), abs(front[1])) else _Z
    return _Stance(front, up)


def _solid(centres: Floats, areas: Floats) -> _Stance:
    """A solid is seen from the front right and from above, the more the flatter it is."""
    low, high = centres.min(axis=0), centres.max(axis=0)
    extent = np.maximum(high - low, 1e-300)
    place = (centres - low) / extent
    total = areas.sum()
    base = [
        float((areas[place[:, k] < 0.02].sum() - areas[place[:, k] > 0.98].sum()) / total)
        for k in (1, 2)
    ]
    stands = int(np.argmax(np.abs(base)))
    if base[stands] > _STANDS or base[stands] < -_STANDS_ON_HEAD:
        axis, sign = 1 + stands, float(np.sign(base[stands]))
    else:
        flat = 1 if extent[1] < extent[2] else 2
        if extent[flat] < _LIES * np.sort(extent)[1]:
            axis, sign = flat, 1.0
        else:
            axis, sign = (2 if extent[2] > 1.03 * extent[1] else 1), 1.0
    up = sign * np.eye(3)[axis]
    front = (_Z if axis == 1 else -_Y) * 1.0
    depth = 3 - axis
    if extent[depth] > 1.6 * extent[0]:
        front = _X
    lies = extent[axis] < _LIES * max(extent[0], extent[depth])
    return _Stance(front, up, 24.0, 34.0 if lies else 14.0)


def _nearest_axis(direction: Floats) -> Floats:
    k = int(np.argmax(np.abs(direction)))
    axis: Floats = np.eye(3)[k] * np.sign(direction[k])
    return axis


# Lighting

Image = NDArray[np.uint8]
Colour = tuple[int, int, int]

WHITE, CLAY, INSIDE = (255, 255, 255), (196, 190, 182), (122, 138, 160)
"""Colours, (red, green, blue) in 0 to 255: of the background, of the outer side of a surface, and
of its inner side, which is visible in open scans."""

_LAMPS = (
    ((-0.56, 0.60, 0.57), 1.00, 0.20),
    ((0.85, -0.05, 0.45), 0.26, 0.40),
    ((0.10, -0.90, 0.30), 0.14, 0.50),
)
# Ambient light, light at edges, gloss, its sharpness; then the lamps, each with the direction
# towards it (right, up, towards the eye), its strength, and how far it wraps around the surface.
_LIGHTS = {
    "clay": ((0.12, 0.14, 0.08, 24.0), _LAMPS),
    # Colours that stand for numbers keep their tone: more ambient light, no gloss.
    "map": ((0.56, 0.0, 0.0, 1.0), (((-0.55, 0.58, 0.60), 0.58, 0.30),)),
    # Colours of the file are lit like clay, with less gloss and more ambient light, because they
    # may be dark.
    "paint": (
        (0.24, 0.05, 0.02, 24.0),
        tuple((towards, 0.72 * strength, reach) for towards, strength, reach in _LAMPS),
    ),
}

CREASE_DEG = 80.0

SAMPLES = 2  # samples along each side of a pixel

_HOLLOWS = ((0.008, 0.32), (0.022, 0.45), (0.055, 0.45))
"""Radii for ambient occlusion, in picture sides, and how much each one darkens."""

_UNNOTICED = 0.03
"""Share of the radius by which occluders are ignored: the facets of a round wall differ so much."""

_DIRECTIONS = 8  # lines through a pixel along which occluders are sampled


def shade(
    vertices: Floats,
    faces: Ints,
    camera: Camera,
    width: int,
    height: int,
    colours: Image | None = None,
    *,
    background: Colour = WHITE,
    crease_deg: float = CREASE_DEG,
    colours_are: str = "map",
) -> Image:
    """(height, width, 3) uint8: the mesh as the camera sees it.

    Parameters
    ----------
    vertices : (n, 3) in any unit; ``faces`` : (m, 3) integers, counter-clockwise from outside.
    camera : the viewpoint; it shows all that it was made for at any ``width`` and ``height``.
    colours : (n, 3) uint8, one per vertex; None for clay, with the insides in another tone.
    crease_deg : edges with a larger angle stay sharp, below half of it they are smooth; 0 shows
        each face flat.
    colours_are : ``map`` for colours that stand for numbers and keep their tone, ``paint`` for the
        object's own, which get more light and shadow.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int32)
    clay, inside = (np.array(colour, dtype=np.float32) for colour in (CLAY, INSIDE))
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
    # The colour, 0 to 255, times the share of each pixel that shows the mesh, and that share.
    lit, covered = sums[..., :3], sums[..., 3]
    open_sky = _open_sky(depth / np.float32(SAMPLES), covered)
    if colours_are == "map":
        open_sky = 0.5 + 0.5 * open_sky
    behind = np.array(background, dtype=np.float32) * (1.0 - covered[..., None])
    image = np.rint(lit * open_sky[..., None] + behind)
    result: Image = image.clip(0, 255).astype(np.uint8)
    return result


def _is_inside_out(vertices: Floats, faces: Ints) -> bool:
    """Whether a closed surface is wound so that all of its normals point inwards."""
    normals, areas = face_normals_and_areas(vertices, faces)
    total = float(areas.sum())
    # The normals of a closed surface, weighted by area, add up to zero.
    if np.linalg.norm(areas @ normals) > 0.01 * total:
        return False
    return area_and_volume(vertices - vertices.mean(axis=0), faces)[1] < 0.0


def _open_sky(depth: Floats32, covered: Floats32) -> Floats32:
    """Ambient occlusion (h, w), 0 to 1: 1 where nothing around a pixel is in front of it.

    ``depth`` is the nearness to the eye in pixels, 0 for the background.  The mean of two points on
    opposite sides of a pixel is in front of it in a hollow and beside a wall, but not on a plane of
    any slope.  If one of them is background, that direction counts as open.
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
        # Without blurring, the few lines would leave copies of every outline.
        soft = max(1, radius // 4)
        seen = np.maximum(_blur(inside, soft), np.float32(1e-6))
        share = _blur(hidden, soft) * inside / seen
        share *= np.float32(1.0 / (_DIRECTIONS * radius))
        open_sky *= np.float32(1.0) - np.float32(strength) * share ** np.float32(0.75)
    return open_sky


def _blur(image: Floats32, radius: int) -> Floats32:
    """The mean over squares of ``2 radius + 1`` pixels, with zeros beyond the border."""
    side = 2 * radius + 1
    height, width = image.shape
    sums = np.cumsum(np.pad(image, ((radius + 1, radius), (0, 0))), axis=0, dtype=np.float64)
    rows = sums[side:] - sums[:height]
    sums = np.cumsum(np.pad(rows, ((0, 0), (radius + 1, radius))), axis=1)
    blurred: Floats32 = ((sums[:, side:] - sums[:, :width]) / side**2).astype(np.float32)
    return blurred
