"""Clean shapes that training never uses, for benchmarks of noise: parts, organic shapes, relief.

They are made by the tools of ``training/`` from recipes and seeds of their own.  All have edges of
mean length 1 and 4,000 to 12,000 vertices.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from msal_cli.mesh import Mesh, prepare_mesh
from training import relief
from training.connectivity import Floats
from training.organic import FieldSurface, capsule_distance, polygonise, smooth_union
from training.shapes import scale_to_unit_edges
from training.solids import to_labelled_mesh
from training.surface import LabelledMesh, PolyhedralSurface
from training.triangulations import make_adaptive, make_decimated, make_graded, make_isotropic

SEED = 20261
"""Training takes other seeds; the recipes differ anyway."""

Triangulate = Callable[..., LabelledMesh]


def unseen_shapes() -> dict[str, Callable[[], Mesh]]:
    """What makes each shape, by name: about two seconds each."""
    return {
        "joint": lambda: _solid(make_joint(), make_isotropic, 7500, 1),
        "carter": lambda: _solid(make_carter(), make_isotropic, 8000, 2),
        "cam": lambda: _solid(make_cam(), make_graded, 5000, 3),
        "ratchet": lambda: _solid(make_ratchet(), make_adaptive, 5500, 4),
        "bumpy_torus": lambda: _organic(_bumpy_torus, make_isotropic, 8000, 5),
        "gargoyle": lambda: _with_relief(_gargoyle, 8500, 6),
        "vase": lambda: _organic(_vase, make_decimated, 7000, 7),
        "paw": lambda: _organic(_paw, make_isotropic, 8000, 8),
    }


def _ready(mesh: LabelledMesh) -> Mesh:
    scaled = scale_to_unit_edges(mesh)
    return prepare_mesh(scaled.vertices, scaled.faces.astype(np.int32)).mesh


def _generator(number: int) -> np.random.Generator:
    return np.random.default_rng([SEED, number])


def _solid(solid: Manifold, triangulate: Triangulate, count: int, number: int) -> Mesh:
    start = to_labelled_mesh(solid)
    return _ready(triangulate(start, PolyhedralSurface(start), count, _generator(number)))


def _sample(field: Callable[[Floats], Floats], count: int) -> tuple[LabelledMesh, FieldSurface]:
    return polygonise(field, 1.6, int(np.sqrt(count / 2.2))), FieldSurface(field, 0.03)


def _organic(
    field: Callable[[Floats], Floats], triangulate: Triangulate, count: int, number: int
) -> Mesh:
    start, surface = _sample(field, count)
    return _ready(triangulate(start, surface, count, _generator(number)))


def _with_relief(field: Callable[[Floats], Floats], count: int, number: int) -> Mesh:
    """Skin of two wavelengths on an organic shape."""
    start, surface = _sample(field, count)
    generator = _generator(number)
    mesh = scale_to_unit_edges(make_isotropic(start, surface, count, generator))
    mesh = relief.apply_relief(mesh, relief.make_cobbles, 11.0, 0.8, generator)
    return _ready(relief.apply_relief(mesh, relief.make_rough, 3.5, 0.4, generator))


def _rod(radius: float, height: float) -> Manifold:
    return Manifold.cylinder(height, radius, -1.0, int(128 * np.sqrt(radius)) + 32, True)


def make_joint() -> Manifold:
    """A universal joint's yoke: two cheeks with bores on a round flange with a splined hole."""
    fork = Manifold.cube((1.6, 1.1, 1.5), True).translate((0, 0, 0.5))
    fork ^= _rod(0.55, 3.0).rotate((0, 90, 0)).translate((0, 0, 0.7)) + Manifold.cube(
        (3.0, 1.1, 1.0), True
    ).translate((0, 0, 0.2))
    fork -= Manifold.cube((0.8, 2.0, 2.0), True).translate((0, 0, 1.05))
    fork -= _rod(0.28, 4.0).rotate((0, 90, 0)).translate((0, 0, 0.7))
    base = _rod(0.95, 0.4).translate((0, 0, -0.4))
    for turn in (45, 135, 225, 315):
        base -= _rod(0.1, 2.0).translate((0.75, 0, 0)).rotate((0, 0, turn))
    hole = _rod(0.3, 4.0)
    for k in range(8):
        hole += Manifold.cube((0.14, 0.1, 4.0), True).translate((0.31, 0, 0)).rotate((0, 0, 45 * k))
    return fork + base - hole.translate((0, 0, -1.9))


def make_carter() -> Manifold:
    """A gear case: a hollow body of two drums, with bearing seats, a rim and drilled feet."""
    drums = [CrossSection.circle(0.8, 128).translate((-0.5, 0))]
    drums.append(CrossSection.circle(0.55, 96).translate((0.7, 0)))
    outline = CrossSection.batch_hull(drums)
    inner = outline.offset(-0.14, JoinType.Round, 2.0, 128)
    outer = outline.offset(0.14, JoinType.Round, 2.0, 128)
    body = outline.extrude(0.95) + outer.extrude(0.14).translate((0, 0, 0.86))
    for x in (-0.9, 0.9):
        foot = Manifold.cube((0.4, 0.9, 0.5), True).translate((x, -0.5, 0.35))
        body += foot - _rod(0.09, 2.0).rotate((90, 0, 0)).translate((x, -0.8, 0.35))
    for x, radius in ((-0.5, 0.34), (0.7, 0.24)):
        body += _rod(radius + 0.1, 0.4).translate((x, 0, -0.1))
    body -= inner.extrude(2.0).translate((0, 0, 0.16))
    for x, radius in ((-0.5, 0.34), (0.7, 0.24)):
        body -= _rod(radius, 2.0).translate((x, 0, 0.0))
    return max(body.decompose(), key=lambda piece: piece.volume())


def make_cam() -> Manifold:
    """An eccentric with a rounded lobe, a conical collar and a D-shaped bore."""
    lobe = CrossSection.batch_hull(
        [CrossSection.circle(0.8, 160), CrossSection.circle(0.3, 96).translate((1.0, 0))]
    )
    collar = Manifold.cylinder(0.5, 0.6, 0.4, 128).translate((0, 0, 0.5))
    bore = _rod(0.26, 4.0) - Manifold.cube((0.3, 2.0, 4.0), True).translate((0.35, 0, 0))
    pocket = _rod(0.16, 0.3).translate((0.9, 0, 0.5))
    return lobe.extrude(0.5) + collar - bore - pocket


def make_ratchet() -> Manifold:
    """A wheel with saw teeth, a square hole and a round recess on each side."""
    turn = 2.0 * np.pi * np.arange(18) / 18
    points = []
    for angle in turn:
        for radius, shift in ((1.2, 0.0), (1.5, 0.06)):
            points.append((radius * np.cos(angle + shift), radius * np.sin(angle + shift)))
    wheel = CrossSection([np.array(points)]).extrude(0.5).translate((0, 0, -0.25))
    ring = _rod(1.0, 0.3) - _rod(0.5, 0.4)
    wheel -= ring.translate((0, 0, 0.25)) + ring.translate((0, 0, -0.25))
    return wheel - Manifold.cube((0.5, 0.5, 2.0), True).rotate((0, 0, 20))


def _bumpy_torus(points: Floats) -> Floats:
    """A torus with round bumps all over: a product of waves in its two angles."""
    x, y, z = points.T
    ring = np.hypot(x, y)
    turn, roll = np.arctan2(y, x), np.arctan2(z, ring - 0.85)
    tube = np.hypot(ring - 0.85, z)
    fade = np.minimum(1.0, (tube / 0.2) ** 2)
    result: Floats = tube - 0.36 - 0.045 * fade * np.sin(16 * turn) * np.sin(7 * roll)
    return result


def _limbs(points: Floats, bones: list[tuple[list[float], float, float, float]]) -> Floats:
    """Limbs (start and end as six numbers, two radii, width of the blend), joined."""
    total = np.full(len(points), 10.0)
    for ends, first, last, width in bones:
        limb = capsule_distance(points, np.array(ends[:3]), np.array(ends[3:]), first, last)
        total = smooth_union(total, limb, width)
    return total


def _gargoyle(points: Floats) -> Floats:
    """A crouching figure with wings, horns and a base."""
    mirrored = points * [1.0, 1.0, 1.0]
    mirrored[:, 0] = np.abs(mirrored[:, 0])
    body = _limbs(
        mirrored,
        [
            ([0.0, 0.1, -0.35, 0.0, 0.0, 0.25], 0.4, 0.32, 0.1),
            ([0.0, -0.15, 0.6, 0.0, -0.3, 0.55], 0.27, 0.16, 0.1),
            ([0.1, -0.05, 0.75, 0.3, 0.05, 1.05], 0.09, 0.03, 0.04),
            ([0.25, -0.1, -0.4, 0.5, -0.45, -0.2], 0.22, 0.17, 0.08),
            ([0.5, -0.45, -0.2, 0.42, -0.4, -0.75], 0.15, 0.1, 0.04),
            ([0.3, 0.0, 0.3, 0.55, -0.4, -0.05], 0.15, 0.1, 0.06),
        ],
    )
    x, y, z = mirrored.T
    # Each wing: an ellipsoid, flat along its own normal.
    across = 0.5 * (x - 0.65) - 0.85 * (y - 0.35)
    along = 0.85 * (x - 0.65) + 0.5 * (y - 0.35)
    wing = (np.sqrt((along / 0.5) ** 2 + ((z - 0.35) / 0.7) ** 2 + (across / 0.1) ** 2) - 1) * 0.1
    base = np.sqrt(mirrored[:, 0] ** 2 + y**2 + 8.0 * (z + 0.9) ** 2) - 0.75
    return smooth_union(smooth_union(body, wing, 0.06), 0.6 * base, 0.05)


def _vase(points: Floats) -> Floats:
    """A hollow pot with a lip, a foot and flutes around its belly."""
    x, y, z = points.T
    radius, turn = np.hypot(x, y), np.arctan2(y, x)
    belly = 0.45 + 0.3 * np.cos(1.7 * z) - 0.12 * np.exp(-(((z - 0.75) / 0.2) ** 2))
    flutes = 0.025 * np.cos(14 * turn) * np.exp(-((z / 0.45) ** 2))
    wall = np.abs(radius - belly - flutes) - 0.07
    inside = -smooth_union(-wall, 1.0 - np.abs(z), 0.1)
    floor = np.maximum(radius - belly - 0.03, np.abs(z + 0.93) - 0.09)
    return smooth_union(inside, floor, 0.1)


def _paw(points: Floats) -> Floats:
    """A paw with pads and claws: creases between neighbours."""
    bones = [([0.0, 0.9, 0.1, 0.0, 0.2, 0.0], 0.3, 0.42, 0.1)]
    for k, x in enumerate((-0.55, -0.2, 0.2, 0.55)):
        reach = -0.45 - 0.12 * (k in (1, 2))
        bones.append(([0.6 * x, 0.1, 0.0, x, reach, -0.05], 0.24, 0.18, 0.04))
        bones.append(([x, reach - 0.1, 0.02, 1.1 * x, reach - 0.4, -0.12], 0.09, 0.03, 0.02))
        bones.append(([x, reach + 0.05, -0.2, x, reach + 0.15, -0.2], 0.11, 0.1, 0.03))
    bones.append(([-0.12, 0.15, -0.4, 0.12, 0.15, -0.4], 0.2, 0.2, 0.05))
    return _limbs(points, bones)
