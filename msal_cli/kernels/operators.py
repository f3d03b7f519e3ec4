"""Operators of equation (2): the displacement of each vertex in a sweep.

An operator is called with the current positions x (n, 3) and returns a ``Step``.  One that moves
vertices along fixed normals returns heights; the sweep engine then keeps each vertex on its normal
line, so that it cannot drift tangentially.  Others return vectors.

A loop over the five to seven neighbours of one vertex is too short for vector code.  So the
operators of the paper process vertices in blocks that stay in the first-level cache, and group
those of a block by their valence m.  A group has a lane for each vertex, padded to whole vectors,
and a row for the k-th neighbours of all its lanes.  Then each loop over lanes is vector code, while
sums over neighbours run from the first to the last, so that no bit depends on the block, the lane
or the thread of a vertex.

Counts and indices are uint64: signed indices would prevent vector code.
"""

from typing import Protocol

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.geometry import ring_areas
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.quantiles import PER_MEDIAN
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO, longest_row, sort_few
from msal_cli.light_dataclass import dataclass

BLOCK = np.uint64(256)
"""Largest number of vertices in a block: with 6 neighbours each their heights take 12 KiB."""

BLOCK_EDGES = np.uint64(2048)
"""Largest number of edges in a block, except for a single vertex that has more."""

VECTOR = np.uint64(8)
"""Groups have a multiple of this number of lanes: the numbers in a vector of 512 bits."""

LANES = np.uint64(2048)
"""Largest number of lanes of a block: each vertex may be alone in its group."""

PARTS = (np.uint64(0), LANES, TWO * LANES, THREE * LANES, TWO * TWO * LANES)
"""Offsets of sigma, sum(g h) and sum(g) by lane, and of two more, in the scratch memory."""

ROWS = (TWO + THREE) * LANES
"""Offset of the rows in it."""

_FILL, _SHIFT = np.uint64(7), np.uint64(3)


@compiled
def block(first, stop, ring_start, widest, origin, table):
    """Lay out the block that starts at vertex ``first``: (last + 1, least and largest valence).

    ``table`` gets, for each valence m in use, the width of its group at m, the group's first lane
    at widest + 1 + m, and at 2 (widest + 1) + m the number to add to a lane for its index in the
    first row, where rows begin at ``origin``.
    """
    edges = max(BLOCK_EDGES, widest)
    last = min(first + BLOCK, np.uint64(stop))
    while ring_start[last] - ring_start[first] > edges:
        last -= ONE
    fewest, most = widest, ZERO
    for i in range(first, last):
        m = ring_start[i + ONE] - ring_start[i]
        fewest = min(fewest, m)
        most = max(most, m)
    for m in range(fewest, most + ONE):
        table[m] = ZERO
    if fewest == most:
        table[most] = last - first
    else:
        for i in range(first, last):
            table[np.uint64(ring_start[i + ONE] - ring_start[i])] += ONE
    lane = ZERO
    place = origin
    lanes, shifts = widest + ONE, TWO * (widest + ONE)
    for m in range(fewest, most + ONE):
        width = (table[m] + _FILL) >> _SHIFT << _SHIFT
        table[m] = width
        table[lanes + m] = lane
        table[shifts + m] = place - lane
        lane += width
        place += width * m
    return last, fewest, most


MIN_SIGMA = 1e-9
"""Minimum of sigma in the exponent, mean edge lengths: far below the rounding of scans."""

MIN_LENGTH = np.finfo(np.float64).tiny ** 0.5
"""Minimum of sigma on a mesh of size zero: its square does not underflow."""


@dataclass(frozen=True, eq=False)
class Step:
    """The result of an operator."""

    # the displacement dx before time step and fidelity, file units: (n,) heights along the normals
    # of the vertices, or (n, 3)
    move: Floats
    # (n,), sigma of eq. (4), file units, zero if the one-ring is planar; None if it is not computed
    sigma: Floats | None = None
    largest_sigma: float | None = None  # its maximum, if the operator computes it


class Operator(Protocol):
    """The dx of equation (2), the displacement of each vertex in a sweep.

    ``normals`` are the fixed unit normals (n, 3) along which the operator moves, zeros where a
    vertex must not move; None if it moves vertices freely.
    """

    @property
    def normals(self) -> Floats | None:
        """Fixed unit normals (n, 3), or None."""
        ...

    def __call__(self, positions: Floats) -> Step:
        """The step at ``positions`` (n, 3), for all vertices from these same positions."""
        ...


@compiled
def _filter_rings(
    start, stop, x, normals, ring_start, ring, free, floor, closeness, similarity, heights, sigma
):
    """x positions, h heights of the ring over the tangent plane; Huang & Ascher, eqs. (4), (5).

    Points are flat, three numbers each.  With a ``closeness`` the weight g is a product of two
    Gaussians, computed as one exponential; if it is 0, g is that of eq. (5).  Returns the largest
    sigma.
    """
    ring_start, ring = ring_start.view(np.uint32), ring.view(np.uint32)
    stop = np.uint64(stop)
    widest = longest_row(start, stop, ring_start)
    is_bilateral = closeness > 0.0
    # As many more rows as for heights: exponents by distance.
    apart = VECTOR * max(BLOCK_EDGES, widest)
    room = np.zeros(ROWS + (TWO * apart if is_bilateral else apart))
    lanes, shifts, chosen = widest + ONE, TWO * (widest + ONE), THREE * (widest + ONE)
    table = np.zeros(chosen + BLOCK, np.uint64)
    near = 0.5 * vec.LOG2_E / max(closeness, floor) ** 2
    largest = 0.0
    first = np.uint64(start)
    while first < stop:
        last, fewest, most = block(first, stop, ring_start, widest, ROWS, table)
        for i in range(first, last):
            point = THREE * i
            # The signs of both factors are reversed, so that x_k is subtracted while it is loaded.
            nx, ny, nz = -normals[point], -normals[point + ONE], -normals[point + TWO]
            xi, yi, zi = x[point], x[point + ONE], x[point + TWO]
            edge = np.uint64(ring_start[i])
            m = ring_start[i + ONE] - edge
            lane = table[lanes + m]
            table[lanes + m] = lane + ONE
            table[chosen + i - first] = lane
            place = lane + table[shifts + m]
            width = table[m]
            for e in range(edge, edge + m):
                k = THREE * ring[e]
                ex, ey, ez = xi - x[k], yi - x[k + ONE], zi - x[k + TWO]
                room[place] = ex * nx + ey * ny + ez * nz
                if is_bilateral:
                    room[apart + place] = (ex * ex + ey * ey + ez * ez) * near
                place += width
        row = ROWS
        scales, sums, weights, least, factors = PARTS
        for m in range(fewest, most + ONE):
            width = table[m]
            for at in range(width):
                room[scales + at] = 0.0
                room[sums + at] = 0.0
                room[weights + at] = 0.0
                room[least + at] = np.inf
                room[factors + at] = 0.0
            place = row
            for _ in range(m):
                for at in range(width):
                    room[sums + at] += room[place + at]
                place += width
            for at in range(width):
                room[sums + at] /= max(m, ONE)
            place = row
            for _ in range(m):
                for at in range(width):
                    room[scales + at] += abs(room[place + at] - room[sums + at])
                place += width
            if is_bilateral:
                place = row
                for _ in range(m):
                    for at in range(width):
                        offset = room[place + at] - room[sums + at]
                        room[factors + at] += offset * offset
                    place += width
            for at in range(width):
                scale = 2.0 * room[scales + at] / max(m, ONE)
                spread = np.sqrt(room[factors + at] / max(m, ONE))
                room[scales + at] = scale
                scale = scale if not is_bilateral else (similarity if similarity > 0.0 else spread)
                scale = scale if scale > floor else floor
                room[factors + at] = 0.5 * vec.LOG2_E / (scale * scale)
                room[sums + at] = 0.0
            # Scaled so that the largest weight is 1: the quotient of eq. (5) is the same, and never
            # 0/0 if sigma is tiny.
            place = row
            if is_bilateral:
                # Exponents by distance are added to those by height.
                for _ in range(m):
                    for at in range(width):
                        h = room[place + at]
                        exponent = room[apart + place + at] + h * h * room[factors + at]
                        room[apart + place + at] = exponent
                        room[least + at] = min(room[least + at], exponent)
                    place += width
                for _ in range(m):
                    for at in range(width):
                        g = vec.power_of_two(room[least + at] - room[apart + row + at])
                        room[weights + at] += g
                        room[sums + at] += g * room[row + at]
                    row += width
            else:
                for _ in range(m):
                    for at in range(width):
                        h = room[place + at]
                        room[least + at] = min(room[least + at], h * h)
                    place += width
                for _ in range(m):
                    for at in range(width):
                        h = room[row + at]
                        g = vec.power_of_two((room[least + at] - h * h) * room[factors + at])
                        room[weights + at] += g
                        room[sums + at] += g * h
                    row += width
            scales += width
            sums += width
            weights += width
            least += width
            factors += width
        scales, sums, weights = PARTS[0], PARTS[1], PARTS[2]
        for i in range(first, last):
            lane = table[chosen + i - first]
            moves = free[i] and ring_start[i + ONE] > ring_start[i]
            heights[i] = room[sums + lane] / room[weights + lane] if moves else 0.0
            sigma[i] = room[scales + lane]
            largest = max(largest, room[scales + lane])
        first = last
    return largest


@dataclass(frozen=True, eq=False)
class RingOperator:
    """Means d of the heights h of the one-ring above a vertex's fixed tangent plane.

    The anisotropic Laplacian of Huang and Ascher, eqs. (4) and (5), is sigma = 2 mean|h - mean h|,
    g = exp(-h^2 / (2 sigma^2)) and d = sum(g h) / sum(g).

    With a ``closeness`` sigma_c > 0 it is what they call "our BF" (section 2.3),
    d = sum(w h) / sum(w) with w = exp(-t^2 / 2 sigma_c^2 - h^2 / 2 sigma_s^2), t the distances of
    the neighbours; a ``similarity`` sigma_s of 0 takes the standard deviation of each ring's h.
    """

    # (n, 3) unit vertex normals, kept through all sweeps; a zero normal means no motion
    normals: Floats
    ring_start: Ints  # ring_start, ring: the one-rings; an empty one means no motion
    ring: Ints
    free: Flags  # (n,) bool, False for vertices that must stay (they still have a sigma)
    mean_edge_length: float  # file units; sets the floor of sigma and of widths
    closeness: float = 0.0  # closeness, similarity: file units
    similarity: float = 0.0

    def __call__(self, positions: Floats) -> Step:
        n = len(positions)
        heights, sigma = np.empty(n), np.empty(n)
        floor = max(MIN_SIGMA * self.mean_edge_length, MIN_LENGTH)
        rings = self.normals.reshape(-1), self.ring_start, self.ring, self.free
        known = positions.reshape(-1), *rings, floor, self.closeness, self.similarity
        largest = max(over_ranges(_filter_rings, n, *known, heights, sigma))
        return Step(heights, sigma, float(largest))


# Variants with other weights and scales, and scaled for irregular meshes: a second kernel, so that
# the first one stays fast.

WEIGHTS = ("gauss", "tukey", "lorentz", "huber", "none")
DEVIATIONS = ("mean", "median")
SCALINGS = ("none", "mass", "edge")

_GAUSS, _TUKEY, _LORENTZ, _HUBER, _NONE = range(len(WEIGHTS))
_MEAN, _MEDIAN = range(len(DEVIATIONS))
_UNSCALED, _MASS, _EDGE = range(len(SCALINGS))


@compiled
def _median(values, count):
    """Median of ``values[:count]``, which get sorted."""
    sort_few(values, count)
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
def _weigh(h, lengths, m, weights, sigma, g):
    """g(h[:m]), up to a factor; equal if all neighbours are beyond Tukey's reach."""
    if weights == _GAUSS:
        flattest = np.inf
        for at in range(m):
            if lengths[at] > 0.0:
                flattest = min(flattest, h[at] * h[at])
        inverse = 0.5 / (sigma * sigma)
        for at in range(m):
            # For an edge of length zero the height is zero and the weight is not used.
            g[at] = min((flattest - h[at] * h[at]) * inverse, 0.0)
        vec.exponentials(g, m)
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
    for i in range(start, stop):
        row = ring_start[i]
        m = ring_start[i + 1] - row
        if m == 0:
            continue
        for at in range(m):
            edge = vec.offset(x, ring[row + at], i)
            h[at] = vec.dot(edge, vec.load(normals, i))
            if scaling == _EDGE:
                lengths[at] = vec.norm(edge)
        sigma[i] = _sigma(h, m, deviation, scratch)
        if not free[i]:
            continue
        _weigh(h, lengths, m, weights, max(sigma[i], floor), g)
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

    If all neighbours are beyond Tukey's reach their weights are equal.  sigma is 2 mean|h - mean h|
    (eq. 4) or 1.4826 median|h - median h|.

    Scaling by ``mass`` gives min(tau, A/3) d / (A/3) with A the area of the one-ring; by ``edge``
    min(tau, sum(g l) / sum(g / l)) sum(g h / l) / sum(g l) with l the edge lengths, those of length
    zero left out.  The minima are each vertex's limit of stability: there it moves to a weighted
    mean of its neighbours' heights; larger explicit steps overshoot."""

    # (n, 3) unit vertex normals, kept through all sweeps; a zero normal means no motion
    normals: Floats
    faces: Ints  # faces, links: (m, 3) and its neighbourhoods
    links: Connectivity
    free: Flags  # (n,) bool, False for vertices that must stay (they still have a sigma)
    mean_edge_length: float  # file units; sets the floor of sigma
    # weights, deviation, scaling: of ``WEIGHTS``, ``DEVIATIONS`` and ``SCALINGS``
    weights: str = "gauss"
    deviation: str = "mean"
    scaling: str = "none"
    time_step: float = 0.0  # tau of a scaled operator, squared file units

    def __call__(self, positions: Floats) -> Step:
        n = len(positions)
        heights, sigma = np.zeros(n), np.zeros(n)
        floor = max(MIN_SIGMA * self.mean_edge_length, MIN_LENGTH)
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
