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
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.connectivity import Connectivity
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Flags = NDArray[np.bool_]


@compiled
def _offsets(start, stop, x, faces, planes):  # type: ignore[no-untyped-def]
    """x positions; a plane is its normal n' and n' . c, in this order."""
    for f in range(start, stop):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        offset = 0.0
        for axis in range(3):
            corner = x[a, axis]
            # In this way the centroid of equal coordinates is just these.
            middle = corner + ((x[b, axis] - corner) + (x[c, axis] - corner)) / 3.0
            offset += planes[f, axis] * middle
        planes[f, 3] = offset


@compiled
def _moved(start, stop, planes, face_start, incident, share, x):  # type: ignore[no-untyped-def]
    """x positions; the sum of the ways to the planes counts by ``share``."""
    for i in range(start, stop):
        xi, yi, zi = x[i, 0], x[i, 1], x[i, 2]
        sx = sy = sz = 0.0
        for at in range(face_start[i], face_start[i + 1]):
            f = incident[at]
            nx, ny, nz = planes[f, 0], planes[f, 1], planes[f, 2]
            height = planes[f, 3] - (nx * xi + ny * yi + nz * zi)
            sx += height * nx
            sy += height * ny
            sz += height * nz
        x[i, 0] = xi + share[i] * sx
        x[i, 1] = yi + share[i] * sy
        x[i, 2] = zi + share[i] * sz


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
    planes = np.zeros((m, 4))
    planes[:, :3] = normals
    counted = faces[(normals != 0.0).any(axis=1)]
    count = np.bincount(counted.reshape(-1), minlength=n)
    share = np.where(free & (count > 0), 1.0 / np.maximum(count, 1), 0.0)
    x = vertices.copy()
    for _ in range(passes):
        over_ranges(_offsets, m, x, faces, planes)
        over_ranges(_moved, n, planes, links.face_start, links.incident_faces, share, x)
        if on_pass is not None:
            on_pass()
    return x
