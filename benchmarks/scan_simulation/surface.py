"""Rays and nearest points on a mesh, found by FCPW and computed here in double precision."""

from __future__ import annotations

from typing import Any

import fcpw
import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs
from msal_cli.mesh import Mesh

AT_ONCE = 1 << 17
"""Rays and points that are looked up at a time: the library answers with an object for each."""


class Surface:
    """A mesh that rays are sent to."""

    def __init__(self, mesh: Mesh) -> None:
        self._corners = mesh.vertices[mesh.faces]
        self._scale = float(np.abs(mesh.vertices).max())
        self._scene = fcpw.scene_3D()
        self._scene.set_object_count(1)
        self._scene.set_object_vertices(_single(mesh.vertices, self._scale), 0)
        self._scene.set_object_triangles(np.asfortranarray(mesh.faces), 0)
        self._scene.build(fcpw.aggregate_type.bvh_surface_area, True)

    def cast_rays(self, origin: Floats, directions: Floats) -> tuple[Floats, Longs]:
        """How far (n,) rays from ``origin`` (3,) along unit vectors (n, 3) run, and the faces (n,)
        that they meet: infinity and -1 for none."""
        distances, faces = np.full(len(directions), np.inf), np.full(len(directions), -1)
        for start in range(0, len(directions), AT_ONCE):
            some = directions[start : start + AT_ONCE]
            hits = fcpw.interaction_3D_list()
            origins = np.broadcast_to(origin, some.shape)
            reach = np.full(len(some), np.inf, dtype=np.float32)
            self._scene.intersect(_single(origins, self._scale), _single(some, 1.0), reach, hits)
            face, rough = _read_hits(hits, len(some))
            met = np.flatnonzero(face >= 0)
            rows = start + met
            faces[rows] = face[met]
            distances[rows] = _meet_planes(
                origin, some[met], self._corners[face[met]], rough[met] * self._scale
            )
        return distances, faces

    def face_normals(self, faces: Longs) -> Floats:
        """Unit normals (n, 3) of faces, zeros for those without area."""
        a, b, c = (self._corners[faces, at] for at in range(3))
        normals = np.cross(b - a, c - a)
        lengths = np.sqrt((normals * normals).sum(axis=1))
        result: Floats = normals / np.where(lengths > 0.0, lengths, 1.0)[:, None]
        return result

    def closest_points(self, points: Floats) -> Floats:
        """The nearest point (n, 3) of the surface for each of the points (n, 3)."""
        nearest = np.empty_like(points)
        for start in range(0, len(points), AT_ONCE):
            some = points[start : start + AT_ONCE]
            hits = fcpw.interaction_3D_list()
            reach = np.full(len(some), np.inf, dtype=np.float32)
            self._scene.find_closest_points(_single(some, self._scale), reach, hits)
            face, _ = _read_hits(hits, len(some))
            nearest[start : start + len(some)] = closest_on_triangles(some, self._corners[face])
        return nearest


def _single(positions: Floats, scale: float) -> NDArray[np.float32]:
    """Positions divided by ``scale``, as the library takes them."""
    return np.asfortranarray(positions / scale, dtype=np.float32)


def _read_hits(hits: Any, count: int) -> tuple[Longs, Floats]:
    """Faces (n,), -1 for none, and distances (n,) of what the library has met."""
    faces = np.fromiter((one.primitive_index for one in hits), np.int64, count)
    return faces, np.fromiter((one.d for one in hits), np.float64, count)


def _meet_planes(origin: Floats, directions: Floats, corners: Floats, rough: Floats) -> Floats:
    """Distances (n,) along rays to the planes of triangles (n, 3, 3); the rough ones where a ray
    runs along its plane, and the plane's distance is not better."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ways = (directions * normals).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        exact = ((corners[:, 0] - origin) * normals).sum(axis=1) / ways
    is_near = np.abs(exact - rough) <= 1e-4 * rough
    return np.where(is_near, exact, rough)


def closest_on_triangles(points: Floats, corners: Floats) -> Floats:
    """The nearest point (n, 3) of each point's own triangle, (n, 3, 3)."""
    first = corners[:, 0]
    normals = np.cross(corners[:, 1] - first, corners[:, 2] - first)
    squared = (normals * normals).sum(axis=1)
    within = squared > 0.0
    best, nearest = np.full(len(points), np.inf), np.empty_like(points)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        start = corners[:, a]
        edge, offset = corners[:, b] - start, points - start
        length = (edge * edge).sum(axis=1)
        share = (offset * edge).sum(axis=1) / np.where(length > 0.0, length, 1.0)
        foot = start + np.clip(share, 0.0, 1.0)[:, None] * edge
        distance = ((points - foot) ** 2).sum(axis=1)
        is_nearer = distance < best
        best[is_nearer], nearest[is_nearer] = distance[is_nearer], foot[is_nearer]
        within &= (np.cross(edge, offset) * normals).sum(axis=1) >= 0.0
    height = ((points - first) * normals).sum(axis=1) / np.where(squared > 0.0, squared, 1.0)
    result: Floats = np.where(within[:, None], points - height[:, None] * normals, nearest)
    return result
