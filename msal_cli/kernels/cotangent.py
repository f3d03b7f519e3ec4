"""Cotangent weights of edges and the areas that belong to vertices.

Sums run over the corners of faces, so that open and non-manifold edges need no rule of their own:
an edge has the cotangents of as many corners as look at it.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.parallel import fill_array, over_ranges
from msal_cli.kernels.vectors import edges_and_normal, longest_square

FLATTEST = 0.05
"""Height over longest edge below which a face's cotangents are those of a face that is less flat.

About three degrees in the smallest angle of an isosceles face; no cotangent exceeds 20.
"""


@compiled
def _corner_dots(vertices, a, b, c):
    """Dot products of the edges that leave each corner, doubled area, longest edge squared."""
    ux, uy, uz, wx, wy, wz, nx, ny, nz = edges_and_normal(vertices, a, b, c)
    vx, vy, vz = wx - ux, wy - uy, wz - uz
    doubled = np.sqrt(nx * nx + ny * ny + nz * nz)
    longest = longest_square(ux, uy, uz, wx, wy, wz)
    at_a = ux * wx + uy * wy + uz * wz
    at_b = -(ux * vx + uy * vy + uz * vz)
    at_c = wx * vx + wy * vy + wz * vz
    return at_a, at_b, at_c, doubled, longest


@compiled
def _corner_cotangents(start, stop, vertices, faces, cotangents):
    for f in range(start, stop):
        at_a, at_b, at_c, doubled, longest = _corner_dots(
            vertices, faces[f, 0], faces[f, 1], faces[f, 2]
        )
        # One divisor for all three: then the face's part of the stiffness matrix is that of the
        # true face times a number below one, and never loses its positive sign.
        divisor = max(doubled, FLATTEST * longest)
        inverse = 1.0 / divisor if divisor > 0.0 else 0.0
        cotangents[f, 0] = at_a * inverse
        cotangents[f, 1] = at_b * inverse
        cotangents[f, 2] = at_c * inverse


def corner_cotangents(vertices: Floats, faces: Ints) -> Floats:
    """Cotangent of every face's angle at each corner, (m, 3), from -20 to 20.

    The three of a face whose height is less than 1/20 of its longest edge are smaller than the
    true ones by one common factor; those of a face without area are finite.
    """
    return fill_array(_corner_cotangents, (len(faces), 3), vertices, faces)


@compiled
def _cotangent_weights(
    start, stop, cotangents, faces, face_start, incident, ring_start, ring, weights
):
    # Slots in ``ring`` only grow, so one at or above a row's start belongs to that row.
    slot = np.full(len(ring_start) - 1, -1, dtype=np.int32)
    for i in range(start, stop):
        row = ring_start[i]
        for at in range(row, ring_start[i + 1]):
            slot[ring[at]] = at
            weights[at] = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            own = 0
            while faces[f, own] != i:
                own += 1
            after, before = (own + 1) % 3, (own + 2) % 3
            weights[slot[faces[f, after]]] += cotangents[f, before]
            weights[slot[faces[f, before]]] += cotangents[f, after]


def cotangent_weights(vertices: Floats, faces: Ints, links: Connectivity) -> Floats:
    """cot alpha + cot beta of every edge, (e,), one for each entry of ``links.ring``.

    alpha and beta are the angles that face the edge; an open edge has one, a non-manifold edge as
    many as it has faces.  The gradient of the surface's area with respect to vertex i is
    sum(w_ik (x_i - x_k)) / 2, but for faces too flat for their true cotangents (see
    ``corner_cotangents``).  The matrix with -w off its diagonal and sum(w) on it is positive
    semidefinite for any vertices.

    Parameters
    ----------
    vertices : (n, 3).
    faces : (m, 3), the faces that ``links`` were made from, each wound either way.
    """
    weights = np.empty(len(links.ring))
    cotangents = corner_cotangents(vertices, faces)
    rows = *links.incidence, *links.one_ring
    over_ranges(_cotangent_weights, len(vertices), cotangents, faces, *rows, weights)
    return weights


@compiled
def _corner_areas(start, stop, vertices, faces, areas):
    for f in range(start, stop):
        at_a, at_b, at_c, doubled, _ = _corner_dots(vertices, faces[f, 0], faces[f, 1], faces[f, 2])
        lowest = min(at_a, at_b, at_c)
        if doubled == 0.0:
            areas[f, 0] = areas[f, 1] = areas[f, 2] = 0.0
        elif lowest < 0.0:
            areas[f, 0] = doubled / (4.0 if at_a == lowest else 8.0)
            areas[f, 1] = doubled / (4.0 if at_b == lowest else 8.0)
            areas[f, 2] = doubled / (4.0 if at_c == lowest else 8.0)
        else:
            # Squared length of an edge times the cotangent of the corner that faces it.
            scale = 1.0 / (8.0 * doubled)
            of_bc = (at_b + at_c) * (at_a * scale)
            of_ca = (at_c + at_a) * (at_b * scale)
            of_ab = (at_a + at_b) * (at_c * scale)
            areas[f, 0], areas[f, 1], areas[f, 2] = of_ca + of_ab, of_ab + of_bc, of_bc + of_ca


@compiled
def _mixed_areas(start, stop, corner_areas, faces, face_start, incident, areas):
    for i in range(start, stop):
        total = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            for corner in range(3):
                if faces[f, corner] == i:
                    total += corner_areas[f, corner]
        areas[i] = total


def mixed_areas(vertices: Floats, faces: Ints, links: Connectivity) -> Floats:
    """Mixed Voronoi area of every vertex, (n,), in squared units; Meyer et al. 2002.

    Of a face without obtuse angle each corner has the part that is nearer to it than to the other
    two; of an obtuse face the obtuse corner has a half, the others a quarter each.  The sum over
    all vertices is the area of the surface.
    """
    corner_areas = np.empty((len(faces), 3))
    over_ranges(_corner_areas, len(faces), vertices, faces, corner_areas)
    return fill_array(_mixed_areas, len(vertices), corner_areas, faces, *links.incidence)


@compiled
def _ring_areas(start, stop, face_areas, face_start, incident, areas):
    for i in range(start, stop):
        total = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            total += face_areas[incident[at]]
        areas[i] = total


def ring_areas(vertices: Floats, faces: Ints, links: Connectivity) -> Floats:
    """Area of the faces around every vertex, (n,), in squared units; they sum to three times it."""
    areas = face_normals_and_areas(vertices, faces)[1]
    return fill_array(_ring_areas, len(vertices), areas, *links.incidence)
