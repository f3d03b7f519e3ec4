"""Vertices moved to fit given face normals: the second stage of every filter of normals.

Sun, Rosin, Martin and Langbein 2007: with the normals n' that the faces should have, each pass
moves every vertex by the mean of its ways to the planes through the centroids of its faces,

    x_i <- x_i + mean over f (n'_f . (c_f - x_i)) n'_f,

a step of gradient descent on the sum of squares of n'_f . (edges of f), which is zero where every
face has its normal.  All vertices move at once, and the centroids c follow at every pass.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO

FOUR = np.uint64(4)


THIRD = 1.0 / 3.0


@compiled
def _planes(start, stop, normals, planes):
    """The first three numbers of every plane: its normal n'."""
    for f in range(np.uint64(start), np.uint64(stop)):
        planes[f, 0], planes[f, 1], planes[f, 2] = normals[f, 0], normals[f, 1], normals[f, 2]


@compiled
def _shares(start, stop, planes, face_start, incident, free, share):
    """One over the number of faces that have a normal; zero for vertices that stay."""
    for i in range(np.uint64(start), np.uint64(stop)):
        count = 0
        for at in range(np.uint64(face_start[i]), np.uint64(face_start[i + ONE])):
            f = FOUR * incident[at]
            count += (planes[f] != 0.0) | (planes[f + ONE] != 0.0) | (planes[f + TWO] != 0.0)
        share[i] = 1.0 / max(count, 1) if free[i] and count else 0.0


@compiled
def _offsets(start, stop, x, faces, planes):
    """The fourth number of every plane: n' . c.  All arrays are flat; x positions.

    Indices are unsigned, so that none is looked at for its sign.
    """
    for f in range(np.uint64(start), np.uint64(stop)):
        a = THREE * faces[THREE * f]
        b = THREE * faces[THREE * f + ONE]
        c = THREE * faces[THREE * f + TWO]
        ax, ay, az = x[a], x[a + ONE], x[a + TWO]
        # In this way the centroid of equal coordinates is just these.
        cx = ax + ((x[b] - ax) + (x[c] - ax)) * THIRD
        cy = ay + ((x[b + ONE] - ay) + (x[c + ONE] - ay)) * THIRD
        cz = az + ((x[b + TWO] - az) + (x[c + TWO] - az)) * THIRD
        plane = FOUR * f
        planes[plane + THREE] = (
            planes[plane] * cx + planes[plane + ONE] * cy + planes[plane + TWO] * cz
        )


@compiled
def _moved(start, stop, planes, face_start, incident, share, x):
    """x positions, flat as the planes; the sum of the ways to the planes counts by ``share``."""
    for i in range(np.uint64(start), np.uint64(stop)):
        own = THREE * i
        xi, yi, zi = x[own], x[own + ONE], x[own + TWO]
        sx = sy = sz = 0.0
        for at in range(np.uint64(face_start[i]), np.uint64(face_start[i + ONE])):
            f = FOUR * incident[at]
            nx, ny, nz = planes[f], planes[f + ONE], planes[f + TWO]
            height = planes[f + THREE] - (nx * xi + ny * yi + nz * zi)
            sx += height * nx
            sy += height * ny
            sz += height * nz
        x[own] = xi + share[i] * sx
        x[own + ONE] = yi + share[i] * sy
        x[own + TWO] = zi + share[i] * sz


def updated_vertices(
    vertices: Floats,
    normals: Floats,
    faces: Ints,
    links: Connectivity,
    free: Flags,
    passes: int,
    on_pass: Callable[[], object] | None = None,
) -> Floats:
    """Positions (n, 3) after ``passes`` passes from ``vertices`` (n, 3), which are not changed.

    Parameters
    ----------
    normals : (m, 3), the unit normals that the faces should have; faces whose normal is zero are
        left out.
    faces, links : (m, 3) and its neighbourhoods.
    free : (n,) bool, False for vertices that must stay.  One whose faces are all left out, or that
        has none, stays as well.
    on_pass : called after every pass; what it raises ends the run.
    """
    n, m = len(vertices), len(faces)
    planes = np.empty(4 * m)
    over_ranges(_planes, m, normals, planes.reshape(-1, 4))
    around = planes, links.face_start.view(np.uint32), links.incident_faces.view(np.uint32)
    share = np.empty(n)
    over_ranges(_shares, n, *around, free, share)
    corners = faces.reshape(-1).view(np.uint32)
    x = vertices.copy()
    for _ in range(passes):
        over_ranges(_offsets, m, x.reshape(-1), corners, planes)
        over_ranges(_moved, n, *around, share, x.reshape(-1))
        if on_pass is not None:
            on_pass()
    return x
