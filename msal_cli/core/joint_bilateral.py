"""Joint bilateral mean of face normals: weights by a guide that is less noisy than they are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.exponential import exponentials
from msal_cli.core.geometry import VANISHED
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
LongInts = NDArray[np.int64]


@compiled
def _filtered(  # type: ignore[no-untyped-def]
    start, stop, n, g, c, areas, near_start, near, per_distance, per_guide, result
):
    """n normals, g guides, c centroids; squares are multiplied with -1 / (2 sigma^2)."""
    widest = 0
    for i in range(start, stop):
        widest = max(widest, near_start[i + 1] - near_start[i])
    weights = np.empty(widest)
    scratch = np.empty(widest)
    bits = scratch.view(np.int64)
    for i in range(start, stop):
        row = near_start[i]
        count = near_start[i + 1] - row
        cx, cy, cz = c[i, 0], c[i, 1], c[i, 2]
        gx, gy, gz = g[i, 0], g[i, 1], g[i, 2]
        for at in range(count):
            j = near[row + at]
            dx, dy, dz = c[j, 0] - cx, c[j, 1] - cy, c[j, 2] - cz
            ex, ey, ez = g[j, 0] - gx, g[j, 1] - gy, g[j, 2] - gz
            weights[at] = per_distance * (dx * dx + dy * dy + dz * dz) + per_guide * (
                ex * ex + ey * ey + ez * ez
            )
        exponentials(weights, scratch, bits, count)
        total = areas[i]
        sx, sy, sz = total * n[i, 0], total * n[i, 1], total * n[i, 2]
        for at in range(count):
            j = near[row + at]
            weight = areas[j] * weights[at]
            sx += weight * n[j, 0]
            sy += weight * n[j, 1]
            sz += weight * n[j, 2]
            total += weight
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        if length <= VANISHED * total:
            result[i, 0], result[i, 1], result[i, 2] = n[i, 0], n[i, 1], n[i, 2]
        else:
            result[i, 0], result[i, 1], result[i, 2] = sx / length, sy / length, sz / length


def joint_bilateral(
    normals: Floats,
    guides: Floats,
    centroids: Floats,
    areas: Floats,
    near_start: LongInts,
    near: Ints,
    sigma_s: float,
    sigma_r: float,
) -> Floats:
    """Filtered unit face normals (m, 3): the normalised sums over j near i, and i itself, of

        A_j exp(-|c_i - c_j|^2 / (2 sigma_s^2)) exp(-|g_i - g_j|^2 / (2 sigma_r^2)) n_j.

    Parameters
    ----------
    normals, guides : (m, 3), n and g; zeros where there is none.
    centroids, areas : (m, 3) and (m,), c and A.
    near_start, near : rows of the faces near each face, itself left out.
    sigma_s : in the unit of the centroids, above zero.
    sigma_r : of guide differences, a pure number above zero.

    Where the sum vanishes the normal is kept.
    """
    result = np.empty_like(normals)
    over_ranges(
        _filtered,
        len(normals),
        normals,
        guides,
        centroids,
        areas,
        near_start,
        near,
        -0.5 / sigma_s**2,
        -0.5 / sigma_r**2,
        result,
    )
    return result
