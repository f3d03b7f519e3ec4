"""Bilateral weights between neighbouring faces, and face normals averaged by them.

Zheng, Fu, Au and Tai 2011: with centroids c, areas A and unit normals n of the faces

    w_ij = A_j exp(-|c_i - c_j|^2 / (2 sigma_c^2)) exp(-|n_i - n_j|^2 / (2 sigma_s^2)).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.exponential import exponentials
from msal_cli.core.geometry import VANISHED
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

BLOCK_PAIRS = 1024
"""Pairs of faces that are worked on at a time: what belongs to them fits a first-level cache."""

OUT_OF_REACH = 1e300
"""Exponent of a neighbour that must not count; finite, so that differences are numbers."""


@compiled
def _distances(start, stop, centroids, falloff, handicaps, ring_start, ring, exponents):  # type: ignore[no-untyped-def]
    for f in range(start, stop):
        for at in range(ring_start[f], ring_start[f + 1]):
            g = ring[at]
            dx = centroids[g, 0] - centroids[f, 0]
            dy = centroids[g, 1] - centroids[f, 1]
            dz = centroids[g, 2] - centroids[f, 2]
            exponents[at] = (dx * dx + dy * dy + dz * dz) * falloff + handicaps[g]


def distance_exponents(
    centroids: Floats, ring_start: Ints, ring: Ints, closeness: float, handicaps: Floats
) -> Floats:
    """|c_i - c_j|^2 / (2 sigma_c^2) + handicap_j of all pairs in the rows, (pairs,).

    ``closeness`` is sigma_c > 0, in the unit of the centroids (m, 3); ``handicaps`` are (m,).
    """
    exponents = np.empty(len(ring))
    over_ranges(
        _distances,
        len(centroids),
        centroids,
        0.5 / closeness**2,
        handicaps,
        ring_start,
        ring,
        exponents,
    )
    return exponents


@compiled
def _averaged(start, stop, normals, exponents, falloff, ring_start, ring, result):  # type: ignore[no-untyped-def]
    """Faces are taken in blocks: the exponents of all, all exponentials, then the sums."""
    widest = 0
    for f in range(start, stop):
        widest = max(widest, ring_start[f + 1] - ring_start[f])
    capacity = max(BLOCK_PAIRS, widest)
    weight = np.empty(capacity)
    scratch = np.empty(capacity)
    scratch_bits = scratch.view(np.int64)
    f = start
    while f < stop:
        first = f
        origin = ring_start[f]
        while f < stop and ring_start[f + 1] - origin <= capacity:
            nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
            least = np.inf
            for at in range(ring_start[f], ring_start[f + 1]):
                g = ring[at]
                # |n_f - n_g|^2 = 2 - 2 n_f . n_g of unit vectors.
                alike = nx * normals[g, 0] + ny * normals[g, 1] + nz * normals[g, 2]
                exponent = exponents[at] + (1.0 - alike) * falloff
                weight[at - origin] = exponent
                least = exponent if exponent < least else least
            # The largest Gaussian is made 1: the direction of the sum stays the same, and the
            # sum cannot vanish by underflow.
            for at in range(ring_start[f], ring_start[f + 1]):
                weight[at - origin] = least - weight[at - origin]
            f += 1
        exponentials(weight, scratch, scratch_bits, ring_start[f] - origin)
        for i in range(first, f):
            sx = sy = sz = weights = 0.0
            for at in range(ring_start[i], ring_start[i + 1]):
                g = ring[at]
                w = weight[at - origin]
                weights += w
                sx += w * normals[g, 0]
                sy += w * normals[g, 1]
                sz += w * normals[g, 2]
            length = np.sqrt(sx * sx + sy * sy + sz * sz)
            has_normal = normals[i, 0] != 0.0 or normals[i, 1] != 0.0 or normals[i, 2] != 0.0
            if has_normal and length > VANISHED * weights:
                result[i, 0] = sx / length
                result[i, 1] = sy / length
                result[i, 2] = sz / length
            else:
                result[i, 0] = normals[i, 0]
                result[i, 1] = normals[i, 1]
                result[i, 2] = normals[i, 2]


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
    usable = (normals != 0.0).any(axis=1) & (areas > 0.0)
    handicaps = np.full(len(areas), OUT_OF_REACH)
    handicaps[usable] = -np.log(areas[usable])
    exponents = distance_exponents(centroids, ring_start, ring, closeness, handicaps)
    falloff = 1.0 / similarity**2
    for _ in range(passes):
        result = np.empty_like(normals)
        over_ranges(_averaged, len(normals), normals, exponents, falloff, ring_start, ring, result)
        normals = result
        on_pass()
    return normals
