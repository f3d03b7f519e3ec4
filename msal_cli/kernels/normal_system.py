"""The global bilateral filter of face normals: one sparse linear system (Zheng et al. 2011).

With the bilateral weights w_ij between a face and its neighbours, and M = I - W the difference
between a normal and the weighted mean around it, W = w_ij / sum_j w_ij, the normals that minimise

    (1 - lambda) |M n'|^2 + lambda |n' - n|^2

solve ((1 - lambda) M^T M + lambda I) n' = lambda n.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.elementary import LOG2_E, power_of_two
from msal_cli.kernels.normal_averages import distance_exponents
from msal_cli.kernels.parallel import over_ranges

ALONE = 1e-200
"""A face whose neighbours weigh less, in mean face areas, is taken as one without neighbours."""


@compiled
def _gaussians(start, stop, normals, areas, falloff, ring_start, ring, values, totals):
    """Turn distance exponents into w_ij / A_j, which is symmetric; sum up w_ij for every i."""
    for f in range(start, stop):
        for at in range(ring_start[f], ring_start[f + 1]):
            g = ring[at]
            alike = (
                normals[f, 0] * normals[g, 0]
                + normals[f, 1] * normals[g, 1]
                + normals[f, 2] * normals[g, 2]
            )
            values[at] = min(0.0, (alike - 1.0) * falloff - values[at])
    for at in range(np.uint64(ring_start[start]), np.uint64(ring_start[stop])):
        values[at] = power_of_two(values[at])
    for f in range(start, stop):
        total = 0.0
        for at in range(ring_start[f], ring_start[f + 1]):
            total += values[at] * areas[ring[at]]
        totals[f] = total


@compiled
def _diagonal(start, stop, areas, inverse, ring_start, ring, values, squares):
    for f in range(start, stop):
        total = 0.0
        for at in range(ring_start[f], ring_start[f + 1]):
            share = values[at] * inverse[ring[at]] * areas[f]
            total += share * share
        squares[f] = total


@compiled
def _differences(
    start, stop, values, ring_start, ring, inner, outer, own, x, weight, base, base_weight, result
):
    """weight (own_i x_i - outer_i sum_j values_ij inner_j x_j) + base_weight base_i."""
    for i in range(start, stop):
        sx = sy = sz = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            value = values[at] * inner[k]
            sx += value * x[k, 0]
            sy += value * x[k, 1]
            sz += value * x[k, 2]
        factor = outer[i]
        result[i, 0] = weight * (own[i] * x[i, 0] - factor * sx) + base_weight * base[i, 0]
        result[i, 1] = weight * (own[i] * x[i, 1] - factor * sy) + base_weight * base[i, 1]
        result[i, 2] = weight * (own[i] * x[i, 2] - factor * sz) + base_weight * base[i, 2]


@dataclass(frozen=True, eq=False)
class NormalSystem:
    """The matrix (1 - lambda) M^T M + lambda I, symmetric and positive definite.

    Attributes
    ----------
    ring_start, ring : rows of neighbouring faces, j among those of i where i is among those of j.
    values : (pairs,), w_ij / A_j.
    areas, inverse : (m,), A_j and 1 / sum_j w_ij, both zero for a face without a normal; the second
        is zero for a face without neighbours as well, for which M n' is zero.
    own : (m,), 1 where ``inverse`` is not zero, else 0: the diagonal of M.
    fidelity : lambda, 0 < lambda <= 1.
    diagonal : (m,).
    """

    ring_start: Ints
    ring: Ints
    values: Floats
    areas: Floats
    inverse: Floats
    own: Floats
    fidelity: float
    diagonal: Floats

    def times(self, x: Floats, product: Floats) -> None:
        """Write A x into ``product``; both (m, 3), not the same array."""
        rows = (self.values, self.ring_start, self.ring)
        difference = np.empty_like(x)
        m = len(x)
        over_ranges(
            _differences, m, *rows, self.areas, self.inverse, self.own, x, 1.0, x, 0.0, difference
        )
        # The transpose has the two factors of the symmetric part in the other order.
        over_ranges(
            _differences,
            m,
            *rows,
            self.inverse,
            self.areas,
            self.own,
            difference,
            1.0 - self.fidelity,
            x,
            self.fidelity,
            product,
        )


def normal_system(
    normals: Floats,
    areas: Floats,
    centroids: Floats,
    ring_start: Ints,
    ring: Ints,
    closeness: float,
    similarity: float,
    fidelity: float,
) -> NormalSystem:
    """The system for unit face normals (m, 3), zeros for faces without, and areas (m,).

    Parameters
    ----------
    centroids : (m, 3), file units.
    ring_start, ring : rows of neighbouring faces.
    closeness : sigma_c > 0, file units.
    similarity : sigma_s > 0, a length of differences of unit normals.
    fidelity : lambda, 0 < lambda <= 1.
    """
    m = len(normals)
    usable = (normals != 0.0).any(axis=1)
    relative = np.where(usable, areas, 0.0)
    mean = float(relative.mean())
    relative /= mean if mean > 0.0 else 1.0
    values = distance_exponents(centroids, ring_start, ring, closeness, np.zeros(m))
    totals = np.empty(m)
    rows = ring_start, ring, values
    falloff = LOG2_E / similarity**2
    over_ranges(_gaussians, m, normals, relative, falloff, *rows, totals)
    linked = usable & (totals > ALONE)
    inverse = np.where(linked, 1.0 / np.where(linked, totals, 1.0), 0.0)
    own = linked.astype(np.float64)
    squares = np.empty(m)
    over_ranges(_diagonal, m, relative, inverse, ring_start, ring, values, squares)
    diagonal = (1.0 - fidelity) * (own + squares) + fidelity
    return NormalSystem(ring_start, ring, values, relative, inverse, own, fidelity, diagonal)
