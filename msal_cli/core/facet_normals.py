"""Normals of facets, as STL stores them, after vertices moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.geometry import DEGENERATE
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@compiled
def _normal(vertices, a, b, c):  # type: ignore[no-untyped-def]
    """Unit normal of a triangle by the right-hand rule, zeros if it is degenerate."""
    ux = vertices[b, 0] - vertices[a, 0]
    uy = vertices[b, 1] - vertices[a, 1]
    uz = vertices[b, 2] - vertices[a, 2]
    wx = vertices[c, 0] - vertices[a, 0]
    wy = vertices[c, 1] - vertices[a, 1]
    wz = vertices[c, 2] - vertices[a, 2]
    nx = uy * wz - uz * wy
    ny = uz * wx - ux * wz
    nz = ux * wy - uy * wx
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    vx, vy, vz = wx - ux, wy - uy, wz - uz
    longest = max(
        ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz, vx * vx + vy * vy + vz * vz
    )
    if not length > DEGENERATE * longest or not length < np.inf:
        return 0.0, 0.0, 0.0
    return nx / length, ny / length, nz / length


@compiled
def renewed_normal(old, new, a, b, c, sx, sy, sz):  # type: ignore[no-untyped-def]
    """The normal of a facet whose corners a, b, c moved, and whether it replaces the stored one,
    (sx, sy, sz); see ``renewed_facet_normals``."""
    largest = max(abs(sx), abs(sy), abs(sz))
    # A sum, because NaN disappears in a maximum.
    if not largest > 0.0 or not abs(sx) + abs(sy) + abs(sz) < np.inf:
        return sx, sy, sz, False
    nx, ny, nz = _normal(new, a, b, c)
    if nx == 0.0 and ny == 0.0 and nz == 0.0:
        return sx, sy, sz, False
    ox, oy, oz = _normal(old, a, b, c)
    # Scaled, so that neither tiny nor huge stored normals spoil the sign.
    sense = 1.0
    if sx / largest * ox + sy / largest * oy + sz / largest * oz < 0.0:
        sense = -1.0
    # The sum makes a plain zero of a negative one.
    return sense * nx + 0.0, sense * ny + 0.0, sense * nz + 0.0, True


@compiled
def has_moved(old, new, a, b, c):  # type: ignore[no-untyped-def]
    """Whether any coordinate of the vertices a, b, c is another."""
    for k in range(3):
        if old[a, k] != new[a, k] or old[b, k] != new[b, k] or old[c, k] != new[c, k]:
            return True
    return False


@compiled
def _renewed(start, stop, old, new, faces, normals, changed):  # type: ignore[no-untyped-def]
    for f in range(start, stop):
        changed[f] = False
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if has_moved(old, new, a, b, c):
            nx, ny, nz, changed[f] = renewed_normal(
                old, new, a, b, c, normals[f, 0], normals[f, 1], normals[f, 2]
            )
            if changed[f]:
                normals[f, 0] = nx
                normals[f, 1] = ny
                normals[f, 2] = nz


def renewed_facet_normals(
    old: Floats, new: Floats, faces: Ints, normals: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Stored facet normals after vertices moved.

    Parameters
    ----------
    old, new : (n, 3), the vertices before and after, file units.
    faces : (m, 3), the corners of each facet.
    normals : (m, 3) as stored, of any length, not finite where the file has no number.

    Returns
    -------
    normals : (m, 3).  A facet with a corner that moved gets the unit normal of its new corners by
        the right-hand rule, reversed if the stored one opposed the old corners.  A facet whose
        stored normal is zero (exporters leave the choice to the reader) or not finite, and one
        that has no area any more, keeps what it has.
    changed : (m,) bool, which normals are new.
    """
    result = np.array(normals, dtype=np.float64)
    changed = np.empty(len(result), dtype=np.bool_)
    over_ranges(_renewed, len(result), old, new, faces, result, changed)
    return result, changed
