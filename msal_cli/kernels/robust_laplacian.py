"""The anisotropic Laplacian with other weights, other scales, and scaled for irregular meshes.

A second kernel beside ``kernels.operators``: that one is the paper's eq. (5) and made for speed,
this one has the choices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.cotangent import ring_areas
from msal_cli.kernels.elementary import exponentials
from msal_cli.kernels.operators import SMALLEST_LENGTH, SMALLEST_SIGMA, Step
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import longest_row

WEIGHTS = ("gauss", "tukey", "lorentz", "huber", "none")
DEVIATIONS = ("mean", "median")
SCALINGS = ("none", "mass", "edge")

_GAUSS, _TUKEY, _LORENTZ, _HUBER, _NONE = range(len(WEIGHTS))
_MEAN, _MEDIAN = range(len(DEVIATIONS))
_UNSCALED, _MASS, _EDGE = range(len(SCALINGS))

PER_MEDIAN = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""


@compiled
def _median(values, count):
    """Median of ``values[:count]``, which are sorted on the way, by Shell's method.

    A one-ring is sorted by insertion in effect; the gaps keep a hub of 50,000 affordable.
    """
    gap = 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for at in range(gap, count):
            value = values[at]
            hole = at
            while hole >= gap and values[hole - gap] > value:
                values[hole] = values[hole - gap]
                hole -= gap
            values[hole] = value
        gap //= 3
    middle = count // 2
    if count % 2:
        return values[middle]
    return 0.5 * (values[middle - 1] + values[middle])


@compiled
def _sigma(h, m, deviation, scratch):
    """Twice the mean, or 1.4826 times the median absolute deviation of the heights h[:m]."""
    if deviation == _MEDIAN:
        for at in range(m):
            scratch[at] = h[at]
        centre = _median(scratch, m)
        for at in range(m):
            scratch[at] = abs(h[at] - centre)
        return PER_MEDIAN * _median(scratch, m)
    total = 0.0
    for at in range(m):
        total += h[at]
    centre = total / m
    total = 0.0
    for at in range(m):
        total += abs(h[at] - centre)
    return 2.0 * total / m


@compiled
def _weigh(h, lengths, m, weights, sigma, g, scratch, scratch_bits):
    """g(h[:m]), up to a factor; all alike where every neighbour is beyond Tukey's reach."""
    if weights == _GAUSS:
        flattest = np.inf
        for at in range(m):
            if lengths[at] > 0.0:
                flattest = min(flattest, h[at] * h[at])
        inverse = 0.5 / (sigma * sigma)
        for at in range(m):
            # Where the edge has no length the height is zero and the weight is not used.
            g[at] = min((flattest - h[at] * h[at]) * inverse, 0.0)
        exponentials(g, scratch, scratch_bits, m)
        return
    if weights == _TUKEY:
        reach = 5.0 * sigma * sigma
        total = 0.0
        for at in range(m):
            rest = 1.0 - h[at] * h[at] / reach
            g[at] = rest * rest if rest > 0.0 else 0.0
            if lengths[at] > 0.0:
                total += g[at]
        if total > 0.0:
            return
    for at in range(m):
        if weights == _LORENTZ:
            g[at] = sigma * sigma / (sigma * sigma + h[at] * h[at])
        elif weights == _HUBER and abs(h[at]) > sigma:
            g[at] = sigma / abs(h[at])
        else:
            g[at] = 1.0


@compiled
def _robust_laplacian(
    start,
    stop,
    x,
    normals,
    ring_start,
    ring,
    free,
    floor,
    weights,
    deviation,
    scaling,
    time_step,
    ring_areas,
    heights,
    sigma,
):
    """x positions, h heights of the ring over the tangent plane, l edge lengths, g weights."""
    widest = max(1, longest_row(start, stop, ring_start))
    h = np.empty(widest)
    lengths = np.ones(widest)
    g = np.empty(widest)
    scratch = np.empty(widest)
    scratch_bits = scratch.view(np.int64)
    for i in range(start, stop):
        row = ring_start[i]
        m = ring_start[i + 1] - row
        heights[i] = 0.0
        sigma[i] = 0.0
        if m == 0:
            continue
        for at in range(m):
            k = ring[row + at]
            ex, ey, ez = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
            h[at] = ex * normals[i, 0] + ey * normals[i, 1] + ez * normals[i, 2]
            if scaling == _EDGE:
                lengths[at] = np.sqrt(ex * ex + ey * ey + ez * ez)
        sigma[i] = _sigma(h, m, deviation, scratch)
        if not free[i]:
            continue
        _weigh(h, lengths, m, weights, max(sigma[i], floor), g, scratch, scratch_bits)
        moment = total = 0.0
        if scaling == _EDGE:
            reciprocals = 0.0
            for at in range(m):
                if lengths[at] > 0.0:
                    moment += g[at] * h[at] / lengths[at]
                    total += g[at] * lengths[at]
                    reciprocals += g[at] / lengths[at]
            if total > 0.0:
                heights[i] = moment * min(time_step / total, 1.0 / reciprocals)
            continue
        for at in range(m):
            moment += g[at] * h[at]
            total += g[at]
        heights[i] = moment / total
        if scaling == _MASS and 3.0 * time_step < ring_areas[i]:
            heights[i] *= 3.0 * time_step / ring_areas[i]


@dataclass(frozen=True, eq=False)
class RobustLaplacian:
    """d = sum(g h) / sum(g) of eq. (5) with other weights g and scales sigma, and section 4.3.

    h are the heights of the one-ring over the tangent plane.  The weights are scaled so that the
    influence h g(h) is greatest at |h| = sigma for all of them (Black et al. 1998):

        gauss    exp(-h^2 / (2 sigma^2))
        tukey    (1 - h^2 / (5 sigma^2))^2 where |h| < sqrt(5) sigma, else 0
        lorentz  1 / (1 + h^2 / sigma^2)
        huber    1 where |h| <= sigma, else sigma / |h|
        none     1

    Where every neighbour is beyond Tukey's reach all count alike.  sigma is 2 mean|h - mean h|
    (eq. 4) or 1.4826 median|h - median h|.

    Scaling by ``mass`` gives min(tau, A/3) d / (A/3) with A the area of the one-ring; by ``edge``
    min(tau, sum(g l) / sum(g / l)) sum(g h / l) / sum(g l) with l the edge lengths, those of
    length zero left out.  The minima are each vertex's limit of stability: there it reaches a
    weighted mean of its neighbours' heights, beyond it the explicit step overshoots.

    Attributes
    ----------
    normals : (n, 3) unit vertex normals, kept through all sweeps; a zero normal means no motion.
    faces, links : (m, 3) and its neighbourhoods.
    free : (n,) bool, False for vertices that must stay (they still have a sigma).
    mean_edge_length : file units; sets the floor of sigma.
    weights, deviation, scaling : of ``WEIGHTS``, ``DEVIATIONS`` and ``SCALINGS``.
    time_step : tau of a scaled operator, squared file units.
    """

    normals: Floats
    faces: Ints
    links: Connectivity
    free: Flags
    mean_edge_length: float
    weights: str = "gauss"
    deviation: str = "mean"
    scaling: str = "none"
    time_step: float = 0.0

    def __call__(self, positions: Floats) -> Step:
        """Heights and sigma at ``positions`` (n, 3), all from the same positions."""
        n = len(positions)
        heights, sigma = np.empty(n), np.empty(n)
        floor = max(SMALLEST_SIGMA * self.mean_edge_length, SMALLEST_LENGTH)
        choices = (
            WEIGHTS.index(self.weights),
            DEVIATIONS.index(self.deviation),
            SCALINGS.index(self.scaling),
        )
        known = positions, self.normals, *self.links.one_ring, self.free, floor, *choices
        areas = np.empty(0)
        if self.scaling == "mass":
            areas = ring_areas(positions, self.faces, self.links)
        over_ranges(_robust_laplacian, n, *known, self.time_step, areas, heights, sigma)
        return Step(heights, sigma)
