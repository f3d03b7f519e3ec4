"""The normals of a true surface anywhere on it, for scans whose faces are not those of the truth.

The triangles of the truth stand for a surface: smooth across shallow edges, where the facets'
own normals would count as errors of a finer scan, and sharp across creases.  So normals are
interpolated as in smooth shading, between corners that take the mean over the faces around their
vertex that meet at less than ``CREASE_DEG``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import nearest_on_surface
from msal_cli.kernels.geometry import face_normals, face_normals_and_areas
from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]

CREASE_DEG = 40.0
"""Angle between faces from which on an edge is sharp: coarse models of smooth shapes stay below,
chamfers at 45 degrees do not."""


class TrueSurface:
    """A true mesh with a normal at every point."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self._corner_normals = corner_normals(mesh)

    def normals_at(self, points: Floats) -> Floats:
        """Unit normals (n, 3) at the points of the surface nearest to ``points`` (n, 3); zero where
        the nearest face has no area."""
        triangles, _ = nearest_on_surface(points, self.mesh)
        corners = self.mesh.vertices[self.mesh.faces[triangles]]
        shares = np.clip(barycentric(points, corners), 0.0, 1.0)
        return _unit(np.einsum("nk,nkj->nj", shares, self._corner_normals[triangles]))

    def angles_of(self, mesh: Mesh) -> Floats:
        """Angles (k,) in radians between the normals of a mesh's faces and those of the surface
        nearest to their centres; faces without a normal, here or there, are left out."""
        normals = face_normals(mesh.vertices, mesh.faces)
        others = self.normals_at(mesh.vertices[mesh.faces].mean(axis=1))
        has_both = normals.any(axis=1) & others.any(axis=1)
        cosines = (normals[has_both] * others[has_both]).sum(axis=1)
        angles: Floats = np.arccos(np.clip(cosines, -1.0, 1.0))
        return angles


def corner_normals(mesh: Mesh) -> Floats:
    """Unit normals (m, 3, 3) of each corner of each face: the mean by area over the faces around
    its vertex that are less than ``CREASE_DEG`` from this face."""
    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    corners = mesh.faces.reshape(-1)
    # Corners in the order of their vertices: those of one vertex are a range.
    order = np.argsort(corners, kind="stable")
    counts = np.bincount(corners, minlength=len(mesh.vertices))
    starts = np.cumsum(counts) - counts
    # All pairs of corners at one vertex.
    valences = counts[corners]
    firsts = np.repeat(np.arange(len(corners)), valences)
    within = np.arange(len(firsts)) - np.repeat(np.cumsum(valences) - valences, valences)
    seconds = order[np.repeat(starts[corners], valences) + within]
    face, other = firsts // 3, seconds // 3
    is_smooth = (normals[face] * normals[other]).sum(axis=1) > np.cos(np.radians(CREASE_DEG))
    weighted = (normals * areas[:, None])[other[is_smooth]]
    sums = np.stack(
        [np.bincount(firsts[is_smooth], weighted[:, k], len(corners)) for k in range(3)], axis=1
    )
    return _unit(sums).reshape(-1, 3, 3)


def barycentric(points: Floats, corners: Floats) -> Floats:
    """Barycentric coordinates (n, 3) of the feet of ``points`` (n, 3) on the planes of their
    triangles (n, 3, 3)."""
    first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
    normals = np.cross(second - first, third - first)
    squared = (normals * normals).sum(axis=1)
    squared[squared == 0.0] = 1.0
    u = (np.cross(third - second, points - second) * normals).sum(axis=1) / squared
    v = (np.cross(first - third, points - third) * normals).sum(axis=1) / squared
    return np.stack([u, v, 1.0 - u - v], axis=1)


def _unit(vectors: Floats) -> Floats:
    lengths = np.linalg.norm(vectors, axis=1)
    result: Floats = vectors / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    return result
