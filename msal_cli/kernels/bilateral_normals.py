"""Bilateral weights between neighbouring faces, and face normals averaged by them.

Zheng, Fu, Au and Tai 2011: with centroids c, areas A and unit normals n of the faces

    w_ij = A_j exp(-|c_i - c_j|^2 / (2 sigma_c^2)) exp(-|n_i - n_j|^2 / (2 sigma_s^2)).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.exponential import LOG2_E, power_of_two
from msal_cli.kernels.geometry import VANISHED, usable_areas
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, most_neighbours

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
    over_ranges(
        _distances,
        len(centroids),
        centroids.reshape(-1),
        0.5 * LOG2_E / closeness**2,
        handicaps,
        ring_start.view(np.uint32),
        ring.view(np.uint32),
        exponents,
    )
    return exponents


@compiled
def _averaged(start, stop, n, exponents, falloff, ring_start, ring, result):
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
            length = np.sqrt(sx * sx + sy * sy + sz * sz)
            own = THREE * i
            nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
            has_normal = nx != 0.0 or ny != 0.0 or nz != 0.0
            if has_normal and length > VANISHED * weights:
                nx, ny, nz = sx / length, sy / length, sz / length
            result[own], result[own + ONE], result[own + TWO] = nx, ny, nz


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
    falloff = LOG2_E / similarity**2
    given = spare = normals
    for _ in range(passes):
        # The input must stay as it is; from the third pass on, two arrays take turns.
        result = np.empty_like(normals) if spare is given else spare
        flat = normals.reshape(-1), exponents, falloff, *rows, result.reshape(-1)
        over_ranges(_averaged, len(normals), *flat)
        normals, spare = result, normals
        on_pass()
    return normals
