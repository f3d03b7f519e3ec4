"""Area, volume and normals of a surface before and after its vertices moved, in one pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.arctangent import arctangents
from msal_cli.core.compiled import compiled
from msal_cli.core.geometry import DEGENERATE
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

BLOCK_FACES = 512
"""Faces that are worked on at a time; also the terms of one partial sum, so that sums do not
depend on the number of threads."""

(
    DOUBLED_AREA_BEFORE,
    DOUBLED_AREA_AFTER,
    SIXFOLD_VOLUME_BEFORE,
    SIXFOLD_VOLUME_AFTER,
    ANGLES,  # sum of the angles between a face's normals, radians
    LARGEST_ANGLE,
    FLIPPED,  # faces that turned by more than a right angle
    COMPARED,  # faces that have a normal before and after
    N_FIGURES,
) = range(9)


@compiled
def _doubled_area_and_volume(vertices, a, b, c):  # type: ignore[no-untyped-def]
    """Cross product of two edges, its length, sixfold volume, and whether there is a normal."""
    ax, ay, az = vertices[a, 0], vertices[a, 1], vertices[a, 2]
    ux, uy, uz = vertices[b, 0] - ax, vertices[b, 1] - ay, vertices[b, 2] - az
    wx, wy, wz = vertices[c, 0] - ax, vertices[c, 1] - ay, vertices[c, 2] - az
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    vx, vy, vz = wx - ux, wy - uy, wz - uz
    longest = max(
        ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz, vx * vx + vy * vy + vz * vz
    )
    return nx, ny, nz, length, ax * nx + ay * ny + az * nz, length > DEGENERATE * longest


@compiled
def _changes(start, stop, before, after, faces, figures):  # type: ignore[no-untyped-def]
    apart = np.empty(BLOCK_FACES)  # length of the difference of the two unit normals
    along = np.empty(BLOCK_FACES)  # length of their sum
    for block in range(start, stop):
        area_before = area_after = volume_before = volume_after = 0.0
        compared = flipped = 0
        first = block * BLOCK_FACES
        for f in range(first, min(first + BLOCK_FACES, len(faces))):
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            px, py, pz, p, volume, is_whole = _doubled_area_and_volume(before, a, b, c)
            area_before += p
            volume_before += volume
            qx, qy, qz, q, volume, is_still = _doubled_area_and_volume(after, a, b, c)
            area_after += q
            volume_after += volume
            if is_whole and is_still:
                px, py, pz, qx, qy, qz = px / p, py / p, pz / p, qx / q, qy / q, qz / q
                dx, dy, dz = px - qx, py - qy, pz - qz
                sx, sy, sz = px + qx, py + qy, pz + qz
                # The arctangent of these two is exact for tiny angles, where arccos is not.
                apart[compared] = np.sqrt(dx * dx + dy * dy + dz * dz)
                along[compared] = np.sqrt(sx * sx + sy * sy + sz * sz)
                flipped += apart[compared] > along[compared]
                compared += 1
        arctangents(apart, along, compared)
        total = largest = 0.0
        for at in range(compared):
            total += apart[at]
            largest = max(largest, apart[at])
        figures[block, DOUBLED_AREA_BEFORE] = area_before
        figures[block, DOUBLED_AREA_AFTER] = area_after
        figures[block, SIXFOLD_VOLUME_BEFORE] = volume_before
        figures[block, SIXFOLD_VOLUME_AFTER] = volume_after
        figures[block, ANGLES] = 2.0 * total
        figures[block, LARGEST_ANGLE] = 2.0 * largest
        figures[block, FLIPPED] = flipped
        figures[block, COMPARED] = compared


def surface_figures(before: Floats, after: Floats, faces: Ints) -> Floats:
    """The figures (N_FIGURES,) of ``faces`` (m, 3) over two sets of vertices (n, 3).

    The places are named above; the largest angle is a maximum, all others are sums.
    """
    n_blocks = -(-len(faces) // BLOCK_FACES)
    figures = np.empty((n_blocks, N_FIGURES))
    over_ranges(_changes, n_blocks, before, after, faces, figures, smallest=64)
    total: Floats = figures.sum(axis=0)
    total[LARGEST_ANGLE] = figures[:, LARGEST_ANGLE].max(initial=0.0)
    return total
