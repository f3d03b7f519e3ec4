"""Flaps: an edge with exactly two faces, and the two vertices that face it."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.parallel import fill_array
from msal_cli.kernels.ring_blocks import longest_row
from msal_cli.kernels.vectors import edges_and_normal


@compiled
def _flaps(faces, face_start, incident, ring_start, ring, result):
    n = len(ring_start) - 1
    # Positions in ``ring`` only grow, so a slot at or above a row's start belongs to that row.
    slot = np.full(n, -1, dtype=np.int32)
    widest = longest_row(0, n, ring_start)
    count = np.zeros(widest, dtype=np.int32)
    facing = np.empty((widest, 2), dtype=np.int32)
    found = 0
    for i in range(n):
        row = ring_start[i]
        for at in range(row, ring_start[i + 1]):
            slot[ring[at]] = at - row
            count[at - row] = 0
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            own = 0
            while faces[f, own] != i:
                own += 1
            after, before = faces[f, (own + 1) % 3], faces[f, (own + 2) % 3]
            for k, opposite in ((after, before), (before, after)):
                s = slot[k]
                if count[s] < 2:
                    facing[s, count[s]] = opposite
                count[s] += 1
        for at in range(row, ring_start[i + 1]):
            if ring[at] > i and count[at - row] == 2:
                result[found, 0], result[found, 1] = i, facing[at - row, 0]
                result[found, 2], result[found, 3] = ring[at], facing[at - row, 1]
                found += 1
    return found


def flaps(faces: Ints, links: Connectivity) -> Ints:
    """Every edge (p1, p3) with exactly two faces (p1, p2, p3) and (p1, p3, p4): (e, 4) int32.

    p1 < p3, and the rows are in ascending order of p1.  Open edges and edges with more than two
    faces are left out.  The two faces may be wound either way; seen as written here they are
    wound alike.  ``faces`` (m, 3) are those that ``links`` were made from.
    """
    # Every such edge is in the rings of both its ends.
    result = np.empty((len(links.ring) // 2, 4), dtype=np.int32)
    return result[: _flaps(faces, *links.incidence, *links.one_ring, result)].copy()


@compiled
def _dihedral_angles(start, stop, x, corners, angles):
    for e in range(start, stop):
        p1, p2, p3, p4 = corners[e, 0], corners[e, 1], corners[e, 2], corners[e, 3]
        _, _, _, _, _, _, mx, my, mz = edges_and_normal(x, p1, p2, p3)
        _, _, _, _, _, _, nx, ny, nz = edges_and_normal(x, p1, p3, p4)
        sx, sy, sz = my * nz - mz * ny, mz * nx - mx * nz, mx * ny - my * nx
        angles[e] = np.arctan2(np.sqrt(sx * sx + sy * sy + sz * sz), mx * nx + my * ny + mz * nz)


def dihedral_angles(vertices: Floats, corners: Ints) -> Floats:
    """Angle (e,) between the normals of the two faces of every flap (e, 4), 0 to pi radians.

    Zero where it is flat, and where a face has no area.
    """
    return fill_array(_dihedral_angles, len(corners), vertices, corners)
