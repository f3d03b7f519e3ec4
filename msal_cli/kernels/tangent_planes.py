"""Tangent planes of a neighbourhood: how far they disagree, and steps towards them."""

from __future__ import annotations

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.parallel import fill_array


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
    return fill_array(
        _normal_spread, len(positions), face_normals(positions, faces), normals, *links.incidence
    )


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
