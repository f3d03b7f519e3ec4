"""Organic shapes as the zero level of smooth fields: blobs, limbs, tori and creased unions.

A field is negative inside.  Points come back to its zero level by Newton's method along its
gradient, so that vertices of marching cubes lie on the true surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skimage import measure

from training.connectivity import Floats, Ints, drop_unused
from training.surface import LabelledMesh

Generator = np.random.Generator
Field = Callable[[Floats], Floats]

COARSE_CELLS = 32
"""Cells along each side of the grid that tells where the surface is."""


class FieldSurface:
    """The zero level of a field as the true surface; it has no curves."""

    def __init__(self, field: Field, reach: float) -> None:
        self._field = field
        self._reach = reach

    def project(self, points: Floats, labels: Ints) -> Floats:
        """Points (n, 3) on the zero level; none moves by more than ``reach``."""
        del labels
        result = points.copy()
        for _ in range(2):
            gradient = field_gradient(self._field, result, 1e-4 * self._reach)
            squared = np.maximum(np.einsum("ij,ij->i", gradient, gradient), 1e-12)
            for _ in range(2):
                step = -(self._field(result) / squared)[:, None] * gradient
                length = np.linalg.norm(step, axis=1, keepdims=True)
                result += step * np.minimum(1.0, self._reach / np.maximum(length, 1e-300))
        return result

    def project_to_curves(self, points: Floats, pairs: Ints) -> Floats:
        """Points (n, 3) of boundaries, which nothing but the surface holds."""
        return self.project(points, pairs)


def field_gradient(field: Field, points: Floats, step: float) -> Floats:
    """Gradients (n, 3) by differences to the corners of a tetrahedron."""
    total = np.zeros_like(points)
    for corner in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        direction = np.array(corner, dtype=np.float64)
        total += field(points + step * direction)[:, None] * direction
    return total / (4.0 * step)


def polygonise(field: Field, half_size: float, cells: int) -> LabelledMesh:
    """The largest piece of a field's zero level by marching cubes, projected onto it."""
    step = 2.0 * half_size / cells
    values = _sample_field(field, half_size, cells)
    # A value of zero at a grid point would make faces without area.
    values[np.abs(values) < 1e-9] = 1e-9
    # Any hides that it has no types.
    marching_cubes: Any = measure.marching_cubes
    points, faces, _, _ = marching_cubes(values, 0.0, spacing=(step,) * 3)
    vertices = points.astype(np.float64) - half_size
    faces = _keep_largest(faces.astype(np.int64), len(vertices))
    if _signed_volume(vertices, faces) < 0.0:
        faces = faces[:, ::-1]
    vertices, faces, _ = drop_unused(vertices, faces)
    labels = np.zeros(len(faces), dtype=np.int64)
    vertices = FieldSurface(field, 0.5 * step).project(vertices, np.zeros(len(vertices), np.int64))
    return LabelledMesh(vertices, faces, labels)


def _sample_field(field: Field, half_size: float, cells: int) -> Floats:
    """Values on a grid; far from the zero level they are interpolated in a coarse one."""
    coarse = _grid_points(half_size, COARSE_CELLS)
    rough = field(coarse).reshape((COARSE_CELLS + 1,) * 3)
    if cells <= COARSE_CELLS:
        return field(_grid_points(half_size, cells)).reshape((cells + 1,) * 3)
    place = np.arange(cells + 1) * (COARSE_CELLS / cells)
    places = np.stack(np.meshgrid(place, place, place, indexing="ij"))
    values: Floats = map_coordinates(rough, places, order=1, mode="nearest").reshape(-1)
    near = np.abs(values) < 3.0 * 2.0 * half_size / COARSE_CELLS
    values[near] = field(_grid_points(half_size, cells)[near])
    return values.reshape((cells + 1,) * 3)


def _grid_points(half_size: float, cells: int) -> Floats:
    axis = np.linspace(-half_size, half_size, cells + 1)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _keep_largest(faces: Ints, count: int) -> Ints:
    rows = np.concatenate([faces[:, 0], faces[:, 1]])
    columns = np.concatenate([faces[:, 1], faces[:, 2]])
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    kept: Ints = faces[piece == np.bincount(piece).argmax()]
    return kept


def _signed_volume(vertices: Floats, faces: Ints) -> float:
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def smooth_union(first: Floats, second: Floats, width: float) -> Floats:
    """The union of two distances, blended over ``width``; 0 leaves a crease."""
    if width == 0.0:
        return np.minimum(first, second)
    share = np.maximum(width - np.abs(first - second), 0.0) / width
    return np.minimum(first, second) - 0.25 * width * share * share


def capsule_distance(points: Floats, start: Floats, end: Floats, r0: float, r1: float) -> Floats:
    """Distances (n,) to a limb whose radius goes from r0 at ``start`` to r1 at ``end``."""
    along = end - start
    share = np.clip((points - start) @ along / float(along @ along), 0.0, 1.0)
    gap: Floats = np.linalg.norm(points - start - share[:, None] * along, axis=1)
    return gap - (r0 + share * (r1 - r0))


def draw_waves(g: Generator, wavelength: float, count: int = 24) -> Field:
    """Isotropic noise of one wavelength, root mean square 1: a sum of plane waves."""
    direction = g.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    frequency = 2.0 * np.pi / (wavelength * g.uniform(0.8, 1.25, (count, 1)))
    waves, phase = (direction * frequency).T, g.uniform(0.0, 2.0 * np.pi, count)

    def field(points: Floats) -> Floats:
        total: Floats = np.cos(points @ waves + phase).sum(axis=1)
        return total * np.sqrt(2.0 / count)

    return field


def make_metaballs(g: Generator) -> Field:
    """A level of a sum of Gaussians."""
    centres = g.normal(size=(int(g.integers(6, 12)), 3)) * 0.42
    widths = g.uniform(0.28, 0.5, len(centres))

    def field(points: Floats) -> Floats:
        total = np.zeros(len(points))
        for centre, width in zip(centres, widths, strict=True):
            total += np.exp(-((points - centre) ** 2).sum(axis=1) / (width * width))
        # The logarithm has the slope of a distance.
        return -0.25 * np.log(np.maximum(total, 1e-30) / 0.6)

    return field


def make_bumpy_ball(g: Generator) -> Field:
    """A ball deformed by noise of two wavelengths, as a stone is."""
    broad, fine = draw_waves(g, 1.4), draw_waves(g, 0.5)
    squash = g.uniform(0.8, 1.2, 3)

    def field(points: Floats) -> Floats:
        radius = np.linalg.norm(points * squash, axis=1)
        return radius - 0.9 - 0.10 * broad(points) - 0.025 * fine(points)

    return field


def make_knot(g: Generator) -> Field:
    """A tube along a closed curve on a torus, of a width that varies."""
    p, q = (2, 3) if g.integers(2) else (3, 2)
    t = np.linspace(0.0, 2.0 * np.pi, 600, endpoint=False)
    ring = 0.65 + 0.28 * np.cos(q * t)
    curve = np.stack([ring * np.cos(p * t), ring * np.sin(p * t), 0.35 * np.sin(q * t)], axis=1)
    return _tube_field(curve, 0.15 + 0.02 * np.sin(5 * t + g.uniform(0, 6)))


def _tube_field(curve: Floats, radii: Floats) -> Field:
    """A tube of radii (k,) along a curve (k, 3), without facets."""
    tree = cKDTree(curve)

    def field(points: Floats) -> Floats:
        gap, near = tree.query(points, k=6)
        weight = np.exp(-((gap - gap[:, :1]) / 0.02))
        weight /= weight.sum(axis=1, keepdims=True)
        return ((gap - radii[near]) * weight).sum(axis=1)

    return field


def make_torus(g: Generator) -> Field:
    """A torus with waves around its tube, or two of them in one another."""
    minor, lobes = g.uniform(0.22, 0.32), int(g.integers(3, 8))
    depth = g.uniform(0.02, 0.05)

    def field(points: Floats) -> Floats:
        x, y, z = points.T
        turn = np.arctan2(y, x)
        tube = np.hypot(np.hypot(x, y) - 0.75, z)
        roll = np.arctan2(z, np.hypot(x, y) - 0.75)
        # The waves fade in the middle of the tube, where its angle is not defined.
        fade = np.minimum(1.0, (tube / (0.5 * minor)) ** 2)
        return tube - minor - fade * depth * np.cos(lobes * turn + 2.0 * roll)

    return field


def make_figure(g: Generator) -> Field:
    """A body with head, limbs and fingers, joined smoothly, and creases where the limbs begin."""
    crease = float(g.choice([0.02, 0.08, 0.2]))
    limbs: list[tuple[Sequence[float], Sequence[float], float, float]]
    limbs = [((0, 0, -0.25), (0, 0, 0.3), 0.33, 0.28), ((0, 0, 0.3), (0, 0.05, 0.7), 0.16, 0.24)]
    for side in (-1.0, 1.0):
        knee = (side * g.uniform(0.2, 0.4), g.uniform(-0.3, 0.2), -0.65)
        limbs += [((side * 0.16, 0, -0.35), knee, 0.2, 0.14)]
        limbs += [(knee, (knee[0] * 1.1, knee[1] + 0.15, -1.0), 0.14, 0.1)]
        hand = np.array([side * g.uniform(0.75, 0.95), g.uniform(-0.3, 0.3), g.uniform(0.1, 0.6)])
        limbs += [((side * 0.25, 0, 0.3), tuple(hand), 0.15, 0.09)]
        for k in range(3):
            tip = hand + np.array([side * 0.16, 0.12 * (k - 1), 0.08 * (k - 1)])
            limbs += [(tuple(hand), tuple(tip), 0.06, 0.04)]
    bones = [(np.array(a, float), np.array(b, float), r, s) for a, b, r, s in limbs]

    def field(points: Floats) -> Floats:
        total = capsule_distance(points, *bones[0])
        for bone in bones[1:]:
            total = smooth_union(total, capsule_distance(points, *bone), crease)
        return total

    return field


def make_branches(g: Generator) -> Field:
    """A stem with branches, as corals and roots have."""
    bones = []
    tips = [(np.array([0.0, 0.0, -0.9]), np.array([0.0, 0.0, 1.0]), 0.2)]
    for _ in range(3):
        grown = []
        for start, heading, radius in tips:
            end = start + heading * g.uniform(0.5, 0.65)
            bones.append((start, end, radius, 0.75 * radius))
            for _ in range(2):
                turned = heading + 0.75 * g.normal(size=3)
                grown.append((end, turned / np.linalg.norm(turned), 0.75 * radius))
        tips = grown

    def field(points: Floats) -> Floats:
        total = capsule_distance(points, *bones[0])
        for bone in bones[1:]:
            total = smooth_union(total, capsule_distance(points, *bone), 0.12)
        return total

    return field


def make_head(g: Generator) -> Field:
    """A head: brows, nose, eyes, lips and ears of balls, some joined with a narrow blend."""
    parts: list[tuple[Sequence[float], float, float]]
    parts = [((0, 0, 0.1), 0.62, 0.2), ((0, 0.18, -0.28), 0.42, 0.2), ((0, 0.62, -0.02), 0.11, 0.1)]
    parts += [((0, 0.58, 0.1), 0.07, 0.12), ((0, 0.55, -0.33), 0.1, 0.04)]
    for side in (-1.0, 1.0):
        parts += [((side * 0.21, 0.5, 0.13), 0.1, 0.02), ((side * 0.2, 0.52, 0.28), 0.09, 0.12)]
        parts += [((side * 0.62, 0.0, 0.05), g.uniform(0.1, 0.16), 0.03)]
        parts += [((side * 0.28, 0.44, -0.15), 0.16, 0.2)]
    balls = [(np.array(c, float), r * g.uniform(0.9, 1.1), w) for c, r, w in parts]

    def field(points: Floats) -> Floats:
        total = np.linalg.norm(points - balls[0][0], axis=1) - balls[0][1]
        for centre, radius, width in balls[1:]:
            ball = np.linalg.norm(points - centre, axis=1) - radius
            total = smooth_union(total, ball, width)
        return total

    return field


def make_gyroid(g: Generator) -> Field:
    """A wall of a gyroid within a ball: sheets that turn everywhere, with round rims."""
    cells, wall = g.uniform(1.6, 2.0), g.uniform(0.6, 0.8)
    phase = g.uniform(0, 6, 3)

    def field(points: Floats) -> Floats:
        x, y, z = (points * np.pi * cells / 1.4 + phase).T
        level = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
        sheet = (np.sqrt(level * level + 0.01) - wall) / (np.pi * cells)
        ball = np.linalg.norm(points, axis=1) - 1.0
        return -smooth_union(-sheet, -ball, 0.2)

    return field


def make_shell(g: Generator) -> Field:
    """A horn: a tube that grows along a spiral, whose turns come near each other."""
    t = np.linspace(0.0, 1.0, 800)
    scale = np.exp(2.2 * (t - 1.0))
    turn = 2.0 * np.pi * g.uniform(2.2, 2.8) * t
    ring, rise = 0.6 * scale, 1.0 - 1.7 * scale
    centres = np.stack([ring * np.cos(turn), ring * np.sin(turn), 0.3 + rise * 0.6], axis=1)
    return _tube_field(centres, 0.27 * scale)
