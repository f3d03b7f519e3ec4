"""Range grids: a surface as one view of a scanner sees it, with open borders and jumps cut."""

from __future__ import annotations

import fcpw
import numpy as np
from scipy.spatial import cKDTree

from training.connectivity import (
    Bools,
    Floats,
    Ints,
    build_edges,
    drop_unused,
    face_crosses,
    to_unit,
)
from training.openings import large_pieces
from training.surface import LabelledMesh, Surface, face_labels
from training.triangulations import ideal_edge

Generator = np.random.Generator

GRAZING = 0.2
"""Cosine of the angle to the view below which nothing is measured."""


def make_range_grid(mesh: LabelledMesh, surface: Surface, count: int, g: Generator) -> LabelledMesh:
    """What rays on a square grid hit first; vertices next to a sharp edge lie on it.

    Faces longer than some steps in depth are left out, as the jumps of a range image are.
    """
    axes = _choose_view(mesh, g)
    # About a third of the surface is seen, and seen obliquely.
    step = 0.42 * ideal_edge(mesh, count)
    scene = _RayScene(mesh)
    flat = mesh.vertices @ axes[:2].T
    low, high = flat.min(axis=0), flat.max(axis=0)
    shape = np.ceil((high - low) / step).astype(int) + 1
    columns = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    places = low + step * (columns.reshape(-1, 2) + g.uniform(0.2, 0.8, 2))
    face, depth = scene.cast(places, axes)
    crosses = to_unit(face_crosses(mesh.vertices, mesh.faces))
    seen = (face >= 0) & (crosses[face] @ axes[2] > GRAZING)
    points = places @ axes[:2] + np.where(seen, depth, 0.0)[:, None] * axes[2]
    points[seen] = surface.project(points[seen], mesh.labels[face[seen]])
    snapped = _snap_to_curves(mesh, scene, axes, step, points, seen)
    faces = _triangulate(points, seen.reshape(shape), snapped, step)
    faces = faces[large_pieces(faces, len(points), 100)]
    vertices, faces, _ = drop_unused(points, faces)
    return LabelledMesh(vertices, faces, np.zeros(len(faces), dtype=np.int64))


def _choose_view(mesh: LabelledMesh, g: Generator) -> Floats:
    """A frame (3, 3) whose last axis points to the scanner: of some, that which sees most."""
    crosses = face_crosses(mesh.vertices, mesh.faces)
    areas = np.linalg.norm(crosses, axis=1)
    best, chosen = -1.0, np.eye(3)
    for _ in range(6):
        axes = np.linalg.qr(g.normal(size=(3, 3)))[0]
        if np.linalg.det(axes) < 0.0:
            axes[0] = -axes[0]
        # Faces seen obliquely count for less: the square of the cosine times the area.
        seen = float((np.maximum(crosses @ axes[2], 0.0) ** 2 / np.maximum(areas, 1e-300)).sum())
        if seen > best:
            best, chosen = seen, axes
    return chosen


class _RayScene:
    """Rays against the faces of a mesh, along one axis from above."""

    def __init__(self, mesh: LabelledMesh) -> None:
        self._corners = mesh.vertices[mesh.faces]
        self._far = 2.0 * float(np.abs(mesh.vertices).max()) + 1.0
        self._scene = fcpw.scene_3D()
        self._scene.set_object_count(1)
        self._scene.set_object_vertices(np.asfortranarray(mesh.vertices, dtype=np.float32), 0)
        self._scene.set_object_triangles(np.asfortranarray(mesh.faces, dtype=np.int32), 0)
        self._scene.build(fcpw.aggregate_type.bvh_surface_area, True)

    def cast(self, places: Floats, axes: Floats) -> tuple[Ints, Floats]:
        """The face that is seen at each place (n, 2), -1 for none, and its height above."""
        origins = places @ axes[:2] + self._far * axes[2]
        directions = np.broadcast_to(-axes[2], origins.shape)
        hits = fcpw.interaction_3D_list()
        self._scene.intersect(
            np.asfortranarray(origins, dtype=np.float32),
            np.asfortranarray(directions, dtype=np.float32),
            np.full(len(origins), np.inf, dtype=np.float32),
            hits,
        )
        face = np.fromiter((hit.primitive_index for hit in hits), np.int64, len(origins))
        face[(face < 0) | (face >= len(self._corners))] = -1
        corner = self._corners[face]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        slope = normal @ axes[2]
        offset = np.einsum("ij,ij->i", corner[:, 0] - places @ axes[:2], normal)
        return face, offset / np.where(np.abs(slope) > 1e-300, slope, 1.0)


def _snap_to_curves(
    mesh: LabelledMesh, scene: _RayScene, axes: Floats, step: float, points: Floats, seen: Bools
) -> Bools:
    """Move points (n, 3) next to a visible sharp edge onto it; which were moved (n,)."""
    moved = np.zeros(len(points), dtype=bool)
    edges = build_edges(mesh.faces, len(mesh.vertices))
    pairs = face_labels(edges.faces, mesh.labels)
    ends = mesh.vertices[edges.ends[pairs[:, 0] != pairs[:, 1]]]
    if len(ends) == 0:
        return moved
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    pieces = np.ceil(length / (0.05 * step)).astype(int) + 1
    row = np.repeat(np.arange(len(ends)), pieces)
    share = np.concatenate([np.linspace(0.0, 1.0, k) for k in pieces])
    samples = ends[row, 0] + share[:, None] * (ends[row, 1] - ends[row, 0])
    flat, height = samples @ axes[:2].T, samples @ axes[2]
    face, depth = scene.cast(flat, axes)
    samples = samples[(face < 0) | (depth < height + 0.05 * step)]
    rows = np.flatnonzero(seen)
    own = np.hstack([points[rows] @ axes[:2].T, 0.2 * (points[rows] @ axes[2])[:, None]])
    tree = cKDTree(np.hstack([samples @ axes[:2].T, 0.2 * (samples @ axes[2])[:, None]]))
    gap, near = tree.query(own, distance_upper_bound=0.71 * step)
    # The nearest first; one that would come close to another stays where it is.
    order = np.argsort(gap, kind="stable")
    order = order[np.isfinite(gap[order])]
    wanted = samples[near[order]]
    crowd = cKDTree(wanted).query_ball_point(wanted, 0.3 * step)
    free = np.ones(len(order), dtype=bool)
    for k, others in enumerate(crowd):
        if free[k]:
            free[[other for other in others if other > k]] = False
    chosen = rows[order[free]]
    points[chosen] = wanted[free]
    moved[chosen] = True
    return moved


def _triangulate(points: Floats, seen: Bools, snapped: Bools, step: float) -> Ints:
    """Faces between neighbours of the grid, seen from above; long and flat ones are left out."""
    number = np.arange(len(points)).reshape(seen.shape)
    a, b = number[:-1, :-1].reshape(-1), number[1:, :-1].reshape(-1)
    d, c = number[:-1, 1:].reshape(-1), number[1:, 1:].reshape(-1)
    first = np.linalg.norm(points[a] - points[c], axis=1)
    second = np.linalg.norm(points[b] - points[d], axis=1)
    known = seen.reshape(-1)
    # A diagonal along a sharp edge, then one whose ends are both seen, then the shorter one.
    first -= 10.0 * step * (snapped[a] & snapped[c]) + 1e6 * ~(known[b] & known[d])
    second -= 10.0 * step * (snapped[b] & snapped[d]) + 1e6 * ~(known[a] & known[c])
    by_first = (first <= second)[:, None]
    faces = np.concatenate(
        [
            np.where(by_first, np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1)),
            np.where(by_first, np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1)),
        ]
    )
    faces = faces[known[faces].all(axis=1)]
    corner = points[faces]
    lengths = np.linalg.norm(corner - corner[:, [1, 2, 0]], axis=2)
    area = np.linalg.norm(face_crosses(points, faces), axis=1)
    sound = (lengths.max(axis=1) < 4.5 * step) & (area > 0.05 * step * lengths.max(axis=1))
    return faces[sound]
