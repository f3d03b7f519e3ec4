"""Averages of face normals over neighbouring faces, with weights that favour similar normals.

Bilateral (Zheng, Fu, Au and Tai 2011): with centroids c, areas A and unit normals n of the faces

    w_ij = A_j exp(-|c_i - c_j|^2 / (2 sigma_c^2)) exp(-|n_i - n_j|^2 / (2 sigma_s^2));

joint bilateral: by differences of guides that are less noisy than the normals; and with a
threshold (Sun et al. 2007): by how far the cosine between normals is above it.

Throughout: ``normals`` (m, 3) are unit vectors, zeros for degenerate faces, which stay so and do
not count; ``areas`` (m,) and ``centroids`` (m, 3) are those of the faces, file units;
``ring_start`` and ``ring`` are neighbouring faces in CSR form, ``near_start`` and ``near`` the
faces near each face without itself.  Widths sigma and mu of Gaussians are above zero: a closeness
in the unit of the centroids, a similarity as a length of differences of unit normals.  If a sum of
normals vanishes the face keeps its normal.  ``on_pass`` is called after each pass or step; an
exception that it raises ends the run.
"""

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.geometry import VANISHED, face_normals_and_areas, usable_areas
from msal_cli.kernels.library import Kernel, compiled
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.quantiles import PER_MEDIAN, median
from msal_cli.kernels.vectors import ONE, THREE, TWO, longest_row
from msal_cli.light_dataclass import dataclass

OnPass = Callable[[], object]

BLOCK_PAIRS = np.uint64(1024)
"""Pairs of faces in a block, whose data fit a first-level cache."""

OUT_OF_REACH = 1e300
"""Exponent of a neighbour that does not count; finite, so that differences are numbers."""


@compiled
def _distances(start, stop, c, falloff, handicaps, ring_start, ring, exponents):
    """c centroids, flat; indices are unsigned, so that they need no test of their sign."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = vec.load(c, f)
        for at in vec.row_range(ring_start, f):
            g = np.uint64(ring[at])
            exponents[at] = vec.square_distance(vec.load(c, g), own) * falloff + handicaps[g]


def distance_exponents(
    centroids: Floats, ring_start: Ints, ring: Ints, closeness: float, handicaps: Floats
) -> Floats:
    """|c_i - c_j|^2 / (2 sigma_c^2 ln 2) + handicap_j of all pairs in the rows, (pairs,).

    2 to the power of minus these are the Gaussians if all ``handicaps`` (m,) are zero.
    """
    exponents = np.empty(len(ring))
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    falloff = 0.5 * vec.LOG2_E / closeness**2
    flat = centroids.reshape(-1), falloff, handicaps
    over_ranges(_distances, len(centroids), *flat, *rows, exponents)
    return exponents


@compiled
def _average_bilaterally(start, stop, n, exponents, falloff, ring_start, ring, result):
    """n normals, flat like the result; exponents and ``falloff`` are those of powers of two."""
    weight = np.empty(np.int64(longest_row(start, stop, ring_start)))
    for f in range(np.uint64(start), np.uint64(stop)):
        origin, count = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE] - ring_start[f])
        own, least = vec.load(n, f), np.inf
        for at in range(count):
            # |n_f - n_g|^2 = 2 - 2 n_f . n_g of unit vectors.
            other = vec.load(n, ring[origin + at])
            weight[at] = exponents[origin + at] + (1.0 - vec.dot(own, other)) * falloff
            least = min(least, weight[at])
        # Scaled so that the largest Gaussian is 1: the direction of the sum is the same, and the
        # sum cannot underflow.
        for at in range(count):
            weight[at] = vec.power_of_two(least - weight[at])
        total, weights = vec.ORIGIN, 0.0
        for at in range(count):
            weights += weight[at]
            total = vec.add_scaled(total, weight[at], vec.load(n, ring[origin + at]))
        least = np.inf if vec.is_zero(own) else VANISHED * weights
        vec.write_unit(total, least, n, f, result)


def bilateral_averages(
    normals: Floats,
    areas: Floats,
    centroids: Floats,
    ring_start: Ints,
    ring: Ints,
    closeness: float,
    similarity: float,
    passes: int,
    on_pass: OnPass,
) -> Floats:
    """Unit normals (m, 3) after ``passes`` passes, each from the normals that the one before left.

    n'_i is the normalised sum of w_ij n_j over the neighbours, n_i itself left out; areas and
    distances stay those of the input.
    """
    with np.errstate(divide="ignore"):
        handicaps = -np.log2(usable_areas(normals, areas))
    np.minimum(handicaps, OUT_OF_REACH, out=handicaps)
    exponents = distance_exponents(centroids, ring_start, ring, closeness, handicaps)
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    known = exponents, vec.LOG2_E / similarity**2, *rows
    return _repeat(_average_bilaterally, normals, known, passes, on_pass)


def _repeat(
    kernel: Kernel, normals: Floats, known: tuple[object, ...], passes: int, on_pass: OnPass
) -> Floats:
    for _ in range(passes):
        result = np.empty_like(normals)
        over_ranges(kernel, len(normals), normals.reshape(-1), *known, result.reshape(-1))
        normals = result
        on_pass()
    return normals


@compiled
def _average_jointly(
    start, stop, n, g, c, areas, near_start, near, per_distance, per_guide, result
):
    """n normals, g guides, c centroids, flat; squares are multiplied by -1 / (2 sigma^2 ln 2).

    Indices are unsigned, so that they need no test of their sign.
    """
    weight = np.empty(np.int64(longest_row(start, stop, near_start)))
    for f in range(np.uint64(start), np.uint64(stop)):
        origin, count = near_start[f], near_start[f + ONE] - near_start[f]
        own, guide = vec.load(c, f), vec.load(g, f)
        for at in range(count):
            k = np.uint64(near[origin + at])
            exponent = per_distance * vec.square_distance(vec.load(c, k), own)
            exponent += per_guide * vec.square_distance(vec.load(g, k), guide)
            weight[at] = exponent
        for at in range(count):
            weight[at] = vec.power_of_two(weight[at])
        weights = areas[f]
        total = vec.times(weights, vec.load(n, f))
        for at in range(count):
            k = np.uint64(near[origin + at])
            w = areas[k] * weight[at]
            total = vec.add_scaled(total, w, vec.load(n, k))
            weights += w
        vec.write_unit(total, VANISHED * weights, n, f, result)


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

    g the ``guides`` (m, 3), zeros for none.
    """
    result = np.empty_like(normals)
    flat = normals.reshape(-1), guides.reshape(-1), centroids.reshape(-1)
    rows = near_start.view(np.uint64), near.view(np.uint32)
    factors = -0.5 * vec.LOG2_E / sigma_s**2, -0.5 * vec.LOG2_E / sigma_r**2
    known = *flat, areas, *rows, *factors
    over_ranges(_average_jointly, len(normals), *known, result.reshape(-1))
    return result


@compiled
def _average_similar(start, stop, n, threshold, ring_start, ring, result):
    """n normals, flat like the result; indices are unsigned, and need no test of their sign."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = vec.load(n, f)
        weights = (1.0 - threshold) * (1.0 - threshold)
        total = vec.times(weights, own)
        for at in vec.row_range(ring_start, f):
            # ``vec.load`` would keep the compiler from processing two neighbours at once.
            g = THREE * ring[at]
            other = n[g], n[g + ONE], n[g + TWO]
            above = vec.dot(own, other) - threshold
            above = above if above > 0.0 else 0.0
            weights += above * above
            total = vec.add_scaled(total, above * above, other)
        # A degenerate face has no neighbours: a product of zero is below any threshold.
        vec.write_unit(total, VANISHED * weights, n, f, result)


def threshold_averages(
    normals: Floats, ring_start: Ints, ring: Ints, threshold: float, passes: int, on_pass: OnPass
) -> Floats:
    """Unit normals (m, 3) after ``passes`` passes, each from the normals that the one before left.

    n'_i is the normalised sum of max(0, n_i . n_j - threshold)^2 n_j over face i itself and its
    neighbours, 0 <= threshold < 1.
    """
    known = threshold, ring_start.view(np.uint32), ring.view(np.uint32)
    return _repeat(_average_similar, normals, known, passes, on_pass)


# Diffusion of face normals across edges, less across edges with larger angles.  A step of the heat
# equation on the surface, in finite volumes: each face is a cell, and the flow between two of them
# is proportional to the length of their edge and to the difference of their normals, and inverse to
# the distance of their centroids.

MAX_SHARE = 0.75
"""Largest share of a normal that a step replaces by its neighbours; 1 keeps chequerboard noise."""

MIN_SIMILARITY = 1e-6
"""Minimum of the width mu: smaller differences of normals are rounding errors."""


@compiled
def _shares(start, stop, x, faces, areas, ring_start, ring, time_step, shares):
    """min(tau / A, limit) l / d: edge length l, distance of centroids d, own area A; 0 for none.

    All arrays are flat; x positions.  The centroids of two faces are taken as a third as far apart
    as the corners opposite to their common edge.
    """
    for f in range(np.uint64(start), np.uint64(stop)):
        a, b, c = vec.load_corners(faces, f)
        total = 0.0
        for at in vec.row_range(ring_start, f):
            g = np.uint64(ring[at])
            i, j, k = vec.load_corners(faces, g)
            # Without branches, because the position of the edge in the faces cannot be predicted.
            has_b = (b == i) | (b == j) | (b == k)
            has_c = (c == i) | (c == j) | (c == k)
            left = c if has_c else b
            right = b if has_b & has_c else a
            apex = a if has_b & has_c else (b if has_c else c)
            edge = vec.square_distance(vec.load(x, left), vec.load(x, right))
            other_apex = i + j + k - left - right
            square = vec.square_distance(vec.load(x, apex), vec.load(x, other_apex)) / 9.0
            share = np.sqrt(edge / square)
            counts = (areas[f] > 0.0) & (areas[g] > 0.0) & (square > 0.0)
            share = share if counts else 0.0
            shares[at] = share
            total += share
        step = 0.0
        if total > 0.0:
            step = MAX_SHARE / total
            if time_step < step * areas[f]:
                step = time_step / areas[f]
        for at in vec.row_range(ring_start, f):
            shares[at] *= step


@compiled
def _diffuse(start, stop, n, shares, inverse, ring_start, ring, result):
    """n normals, flat like the result; ``inverse`` is 1 / (2 mu^2 ln 2).

    Faces are processed in blocks: the exponents of all, then all powers as vector code, then the
    sums.  Indices are unsigned, so that they need no test of their sign.
    """
    stop = np.uint64(stop)
    weights = np.empty(np.int64(max(BLOCK_PAIRS, longest_row(start, stop, ring_start))))
    capacity = np.uint64(len(weights))
    f = np.uint64(start)
    while f < stop:
        first = f
        origin = np.uint64(ring_start[f])
        while f < stop and np.uint64(ring_start[f + ONE]) - origin <= capacity:
            own = vec.load(n, f)
            for at in vec.row_range(ring_start, f):
                weights[at - origin] = -vec.square_distance(vec.load(n, ring[at]), own) * inverse
            f += ONE
        count = np.uint64(ring_start[f]) - origin
        for at in range(count):
            weights[at] = shares[origin + at] * vec.power_of_two(weights[at])
        for i in range(first, f):
            own, total = vec.load(n, i), vec.ORIGIN
            for at in vec.row_range(ring_start, i):
                difference = vec.subtract(vec.load(n, ring[at]), own)
                total = vec.add_scaled(total, weights[at - origin], difference)
            vec.write_unit(vec.add(own, total), VANISHED, n, i, result)


@compiled
def _edge_differences(start, stop, n, ring_start, ring, lengths):
    """|n - m| for neighbours of higher number, -1 for all pairs that do not count; n flat."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = vec.load(n, f)
        for at in vec.row_range(ring_start, f):
            other = vec.load(n, ring[at])
            lacks_one = vec.is_zero(own) | vec.is_zero(other)
            length = np.sqrt(vec.square_distance(other, own))
            lengths[at] = -1.0 if lacks_one | (ring[at] <= f) else length


def difference_width(normals: Floats, ring_start: Ints, ring: Ints) -> float:
    """1.4826 times the median absolute deviation of |n - m| over neighbours n, m.

    Zero where there are none.
    """
    lengths = np.empty(len(ring))
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    over_ranges(_edge_differences, len(normals), normals.reshape(-1), *rows, lengths)
    lengths = lengths[lengths >= 0.0]
    if not len(lengths):
        return 0.0
    return float(PER_MEDIAN * median(np.abs(lengths - median(lengths))))


def diffused_normals(
    vertices: Floats,
    faces: Ints,
    ring_start: Ints,
    ring: Ints,
    similarity: float,
    time_step: float,
    steps: int,
    on_step: OnPass,
) -> Floats:
    """Unit face normals (m, 3) after ``steps`` steps from those of the mesh.

    n_i <- n_i + sum(s_ij g_ij (n_j - n_i)), normalised, with g = exp(-|n_j - n_i|^2 / (2 mu^2)) and
    s_ij = tau l_ij / (d_ij A_i), tau the ``time_step`` in squared file units.  A face for which the
    sum of s exceeds 3/4 takes a shorter step.  Neighbours share an edge; ``faces`` (m, 3),
    ``vertices`` (n, 3).
    """
    count = len(faces)
    normals, areas = face_normals_and_areas(vertices, faces)
    areas = usable_areas(normals, areas)
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    corners = faces.reshape(-1).view(np.uint32)
    shares = np.empty(len(ring))
    over_ranges(_shares, count, vertices.reshape(-1), corners, areas, *rows, time_step, shares)
    inverse = 0.5 * vec.LOG2_E / max(similarity, MIN_SIMILARITY) ** 2
    return _repeat(_diffuse, normals, (shares, inverse, *rows), steps, on_step)


# The global bilateral filter of face normals: one sparse linear system (Zheng et al. 2011).
#
# With the bilateral weights w_ij between a face and its neighbours, and M = I - W the difference
# between a normal and the weighted mean around it, W = w_ij / sum_j w_ij, the normals that minimise
#
#     (1 - lambda) |M n'|^2 + lambda |n' - n|^2
#
# solve ((1 - lambda) M^T M + lambda I) n' = lambda n.

ALONE = 1e-200
"""With less total weight, in mean face areas, a face counts as one without neighbours."""


@compiled
def _gaussians(start, stop, normals, areas, falloff, ring_start, ring, values, totals):
    """Turn distance exponents into w_ij / A_j, which is symmetric; sum w_ij for each i."""
    for f in range(start, stop):
        for at in range(ring_start[f], ring_start[f + 1]):
            alike = vec.dot(vec.load(normals, f), vec.load(normals, ring[at]))
            values[at] = min(0.0, (alike - 1.0) * falloff - values[at])
    for at in range(np.uint64(ring_start[start]), np.uint64(ring_start[stop])):
        values[at] = vec.power_of_two(values[at])
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
        total = vec.ORIGIN
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            total = vec.add_scaled(total, values[at] * inner[k], vec.load(x, k))
        difference = vec.add_scaled(vec.times(own[i], vec.load(x, i)), -outer[i], total)
        difference = vec.times(weight, difference)
        vec.store(result, i, vec.add_scaled(difference, base_weight, vec.load(base, i)))


@dataclass(frozen=True, eq=False)
class NormalSystem:
    """The matrix (1 - lambda) M^T M + lambda I, symmetric and positive definite."""

    # ring_start, ring: neighbouring faces in CSR form, a symmetric relation
    ring_start: Ints
    ring: Ints
    values: Floats  # (pairs,), w_ij / A_j
    # areas, inverse: (m,), A_j and 1 / sum_j w_ij, both zero for a degenerate face; the second also
    # for a face without neighbours, for which M n' is zero
    areas: Floats
    inverse: Floats
    own: Floats  # (m,), 1 where ``inverse`` is not zero, else 0: the diagonal of M
    fidelity: float  # lambda, 0 < lambda <= 1
    diagonal: Floats  # (m,)

    def times(self, x: Floats, product: Floats) -> None:
        """Write A x into ``product``; both (m, 3), not the same array."""
        rows, own, share = (self.values, self.ring_start, self.ring), self.own, self.fidelity
        difference = np.empty_like(x)
        known = *rows, self.areas, self.inverse, own, x, 1.0, x, 0.0
        over_ranges(_differences, len(x), *known, difference)
        # The transpose has the two factors of the symmetric part in the other order.
        known = *rows, self.inverse, self.areas, own, difference, 1.0 - share, x, share
        over_ranges(_differences, len(x), *known, product)


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
    """The system for ``fidelity`` lambda, 0 < lambda <= 1."""
    m = len(normals)
    usable = (normals != 0.0).any(axis=1)
    relative = np.where(usable, areas, 0.0)
    mean = float(relative.mean())
    relative /= mean if mean > 0.0 else 1.0
    values = distance_exponents(centroids, ring_start, ring, closeness, np.zeros(m))
    totals = np.empty(m)
    rows = ring_start, ring, values
    falloff = vec.LOG2_E / similarity**2
    over_ranges(_gaussians, m, normals, relative, falloff, *rows, totals)
    linked = usable & (totals > ALONE)
    inverse = np.where(linked, 1.0 / np.where(linked, totals, 1.0), 0.0)
    own = linked.astype(np.float64)
    squares = np.empty(m)
    over_ranges(_diagonal, m, relative, inverse, ring_start, ring, values, squares)
    diagonal = (1.0 - fidelity) * (own + squares) + fidelity
    return NormalSystem(ring_start, ring, values, relative, inverse, own, fidelity, diagonal)


# Face normals that minimise the energy of the static/dynamic filter, by fixed-point iteration.
#
# Zhang, Deng, Hong, Peng, Qin and Liu 2018.  With n the normals to find, n0 the given ones, g
# guides, c centroids and A areas,
#
#     E = sum_i A_i |n_i - n0_i|^2 + lambda' sum_ij w_ij (1 - exp(-|n_i - n_j|^2 / (2 nu^2))),
#     w_ij = (A_i + A_j) exp(-|c_i - c_j|^2 / (2 eta^2)) exp(-|g_i - g_j|^2 / (2 mu^2)),
#
# the second sum over near faces, and lambda' = lambda sum_i A_i / sum_ij (w_ij without the last
# factor).


@compiled
def _weigh(start, stop, g, c, areas, near_start, near, per_distance, per_guide, weights, sums):
    """w of each row; ``sums``, by face, of w without its last factor."""
    widest = longest_row(start, stop, near_start)
    distant = np.empty(widest)
    unlike = np.empty(widest)
    for i in range(start, stop):
        row = near_start[i]
        count = near_start[i + 1] - row
        for at in range(count):
            j = near[row + at]
            distant[at] = per_distance * vec.square_distance(vec.load(c, j), vec.load(c, i))
            unlike[at] = per_guide * vec.square_distance(vec.load(g, j), vec.load(g, i))
        vec.exponentials(distant, count)
        vec.exponentials(unlike, count)
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
    """w (k,) for the rows ``near`` (k,) and ``guides`` (m, 3), and lambda' / lambda, which is zero
    if no faces are near one another."""
    weights = np.empty(len(near))
    sums = np.empty(len(areas))
    rows = near_start, near, -0.5 / eta**2, -0.5 / mu**2
    over_ranges(_weigh, len(areas), guides, centroids, areas, *rows, weights, sums)
    # Each pair is in two rows.
    total = float(sums.sum()) / 2.0
    return weights, float(areas.sum()) / total if total > 0.0 else 0.0


@compiled
def _step(start, stop, n, pull, near_start, near, weights, per_difference, areas, result, changes):
    """pull (m, 3) is 2 nu^2 / lambda' A n0; ``changes`` are A |step|^2."""
    widest = longest_row(start, stop, near_start)
    kernel = np.empty(widest)
    others = np.empty((widest, 3))
    for i in range(start, stop):
        row = near_start[i]
        count = near_start[i + 1] - row
        own = vec.load(n, i)
        for at in range(count):
            # Unsigned indices need no test for negative ones.
            other = vec.load(n, np.uint64(near[row + at]))
            vec.store(others, at, other)
            kernel[at] = per_difference * vec.square_distance(other, own)
        vec.exponentials(kernel, count)
        total = vec.load(pull, i)
        weights_in_all = abs(total[0]) + abs(total[1]) + abs(total[2])
        for at in range(count):
            weight = weights[row + at] * kernel[at]
            total = vec.add_scaled(total, weight, vec.load(others, at))
            weights_in_all += weight
        vec.write_unit(total, VANISHED * weights_in_all, n, i, result)
        changes[i] = areas[i] * vec.square_distance(vec.load(result, i), own)


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
    on_step: OnPass,
) -> Floats:
    """Unit normals (m, 3) near a minimum of E, from ``normals`` (m, 3), which are n0.

    Each step replaces all normals at once by the normalised sums

        2 nu^2 / lambda' A_i n0_i + sum_j w_ij exp(-|n_i - n_j|^2 / (2 nu^2)) n_j.

    ``weights`` (k,) are w, and ``strength`` lambda', of which zero returns the normals.  The steps
    end when the root of the area-weighted mean square of the changes of normals is at most
    ``tolerance``, or after ``most_steps``.
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
        on_step()
        # In one thread and over one array, numpy's sum has a fixed order.
        if float(changes.sum()) <= goal:
            break
    return result
