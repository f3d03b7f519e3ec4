"""Joint bilateral mean of face normals: weights by a guide that is less noisy than they are."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.exponential import LOG2_E, power_of_two
from msal_cli.kernels.geometry import VANISHED
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, most_neighbours

BLOCK_PAIRS = np.uint64(1024)
"""Pairs of faces that are worked on at a time: what belongs to them fits a first-level cache."""


@compiled
def _filtered(start, stop, n, g, c, areas, near_start, near, per_distance, per_guide, result):
    """n normals, g guides, c centroids, flat; squares are multiplied with -1 / (2 sigma^2 ln 2).

    Faces are taken in blocks: the exponents of all, then all powers as vector code, then the sums.
    All indices are unsigned, so that none is looked at for its sign.
    """
    stop = np.uint64(stop)
    weight = np.empty(np.int64(max(BLOCK_PAIRS, most_neighbours(start, stop, near_start))))
    area = np.empty_like(weight)
    capacity = np.uint64(len(weight))
    i = np.uint64(start)
    while i < stop:
        first = i
        origin = np.uint64(near_start[i])
        while i < stop and near_start[i + ONE] - origin <= capacity:
            own = THREE * i
            cx, cy, cz = c[own], c[own + ONE], c[own + TWO]
            gx, gy, gz = g[own], g[own + ONE], g[own + TWO]
            for at in range(near_start[i], near_start[i + ONE]):
                k = np.uint64(near[at])
                j = THREE * k
                dx, dy, dz = c[j] - cx, c[j + ONE] - cy, c[j + TWO] - cz
                ex, ey, ez = g[j] - gx, g[j + ONE] - gy, g[j + TWO] - gz
                weight[at - origin] = per_distance * (dx * dx + dy * dy + dz * dz) + per_guide * (
                    ex * ex + ey * ey + ez * ez
                )
                area[at - origin] = areas[k]
            i += ONE
        for at in range(near_start[i] - origin):
            weight[at] = area[at] * power_of_two(weight[at])
        for f in range(first, i):
            own = THREE * f
            total = areas[f]
            nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
            sx, sy, sz = total * nx, total * ny, total * nz
            for at in range(near_start[f], near_start[f + ONE]):
                j = THREE * near[at]
                w = weight[at - origin]
                sx += w * n[j]
                sy += w * n[j + ONE]
                sz += w * n[j + TWO]
                total += w
            length = np.sqrt(sx * sx + sy * sy + sz * sz)
            if length > VANISHED * total:
                nx, ny, nz = sx / length, sy / length, sz / length
            result[own], result[own + ONE], result[own + TWO] = nx, ny, nz


def joint_bilateral(
    normals: Floats,
    guides: Floats,
    centroids: Floats,
    areas: Floats,
    near_start: Longs,
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
        normals.reshape(-1),
        guides.reshape(-1),
        centroids.reshape(-1),
        areas,
        near_start.view(np.uint64),
        near.view(np.uint32),
        -0.5 * LOG2_E / sigma_s**2,
        -0.5 * LOG2_E / sigma_r**2,
        result.reshape(-1),
    )
    return result
