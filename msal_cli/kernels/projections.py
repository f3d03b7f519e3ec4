"""Planes around a vertex: projections on those of faces, and steps towards those of vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.elementary import exponentials
from msal_cli.kernels.geometry import face_normals, face_normals_and_areas
from msal_cli.kernels.operators import SMALLEST_SIGMA, Step
from msal_cli.kernels.parallel import fill_array
from msal_cli.kernels.vertex_neighbourhoods import faces_around, room

_CENTROIDS, _PROJECTIONS = range(2)

SMALLEST_AREA = 1e-12
"""Area of a mollified face, in squared mean edge lengths, up to which its normal is rounding: a
triangle that no other touches shrinks to a point."""


@compiled
def _project(
    start,
    stop,
    x,
    centroids,
    areas,
    normals,
    faces,
    face_start,
    incident,
    free,
    radius,
    closeness,
    similarity,
    floor,
    averaged,
    moves,
):
    """x positions, c centroids, n normals, s = (x - c) . n heights over the planes, g weights."""
    capacity = room(start, stop, face_start)
    vertex_mark = np.full(len(face_start) - 1, -1, dtype=np.int32)
    face_mark = np.full(len(faces), -1, dtype=np.int32)
    corners = np.empty(3 * capacity + 1, dtype=np.int32)
    found = np.empty(capacity, dtype=np.int32)
    squares = np.empty(capacity)
    s = np.empty(capacity)
    g = np.empty(capacity)
    scratch = np.empty(capacity)
    scratch_bits = scratch.view(np.int64)
    near = 0.5 / max(closeness, floor) ** 2
    alike = 0.5 / max(similarity, floor) ** 2 if averaged == _PROJECTIONS else 0.0
    for i in range(start, stop):
        moves[i, 0] = moves[i, 1] = moves[i, 2] = 0.0
        if not free[i]:
            continue
        count = faces_around(
            i,
            x,
            centroids,
            faces,
            face_start,
            incident,
            radius * radius,
            vertex_mark,
            face_mark,
            corners,
            found,
            squares,
        )
        xi, yi, zi = x[i, 0], x[i, 1], x[i, 2]
        least = np.inf
        for at in range(count):
            f = found[at]
            s[at] = (
                (xi - centroids[f, 0]) * normals[f, 0]
                + (yi - centroids[f, 1]) * normals[f, 1]
                + (zi - centroids[f, 2]) * normals[f, 2]
            )
            g[at] = squares[at] * near + s[at] * s[at] * alike
            least = min(least, g[at])
        # The largest Gaussian is made 1: the quotient stays the same, and cannot become 0/0.
        for at in range(count):
            g[at] = least - g[at]
        exponentials(g, scratch, scratch_bits, count)
        weights = mx = my = mz = 0.0
        for at in range(count):
            f = found[at]
            weight = g[at] * areas[f]
            weights += weight
            if averaged == _PROJECTIONS:
                mx -= weight * s[at] * normals[f, 0]
                my -= weight * s[at] * normals[f, 1]
                mz -= weight * s[at] * normals[f, 2]
            else:
                mx += weight * (centroids[f, 0] - xi)
                my += weight * (centroids[f, 1] - yi)
                mz += weight * (centroids[f, 2] - zi)
        if weights > 0.0:
            moves[i, 0], moves[i, 1], moves[i, 2] = mx / weights, my / weights, mz / weights


@dataclass(frozen=True, eq=False)
class ProjectionAverage:
    """dx = sum(w (P(x) - x)) / sum(w) over the faces around x, w = A f(|c - x|) g(|P(x) - x|).

    P(x) is the projection of x on the plane through a face's centroid c along its mollified
    normal, A the face's area, f and g Gaussians of widths ``closeness`` and ``similarity`` (Jones,
    Durand and Desbrun 2003).  Mollified normals are those of the faces after every vertex went to
    the average of the centroids, with weights A f, f half as wide; where that leaves nothing of a
    face its own normal is taken.  The faces are those with a centroid within 2 closeness
    that such faces join to the vertex; one without any does not move.

    Attributes
    ----------
    faces, links : (m, 3) and its neighbourhoods.
    free : (n,) bool, False for vertices that must stay.
    mean_edge_length : file units; areas are taken in squares of it, and it sets the floor of the
        widths.
    closeness, similarity : sigma_f and sigma_g, file units.
    """

    faces: Ints
    links: Connectivity
    free: Flags
    mean_edge_length: float
    closeness: float
    similarity: float
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        """The moves (n, 3) at ``positions``, all from the same positions."""
        own, areas = face_normals_and_areas(positions, self.faces)
        areas /= self.mean_edge_length**2
        corners = positions[self.faces]
        centroids = (corners[:, 0] + corners[:, 1] + corners[:, 2]) / 3.0
        everywhere = np.ones_like(self.free)
        smooth = positions + self._average(
            positions, centroids, areas, own, everywhere, 0.5 * self.closeness, _CENTROIDS
        )
        normals, smooth_areas = face_normals_and_areas(smooth, self.faces)
        has_normal = smooth_areas > SMALLEST_AREA * self.mean_edge_length**2
        has_normal &= (normals != 0.0).any(axis=1)
        normals = np.where(has_normal[:, None], normals, own)
        return Step(
            self._average(
                positions, centroids, areas, normals, self.free, self.closeness, _PROJECTIONS
            )
        )

    def _average(
        self,
        positions: Floats,
        centroids: Floats,
        areas: Floats,
        normals: Floats,
        free: Flags,
        closeness: float,
        averaged: int,
    ) -> Floats:
        """Moves (n, 3) of the vertices to the average of the centroids or the projections."""
        widths = 2.0 * self.closeness, closeness, self.similarity
        floor = SMALLEST_SIGMA * self.mean_edge_length
        planes = centroids, areas, normals, self.faces, *self.links.incidence
        known = positions, *planes, free, *widths, floor, averaged
        return fill_array(_project, positions.shape, *known)


@compiled
def _normal_spread(start, stop, unit_normals, normals, face_start, incident, spread):
    for i in range(start, stop):
        total = count = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            nx, ny, nz = unit_normals[f, 0], unit_normals[f, 1], unit_normals[f, 2]
            if nx != 0.0 or ny != 0.0 or nz != 0.0:
                total += 1.0 - (nx * normals[i, 0] + ny * normals[i, 1] + nz * normals[i, 2])
                count += 1.0
        spread[i] = max(0.0, total / count) if count > 0.0 else 0.0


def normal_spread(positions: Floats, faces: Ints, links: Connectivity, normals: Floats) -> Floats:
    """Mean of 1 - n_f . n over the faces around each vertex (n,), n its unit normal (n, 3).

    On an edge between two planes that is 1 - cos of half the angle between their normals.  Faces
    without area do not count; a vertex without others has 0.
    """
    units = face_normals(positions, faces)
    return fill_array(_normal_spread, len(positions), units, normals, *links.incidence)


@compiled
def _towards_planes(start, stop, x, normals, ring_start, ring, moves):
    for i in range(start, stop):
        mx = my = mz = 0.0
        m = ring_start[i + 1] - ring_start[i]
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            nx, ny, nz = normals[k, 0], normals[k, 1], normals[k, 2]
            height = (x[k, 0] - x[i, 0]) * nx + (x[k, 1] - x[i, 1]) * ny + (x[k, 2] - x[i, 2]) * nz
            mx += height * nx
            my += height * ny
            mz += height * nz
        share = 1.0 / m if m else 0.0
        moves[i, 0], moves[i, 1], moves[i, 2] = share * mx, share * my, share * mz


def towards_planes(positions: Floats, normals: Floats, ring_start: Ints, ring: Ints) -> Floats:
    """Mean of the steps (n, 3) that take each vertex to the tangent planes of its one-ring.

    A gradient step on the sum of squared distances from these planes, the quadric of the
    neighbourhood: between two flat sides its least place is the edge, between three the corner.
    Neighbours with a zero normal count as planes on which the vertex lies already.
    """
    return fill_array(_towards_planes, positions.shape, positions, normals, ring_start, ring)
