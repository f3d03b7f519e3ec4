"""Face normals averaged with those of faces around, by weights that favour similar ones.

Bilateral (Zheng, Fu, Au and Tai 2011): with centroids c, areas A and unit normals n of the faces

    w_ij = A_j exp(-|c_i - c_j|^2 / (2 sigma_c^2)) exp(-|n_i - n_j|^2 / (2 sigma_s^2));

joint bilateral: by differences of guides that are less noisy than the normals; and with a
threshold (Sun et al. 2007): by how far the cosine between normals is above it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import Kernel, compiled
from msal_cli.kernels.elementary import LOG2_E, power_of_two
from msal_cli.kernels.geometry import VANISHED, usable_areas
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, most_neighbours
from msal_cli.kernels.vectors import write_unit

BLOCK_PAIRS = np.uint64(1024)
"""Pairs of faces that are worked on at a time: what belongs to them fits a first-level cache."""

OUT_OF_REACH = 1e300
"""Exponent of a neighbour that must not count; finite, so that differences are numbers."""


@compiled
def _distances(start, stop, c, falloff, handicaps, ring_start, ring, exponents):
    """c centroids, flat; rows and numbers are unsigned, so that none is looked at for its sign."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = THREE * f
        x, y, z = c[own], c[own + ONE], c[own + TWO]
        for at in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
            g = np.uint64(ring[at])
            other = THREE * g
            dx, dy, dz = c[other] - x, c[other + ONE] - y, c[other + TWO] - z
            exponents[at] = (dx * dx + dy * dy + dz * dz) * falloff + handicaps[g]


def distance_exponents(
    centroids: Floats, ring_start: Ints, ring: Ints, closeness: float, handicaps: Floats
) -> Floats:
    """|c_i - c_j|^2 / (2 sigma_c^2 ln 2) + handicap_j of all pairs in the rows, (pairs,).

    2 to minus them are the Gaussians, if all handicaps are zero.  ``closeness`` is sigma_c > 0,
    in the unit of the centroids (m, 3); ``handicaps`` are (m,).
    """
    exponents = np.empty(len(ring))
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    falloff = 0.5 * LOG2_E / closeness**2
    flat = centroids.reshape(-1), falloff, handicaps
    over_ranges(_distances, len(centroids), *flat, *rows, exponents)
    return exponents


@compiled
def _average_bilaterally(start, stop, n, exponents, falloff, ring_start, ring, result):
    """n normals, flat as the result; exponents and ``falloff`` are those of powers of two.

    Faces are taken in blocks: the exponents of all, then all powers as vector code, then the sums.
    """
    stop = np.uint64(stop)
    weight = np.empty(np.int64(max(BLOCK_PAIRS, most_neighbours(start, stop, ring_start))))
    capacity = np.uint64(len(weight))
    f = np.uint64(start)
    while f < stop:
        first = f
        origin = np.uint64(ring_start[f])
        while f < stop and np.uint64(ring_start[f + ONE]) - origin <= capacity:
            own = THREE * f
            nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
            row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
            least = np.inf
            for at in range(row, end):
                g = THREE * ring[at]
                # |n_f - n_g|^2 = 2 - 2 n_f . n_g of unit vectors.
                alike = nx * n[g] + ny * n[g + ONE] + nz * n[g + TWO]
                exponent = exponents[at] + (1.0 - alike) * falloff
                weight[at - origin] = exponent
                least = min(least, exponent)
            # The largest Gaussian is made 1: the direction of the sum stays the same, and the
            # sum cannot vanish by underflow.
            for at in range(row, end):
                weight[at - origin] = least - weight[at - origin]
            f += ONE
        for at in range(np.uint64(ring_start[f]) - origin):
            weight[at] = power_of_two(weight[at])
        for i in range(first, f):
            sx = sy = sz = weights = 0.0
            for at in range(np.uint64(ring_start[i]), np.uint64(ring_start[i + ONE])):
                g = THREE * ring[at]
                w = weight[at - origin]
                weights += w
                sx += w * n[g]
                sy += w * n[g + ONE]
                sz += w * n[g + TWO]
            own = THREE * i
            has_normal = n[own] != 0.0 or n[own + ONE] != 0.0 or n[own + TWO] != 0.0
            least = VANISHED * weights if has_normal else np.inf
            write_unit(sx, sy, sz, least, n, i, result)


def bilateral_averages(
    normals: Floats,
    areas: Floats,
    centroids: Floats,
    ring_start: Ints,
    ring: Ints,
    closeness: float,
    similarity: float,
    passes: int,
    on_pass: Callable[[], object],
) -> Floats:
    """Unit normals (m, 3) after ``passes`` passes, each from the normals that the one before left.

    n'_i is the normalised sum of w_ij n_j over the neighbours, n_i itself left out; areas and
    distances stay those of the input.  Where a face has no neighbours, or the sum vanishes, it
    keeps its normal.  Zero normals stay zero and do not count.

    Parameters
    ----------
    normals, areas : (m, 3) unit normals, zeros for faces without, and (m,), any unit.
    centroids : (m, 3), file units.
    ring_start, ring : rows of neighbouring faces.
    closeness : sigma_c > 0, file units.
    similarity : sigma_s > 0, a length of differences of unit normals.
    on_pass : called after every pass; what it raises ends the run.
    """
    with np.errstate(divide="ignore"):
        handicaps = -np.log2(usable_areas(normals, areas))
    np.minimum(handicaps, OUT_OF_REACH, out=handicaps)
    exponents = distance_exponents(centroids, ring_start, ring, closeness, handicaps)
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    known = exponents, LOG2_E / similarity**2, *rows
    return _repeat(_average_bilaterally, normals, known, passes, on_pass)


def _repeat(
    kernel: Kernel,
    normals: Floats,
    known: tuple[object, ...],
    passes: int,
    on_pass: Callable[[], object],
) -> Floats:
    given = spare = normals
    for _ in range(passes):
        # The input must stay as it is; from the third pass on, two arrays take turns.
        result = np.empty_like(normals) if spare is given else spare
        over_ranges(kernel, len(normals), normals.reshape(-1), *known, result.reshape(-1))
        normals, spare = result, normals
        on_pass()
    return normals


@compiled
def _average_jointly(
    start, stop, n, g, c, areas, near_start, near, per_distance, per_guide, result
):
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
            write_unit(sx, sy, sz, VANISHED * total, n, f, result)


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
    flat = normals.reshape(-1), guides.reshape(-1), centroids.reshape(-1)
    rows = near_start.view(np.uint64), near.view(np.uint32)
    factors = -0.5 * LOG2_E / sigma_s**2, -0.5 * LOG2_E / sigma_r**2
    known = *flat, areas, *rows, *factors
    over_ranges(_average_jointly, len(normals), *known, result.reshape(-1))
    return result


@compiled
def _average_similar(start, stop, n, threshold, ring_start, ring, result):
    """n normals, flat as the result; indices are unsigned, and not looked at for their sign."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = THREE * f
        nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
        weights = (1.0 - threshold) * (1.0 - threshold)
        sx, sy, sz = weights * nx, weights * ny, weights * nz
        for at in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
            g = THREE * ring[at]
            mx, my, mz = n[g], n[g + ONE], n[g + TWO]
            above = nx * mx + ny * my + nz * mz - threshold
            above = above if above > 0.0 else 0.0
            weight = above * above
            weights += weight
            sx += weight * mx
            sy += weight * my
            sz += weight * mz
        # A face without a normal finds none: a product of zero is below any threshold.
        write_unit(sx, sy, sz, VANISHED * weights, n, f, result)


def threshold_averages(
    normals: Floats,
    ring_start: Ints,
    ring: Ints,
    threshold: float,
    passes: int,
    on_pass: Callable[[], object],
) -> Floats:
    """Unit normals (m, 3) after ``passes`` passes, each from the normals that the one before left.

    n'_i is the normalised sum of max(0, n_i . n_j - threshold)^2 n_j over face i itself and its
    neighbours.  Zero normals stay zero and do not count.

    Parameters
    ----------
    normals : (m, 3) unit normals, zeros for faces without; not changed.
    ring_start, ring : rows of neighbouring faces.
    threshold : 0 <= threshold < 1, a cosine.
    on_pass : called after every pass; what it raises ends the run.
    """
    known = threshold, ring_start.view(np.uint32), ring.view(np.uint32)
    return _repeat(_average_similar, normals, known, passes, on_pass)
