"""Face normals that minimise the energy of the static/dynamic filter, by fixed-point iteration.

Zhang, Deng, Hong, Peng, Qin and Liu 2018.  With n the normals to find, n0 the given ones, g guides,
c centroids and A areas,

    E = sum_i A_i |n_i - n0_i|^2 + lambda' sum_ij w_ij (1 - exp(-|n_i - n_j|^2 / (2 nu^2))),
    w_ij = (A_i + A_j) exp(-|c_i - c_j|^2 / (2 eta^2)) exp(-|g_i - g_j|^2 / (2 mu^2)),

the second sum over pairs of near faces, and lambda' = lambda sum_i A_i / sum_ij (w_ij without its
last factor).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.elementary import exponentials
from msal_cli.kernels.geometry import VANISHED
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import longest_row


@compiled
def _weigh(start, stop, g, c, areas, near_start, near, per_distance, per_guide, weights, sums):
    """w of every row; ``sums``, by face, of w without its last factor."""
    widest = longest_row(start, stop, near_start)
    distant = np.empty(widest)
    unlike = np.empty(widest)
    scratch = np.empty(widest)
    bits = scratch.view(np.int64)
    for i in range(start, stop):
        row = near_start[i]
        count = near_start[i + 1] - row
        for at in range(count):
            j = near[row + at]
            dx, dy, dz = c[j, 0] - c[i, 0], c[j, 1] - c[i, 1], c[j, 2] - c[i, 2]
            ex, ey, ez = g[j, 0] - g[i, 0], g[j, 1] - g[i, 1], g[j, 2] - g[i, 2]
            distant[at] = per_distance * (dx * dx + dy * dy + dz * dz)
            unlike[at] = per_guide * (ex * ex + ey * ey + ez * ez)
        exponentials(distant, scratch, bits, count)
        exponentials(unlike, scratch, bits, count)
        total = 0.0
        for at in range(count):
            weight = (areas[i] + areas[near[row + at]]) * distant[at]
            total += weight
            weights[row + at] = weight * unlike[at]
        sums[i] = total


def pair_weights(
    guides: Floats,
    centroids: Floats,
    areas: Floats,
    near_start: Longs,
    near: Ints,
    eta: float,
    mu: float,
) -> tuple[Floats, float]:
    """w (k,) for the rows ``near`` (k,), and lambda' / lambda.

    Parameters
    ----------
    guides, centroids, areas : (m, 3), (m, 3) and (m,).
    near_start, near : rows of the faces near each face, itself left out.
    eta : in the unit of the centroids, above zero.
    mu : a pure number, above zero.

    lambda' / lambda is zero where no faces are near one another.
    """
    weights = np.empty(len(near))
    sums = np.empty(len(areas))
    rows = near_start, near, -0.5 / eta**2, -0.5 / mu**2
    over_ranges(_weigh, len(areas), guides, centroids, areas, *rows, weights, sums)
    # Every pair is in two rows.
    total = float(sums.sum()) / 2.0
    return weights, float(areas.sum()) / total if total > 0.0 else 0.0


@compiled
def _step(start, stop, n, pull, near_start, near, weights, per_difference, areas, result, changes):
    """pull (m, 3) is 2 nu^2 / lambda' A n0; ``changes`` are A |step|^2."""
    widest = longest_row(start, stop, near_start)
    kernel = np.empty(widest)
    others = np.empty((widest, 3))
    scratch = np.empty(widest)
    bits = scratch.view(np.int64)
    for i in range(start, stop):
        row = near_start[i]
        count = near_start[i + 1] - row
        nx, ny, nz = n[i, 0], n[i, 1], n[i, 2]
        for at in range(count):
            # Unsigned, so that no index is looked at for being negative.
            j = np.uint64(near[row + at])
            ox, oy, oz = n[j, 0], n[j, 1], n[j, 2]
            others[at, 0], others[at, 1], others[at, 2] = ox, oy, oz
            dx, dy, dz = ox - nx, oy - ny, oz - nz
            kernel[at] = per_difference * (dx * dx + dy * dy + dz * dz)
        exponentials(kernel, scratch, bits, count)
        sx, sy, sz = pull[i, 0], pull[i, 1], pull[i, 2]
        total = abs(sx) + abs(sy) + abs(sz)
        for at in range(count):
            weight = weights[row + at] * kernel[at]
            sx += weight * others[at, 0]
            sy += weight * others[at, 1]
            sz += weight * others[at, 2]
            total += weight
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        if length <= VANISHED * total:
            result[i, 0], result[i, 1], result[i, 2] = nx, ny, nz
            changes[i] = 0.0
        else:
            sx, sy, sz = sx / length, sy / length, sz / length
            result[i, 0], result[i, 1], result[i, 2] = sx, sy, sz
            dx, dy, dz = sx - nx, sy - ny, sz - nz
            changes[i] = areas[i] * (dx * dx + dy * dy + dz * dz)


def minimising_normals(
    normals: Floats,
    areas: Floats,
    near_start: Longs,
    near: Ints,
    weights: Floats,
    strength: float,
    nu: float,
    tolerance: float,
    most_steps: int,
    on_step: Callable[[], object] | None = None,
) -> Floats:
    """Unit normals (m, 3) near a minimum of E, from ``normals`` (m, 3), which are n0.

    Each step replaces all normals at once by the normalised sums

        2 nu^2 / lambda' A_i n0_i + sum_j w_ij exp(-|n_i - n_j|^2 / (2 nu^2)) n_j.

    Parameters
    ----------
    areas : (m,).
    near_start, near, weights : rows of the faces near each face, and w, (m + 1,), (k,) and (k,).
    strength : lambda'; zero for none, which returns the normals.
    nu : a pure number, above zero.
    tolerance : the steps end when the root of the area-weighted mean square of the changes of
        normals is at most this.
    most_steps : the steps end here at the latest.
    on_step : called after every step; what it raises ends the run.

    Where a sum vanishes the normal is kept.
    """
    if strength == 0.0:
        return normals.copy()
    pull = (2.0 * nu**2 / strength * areas)[:, None] * normals
    changes = np.empty(len(normals))
    goal = float(areas.sum()) * tolerance**2
    result, following = normals.copy(), np.empty_like(normals)
    for _ in range(most_steps):
        rows = near_start, near, weights, -0.5 / nu**2, areas
        over_ranges(_step, len(normals), result, pull, *rows, following, changes)
        result, following = following, result
        if on_step is not None:
            on_step()
        # In one thread and over one array, numpy's sum has a fixed order.
        if float(changes.sum()) <= goal:
            break
    return result
