"""Normals of facets that share nothing, as STL stores them, after their corners moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.geometry import DEGENERATE
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]


@compiled
def _normal(corners, f):  # type: ignore[no-untyped-def]
    """Unit normal of facet f by the right-hand rule, zeros if it is degenerate."""
    ux = corners[f, 3] - corners[f, 0]
    uy = corners[f, 4] - corners[f, 1]
    uz = corners[f, 5] - corners[f, 2]
    wx = corners[f, 6] - corners[f, 0]
    wy = corners[f, 7] - corners[f, 1]
    wz = corners[f, 8] - corners[f, 2]
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
def _renewed(start, stop, old, new, normals, changed):  # type: ignore[no-untyped-def]
    for f in range(start, stop):
        changed[f] = False
        moved = False
        for k in range(9):
            moved = moved or old[f, k] != new[f, k]
        if not moved:
            continue
        sx, sy, sz = normals[f, 0], normals[f, 1], normals[f, 2]
        largest = max(abs(sx), abs(sy), abs(sz))
        # A sum, because NaN disappears in a maximum.
        if not largest > 0.0 or not abs(sx) + abs(sy) + abs(sz) < np.inf:
            continue
        nx, ny, nz = _normal(new, f)
        if nx == 0.0 and ny == 0.0 and nz == 0.0:
            continue
        ox, oy, oz = _normal(old, f)
        # Scaled, so that neither tiny nor huge stored normals spoil the sign.
        sense = 1.0
        if sx / largest * ox + sy / largest * oy + sz / largest * oz < 0.0:
            sense = -1.0
        # The sum makes a plain zero of a negative one.
        normals[f, 0] = sense * nx + 0.0
        normals[f, 1] = sense * ny + 0.0
        normals[f, 2] = sense * nz + 0.0
        changed[f] = True


def renewed_facet_normals(
    old: Floats, new: Floats, normals: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Stored facet normals after corners moved.

    Parameters
    ----------
    old, new : (m, 9), the three corners of each facet before and after, file units.
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
    over_ranges(_renewed, len(result), old, new, result, changed)
    return result, changed
