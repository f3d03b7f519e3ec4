"""Relief and texture: heights over a surface, of a wavelength in mean edge lengths.

A maker draws a ``Relief`` from the generator, the mesh's vertices and normals, and a wavelength.
Heights are about 1 from the deepest to the highest; ``apply_relief`` scales them.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.spatial import cKDTree

from training.connectivity import Floats, build_edges, to_unit, vertex_normals
from training.organic import draw_waves
from training.surface import LabelledMesh, face_labels

Generator = np.random.Generator
Relief = Callable[[Generator, Floats, Floats, float], Floats]
"""Heights (n,) from a generator, vertices (n, 3), their normals, and a wavelength."""

STROKES = {
    "A": "00 12 24 / 12 42 / 21 31",
    "E": "40 00 04 44 / 02 32",
    "H": "00 04 / 40 44 / 02 42",
    "K": "00 04 / 44 02 40",
    "M": "00 04 22 44 40",
    "N": "00 04 40 44",
    "R": "00 04 34 43 32 02 / 22 40",
    "S": "00 30 41 32 12 03 14 44",
    "T": "04 44 / 24 20",
    "X": "00 44 / 04 40",
    "Z": "04 44 00 40",
    "3": "04 44 22 41 30 00",
    "7": "04 44 20",
    "8": "10 01 33 34 14 13 41 30 10",
}
"""Letters as broken lines on a grid of 5 by 5; a slash lifts the pen."""


def make_orange_peel(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Noise of about one wavelength, as paint and castings have."""
    del normals
    return 0.35 * draw_waves(g, wavelength, 40)(points)


def make_rough(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Noise of four octaves down to the wavelength, as stone and bark have."""
    del normals
    total = np.zeros(len(points))
    for octave in range(4):
        total += 0.12 * 2.0 ** (0.8 * octave) * draw_waves(g, wavelength * 2.0**octave)(points)
    return 0.5 * total


def make_hair(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Sharp ridges side by side along a direction that turns, as manes and fur have."""
    del normals
    direction = to_unit(g.normal(size=(1, 3)))[0]
    bend = draw_waves(g, 9.0 * wavelength)(points) * 1.2
    phase = points @ direction / wavelength + bend
    strand = 1.0 - np.abs(2.0 * (phase - np.floor(phase)) - 1.0)
    share = 0.5 + 0.5 * np.tanh(2.0 * draw_waves(g, 12.0 * wavelength)(points))
    return strand * share


def make_dents(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Round dents side by side with sharp ridges between, as hammered metal has."""
    del normals
    gap, _ = _nearest_seeds(g, points, wavelength, 1)
    return np.minimum((gap[:, 0] / (0.7 * wavelength)) ** 2, 1.5)


def make_pits(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Single round dents and bumps, smooth, with clean surface between."""
    del normals
    gap, near = _nearest_seeds(g, points, 2.0 * wavelength, 1)
    sign = np.where(g.random(len(points)) < 0.5, -1.0, 1.0)[near[:, 0]]
    return 0.7 * sign * np.exp(-((gap[:, 0] / (0.45 * wavelength)) ** 2))


def make_scales(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Overlapping plates: each rises along one direction and ends in a step."""
    del normals
    gap, near = _nearest_seeds(g, points, wavelength, 2)
    direction = to_unit(g.normal(size=(1, 3)))[0]
    rise = (points[:, None] - points[near]) @ direction / (1.6 * wavelength)
    # The step goes over two edges: a sharper one would be ragged.
    share = 0.5 + 0.5 * np.tanh((gap[:, 1] - gap[:, 0]) / 1.2)
    return rise[:, 0] * share + rise[:, 1] * (1.0 - share)


def make_cobbles(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Flat stones with grooves between, as reptile skin and paving have."""
    del normals
    gap, _ = _nearest_seeds(g, points, wavelength, 2)
    return np.minimum((gap[:, 1] - gap[:, 0]) / (0.35 * wavelength), 1.0) ** 0.7


def make_weave(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Two crossing systems of waves, as cloth and knurled grips have."""
    del normals
    first, second = np.linalg.qr(g.normal(size=(3, 3)))[0][:2]
    wave = np.sin(2.0 * np.pi * points @ first / wavelength)
    across = np.sin(2.0 * np.pi * points @ second / wavelength)
    return np.asarray(0.5 * wave * across)


def make_letters(g: Generator, points: Floats, normals: Floats, wavelength: float) -> Floats:
    """Letters engraved or raised all over, ``wavelength`` high, with walls of two edges.

    Steeper walls would be ragged, for no edges follow them.
    """
    places, _ = _draw_seeds(g, points, 1.5 * wavelength)
    tree = cKDTree(points)
    heights = np.zeros(len(points))
    width = max(0.09 * wavelength, 0.9)
    names = sorted(STROKES)
    for place in places:
        near = np.array(tree.query_ball_point(points[place], 0.72 * wavelength))
        near = near[normals[near] @ normals[place] > 0.5]
        side = to_unit(np.cross(normals[place], g.normal(size=3))[None])[0]
        frame = np.stack([side, np.cross(normals[place], side)], axis=1)
        flat = (points[near] - points[place]) @ frame / (0.25 * wavelength) + 2.0
        gap = _stroke_distance(flat, STROKES[names[int(g.integers(len(names)))]])
        gap *= 0.25 * wavelength
        depth = np.clip((width + 1.2 - gap) / 2.4, 0.0, 1.0)
        depth = depth * depth * (3.0 - 2.0 * depth)
        heights[near] = np.maximum(heights[near], depth)
    return -heights if g.integers(2) else heights


def _stroke_distance(points: Floats, letter: str) -> Floats:
    """Distances (n,) of points (n, 2) to a letter's lines, in its grid's unit."""
    best = np.full(len(points), np.inf)
    for line in letter.split(" / "):
        corners = np.array([[float(place[0]), float(place[1])] for place in line.split()])
        for start, end in pairwise(corners):
            along = end - start
            share = np.clip((points - start) @ along / (along @ along), 0.0, 1.0)
            gap = np.linalg.norm(points - start - share[:, None] * along, axis=1)
            best = np.minimum(best, gap)
    return best


def _draw_seeds(g: Generator, points: Floats, spacing: float) -> tuple[list[int], cKDTree]:
    """Vertices no two of which are nearer than ``spacing``, in random order, and their tree."""
    tree = cKDTree(points)
    free = np.ones(len(points), dtype=bool)
    seeds = []
    for candidate in g.permutation(len(points)):
        if free[candidate]:
            seeds.append(int(candidate))
            free[tree.query_ball_point(points[candidate], spacing)] = False
    return seeds, cKDTree(points[seeds])


def _nearest_seeds(
    g: Generator, points: Floats, spacing: float, count: int
) -> tuple[Floats, np.ndarray]:
    """Distances (n, count) to the nearest seeds, and the seeds' vertices."""
    seeds, tree = _draw_seeds(g, points, 0.75 * spacing)
    # Two at least are asked for, so that the answer has two axes.
    gap, near = tree.query(points, k=2)
    return gap[:, :count], np.array(seeds)[np.minimum(near, len(seeds) - 1)][:, :count]


def apply_relief(
    mesh: LabelledMesh, maker: Relief, wavelength: float, amplitude: float, g: Generator
) -> LabelledMesh:
    """The mesh with relief along its normals, ``amplitude`` edges high; sharp edges stay.

    The heights fade out towards curves (see ``training.surface``) within three edges.
    """
    normals = vertex_normals(mesh.vertices, mesh.faces)
    heights = amplitude * maker(g, mesh.vertices, normals, wavelength)
    edges = build_edges(mesh.faces, len(mesh.vertices))
    pairs = face_labels(edges.faces, mesh.labels)
    is_curve = (pairs[:, 0] != pairs[:, 1]) & ~edges.is_boundary
    if is_curve.any():
        corners = mesh.vertices[np.unique(edges.ends[is_curve])]
        gap, _ = cKDTree(corners).query(mesh.vertices)
        heights = heights * np.clip(gap / 3.0, 0.0, 1.0)
    moved = mesh.vertices + heights[:, None] * normals
    return LabelledMesh(moved, mesh.faces, mesh.labels)
