"""Triangulations as scanners and modellers make them, of one true surface each.

All take a starting mesh and its surface, and give a mesh of about ``count`` vertices whose vertices
lie on the surface, and on its sharp edges where it has such.
"""

from __future__ import annotations

import fast_simplification
import numpy as np
from scipy.spatial import cKDTree

from training.connectivity import Floats, Ints, build_edges, drop_unused, face_crosses
from training.organic import draw_waves
from training.remesh import Remesher, Sizing, remesh
from training.surface import LabelledMesh, Surface, face_labels

Generator = np.random.Generator


def ideal_edge(mesh: LabelledMesh, count: int) -> float:
    """The edge length with which equilateral triangles of ``count`` vertices cover the mesh."""
    area = 0.5 * float(np.linalg.norm(face_crosses(mesh.vertices, mesh.faces), axis=1).sum())
    return float(np.sqrt(area / (2.0 * count) * 4.0 / np.sqrt(3.0)))


def constant_sizing(length: float) -> Sizing:
    """The same target everywhere."""
    return lambda points: np.full(len(points), length)


def make_isotropic(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """Even triangles, nearly equilateral."""
    # Remeshing ends with edges of about 0.95 of the target.
    length = 1.03 * ideal_edge(mesh, count)
    return remesh(mesh, surface, constant_sizing(length), int(g.integers(2**31)))


def make_graded(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """Triangles whose size changes over the surface by up to three times."""
    length = 1.1 * ideal_edge(mesh, count)
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    waves = draw_waves(g, 0.5 * extent)

    def sizing(points: Floats) -> Floats:
        return length * np.exp2(np.clip(0.6 * waves(points), -0.8, 0.8))

    return remesh(mesh, surface, sizing, int(g.integers(2**31)))


def make_scattered(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """Delaunay triangles of points scattered at random, as merged point clouds have."""
    length = 1.03 * ideal_edge(mesh, count)
    coarse = remesh(mesh, surface, constant_sizing(length), int(g.integers(2**31)), 4)
    state = Remesher(coarse, surface, constant_sizing(length), 0)
    for _ in range(3):
        state.shift(g.normal(size=state.vertices.shape) * 0.2 * length)
        state.flip_edges()
    state.remove_slivers(0.2)
    return state.mesh()


def make_subdivided(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """Edges of a modeller's triangles halved until they are short: narrow triangles stay narrow."""
    length = 1.1 * ideal_edge(mesh, count)
    state = Remesher(mesh, surface, constant_sizing(length), int(g.integers(2**31)))
    state.merge_facets()
    state.split_long()
    state.remove_slivers(0.3)
    state.vertices = state.project(state.vertices)
    return state.mesh()


def make_jagged(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """The surface cut at the planes of a grid, as marching cubes leave it, but for slivers."""
    length = 1.25 * ideal_edge(mesh, count)
    turned = np.linalg.qr(g.normal(size=(3, 3)))[0]
    coarse = remesh(mesh, surface, constant_sizing(1.8 * length), int(g.integers(2**31)), 4)
    for axis in range(3):
        coarse = _cut_at_planes(coarse, turned[axis], length, float(g.uniform(0.2, 0.8)))
    state = Remesher(coarse, surface, constant_sizing(length), int(g.integers(2**31)))
    state.remove_slivers(0.4)
    state.vertices = state.project(state.vertices)
    state.remove_slivers(0.4)
    return state.mesh()


def _cut_at_planes(mesh: LabelledMesh, normal: Floats, step: float, offset: float) -> LabelledMesh:
    """Faces cut where they cross planes ``step`` apart; each cut adds vertices at the crossings."""
    state = Remesher(mesh, NoSurface(), constant_sizing(step), 0)
    for _ in range(60):
        edges = state.edges()
        height = (state.vertices @ normal) / step + offset
        low, high = np.sort(height[edges.ends], axis=1).T
        # The next plane above the lower end, if it is well within the edge.
        level = np.floor(low + 1e-6) + 1.0
        chosen = level < high - 1e-6
        if not chosen.any():
            break
        start, end = edges.ends[chosen].T
        share = (level[chosen] - height[start]) / (height[end] - height[start])
        first, second = state.vertices[start], state.vertices[end]
        state.split(edges, chosen, first + share[:, None] * (second - first))
    return state.mesh()


class NoSurface:
    """Leaves points where they are."""

    def project(self, points: Floats, labels: Ints) -> Floats:
        """The points (n, 3)."""
        del labels
        return points

    def project_to_curves(self, points: Floats, pairs: Ints) -> Floats:
        """The points (n, 3)."""
        del pairs
        return points


def make_decimated(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """Quadric decimation of a fine mesh without curves: large triangles where it is flat."""
    fine = make_isotropic(mesh, surface, int(1.8 * count), g)
    share = 1.0 - count / len(fine.vertices)
    points, faces = fast_simplification.simplify(
        fine.vertices, fine.faces.astype(np.int32), target_reduction=share, agg=4.0
    )
    vertices, faces, _ = drop_unused(points.astype(np.float64), faces.astype(np.int64))
    labels = np.zeros(len(faces), dtype=np.int64)
    state = Remesher(LabelledMesh(vertices, faces, labels), surface, lambda p: p[:, 0], 0)
    state.shift(np.zeros_like(vertices))
    return state.mesh()


def make_adaptive(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """Small triangles along sharp edges and large ones away from them, as decimated parts have."""
    edges = build_edges(mesh.faces, len(mesh.vertices))
    pairs = face_labels(edges.faces, mesh.labels)
    ends = mesh.vertices[edges.ends[pairs[:, 0] != pairs[:, 1]]]
    length = 0.75 * ideal_edge(mesh, count)
    long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > length
    share = np.linspace(0.0, 1.0, 65)[:, None, None]
    inner = ends[long, 0] + share * (ends[long, 1] - ends[long, 0])
    tree = cKDTree(np.concatenate([ends[:, 0], inner.reshape(-1, 3)]))

    def sizing(points: Floats) -> Floats:
        gap, _ = tree.query(points, distance_upper_bound=9.0 * length)
        return length * np.clip(0.8 + 0.25 * gap / length, 0.8, 3.0)

    return remesh(mesh, surface, sizing, int(g.integers(2**31)))
