"""Where a picture is taken from: parallel projection, one direction for all panels."""

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Floats, Ints

MARGIN = 0.04
"""Share of the picture's width and height that stays free on each side."""

_MAX_GUESS_FACES = 60_000
"""Faces that a guess about up and front looks at."""


@dataclass(frozen=True, eq=False)
class Camera:
    """A parallel projection and what it shows."""

    # (3, 3), rows: right, up and towards the eye, unit vectors in the mesh's coordinates
    axes: Floats
    centre: Floats  # (3,) the point in the middle of the picture
    half_width: float  # half_width, half_height: of what must be seen, in the mesh's unit
    half_height: float

    def seen(self, vertices: Floats) -> Floats:
        """(n, 3): right, up and towards the eye from the centre, in the mesh's unit."""
        return np.ascontiguousarray((vertices - self.centre) @ self.axes.T)

    def pixels_per_unit(self, width: int, height: int) -> float:
        """The scale at which all that must be seen fits, with a margin."""
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
"""Degrees round to the right and up from the front."""


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
    """The camera for a word, framing all vertices that have a face.

    Parameters
    ----------
    vertices : (n, 3); ``faces`` : (m, 3), at least one.
    view : one of ``_ANGLES``, about the up and the front that the mesh seems to have; or ``auto``,
        which looks at solids from the front, a little from the right and from above, and straight
        at scans of one side and at reliefs.
    turn_deg : more goes round to the mesh's right; None is 0, or what ``auto`` chose.
    tilt_deg : more goes up; None likewise.
    up : an axis with its sign, such as ``-y``, where the guess is wrong.
    also : (k, 3) other points to be shown, such as the same mesh before.
    """
    stance = _with_up(_stance(vertices, faces), up)
    if view == "auto":
        # What is given replaces the guess; it is added to a named view.
        turn = stance.turn_deg if turn_deg is None else turn_deg
        tilt = stance.tilt_deg if tilt_deg is None else tilt_deg
    else:
        turn, tilt = _ANGLES[view]
        turn, tilt = turn + (turn_deg or 0.0), tilt + (tilt_deg or 0.0)
    is_used = np.zeros(len(vertices), dtype=bool)
    is_used[faces.reshape(-1)] = True
    points = vertices[is_used]
    if also is not None:
        points = np.concatenate([points, also])
    return frame_vertices(rotate(stance.front, stance.up, turn, tilt), points)


def rotate(front: Floats, up: Floats, turn_deg: float, tilt_deg: float) -> Floats:
    """(3, 3) axes of an eye that went round and up from ``front``; straight above it still knows
    where the front is, which is at the bottom of its picture."""
    forward, right, upward = _frame(front, up)
    turn, tilt = np.radians([turn_deg, tilt_deg])
    ahead = np.cos(turn) * forward + np.sin(turn) * right
    towards = np.cos(tilt) * ahead + np.sin(tilt) * upward
    higher = np.cos(tilt) * upward - np.sin(tilt) * ahead
    return np.stack([np.cross(higher, towards), higher, towards])


def _frame(front: Floats, up: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit vectors forward, to the right of who looks at it, and up; front and right are level."""
    upward = up / np.linalg.norm(up)
    forward = front - (front @ upward) * upward
    forward = forward / np.linalg.norm(forward)
    return forward, np.cross(upward, forward), upward


@dataclass(frozen=True, eq=False)
class _Stance:
    """The guessed pose of a mesh: (3,) directions, and the turn and tilt to look at it from."""

    front: Floats
    up: Floats
    turn_deg: float = 0.0
    tilt_deg: float = 0.0


_ONE_SIDED = 0.2
"""Length of the mean normal above which a surface is a scan of one side; 0 if it is closed."""

_RELIEF = 0.3
"""Least over middle extent along the principal axes, below which a solid is a plaque or a coin."""

_STANDS = 0.015
"""Share of the area at one end of an axis, beyond that at the other end, that makes it the base."""

_STANDS_ON_HEAD = 0.1
"""The same where the base would be what the file has on top, such as a cut-off head."""

_LIES = 0.62
"""Height over breadth below which a thing lies flat and is looked at from higher up."""

_X, _Y, _Z = np.eye(3)


def _stance(vertices: Floats, faces: Ints) -> _Stance:
    """Up, front and view of a mesh at a guess.

    Files have y or z upwards, few have neither.  A mesh with a base is shown on it; a flat one
    lies on its broad side; the rest is upright.  With y upwards the front is +z, with z upwards -y,
    as modellers and scanners do it, but things far longer that way are shown from their long side.
    """
    # Some of the faces suffice.
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
    """The stance with the axis that ``word`` names upwards, and its front if that is level then."""
    if word == "auto":
        return stance
    axis = np.eye(3)["xyz".index(word[-1])]
    up = -axis if word.startswith("-") else axis
    front = stance.front
    if abs(front @ up) > 0.9 * np.linalg.norm(front):
        # What was thought to be upwards now looks at the eye.
        front = stance.up if stance.up @ up == 0.0 else -_Y
    return _Stance(front, up, stance.turn_deg, stance.tilt_deg)


def _one_sided(facing: Floats) -> _Stance:
    """A scan of one side is looked at from where it looks."""
    # A head from above is still no picture of something that lies on its back.
    is_upward = abs(facing[1]) > abs(facing[2]) + 0.5 * np.linalg.norm(facing)
    nearest = _nearest_axis(facing)
    up = _Z if is_upward or nearest[0] else _Y
    if nearest[2] < 0.0:
        # Depth cameras look along z with y downwards, so that what they see faces -z.
        up = -_Y
    front, _, _ = _frame(facing, up)
    axis = _nearest_axis(front)
    level = front @ axis
    return _Stance(axis if level > np.cos(np.radians(30.0)) else front, up)


def _relief(thin: Floats, doubled: Floats, areas: Floats) -> _Stance:
    """A plaque is looked at from the side that has more to show."""
    lean = doubled @ thin / np.maximum(areas, 1e-300)
    shown = [float((areas * (1.0 - lean**2))[sign * lean > 0.2].sum()) for sign in (1.0, -1.0)]
    front = thin if shown[0] >= shown[1] else -thin
    axis = _nearest_axis(front)
    front = axis if front @ axis > np.cos(np.radians(15.0)) else front
    # Up is y, but z for what faces along y, or along x.
    up = _Y if abs(front[2]) >= max(abs(front[0]), abs(front[1])) else _Z
    return _Stance(front, up)


def _solid(centres: Floats, areas: Floats) -> _Stance:
    """Anything else is looked at from the front right, from above the more the flatter it is."""
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
