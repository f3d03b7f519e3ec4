"""Filters by the umbrella operator: means of x_k - x_i over rows of neighbours.

``averaging_ring`` makes the rows for a rule at boundary vertices.  Vertices with empty rows stay.

The umbrella U acts on a wave of frequency k, 0 <= k <= 2, as U x = -k x.  The windowed sinc
multiplies it by

    f(k) = c_0 + sum over j of c_j cos(j theta),   cos(theta) = 1 - k / 2

where cos(j theta) is the Chebyshev polynomial T_j(1 - k / 2), so one more umbrella gives the next
term: T_(j+1) x = 2 (T_j x + U T_j x / 2) - T_(j-1) x.
"""

from collections.abc import Callable, Sequence

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.operators import Step
from msal_cli.kernels.parallel import fill_array, over_ranges
from msal_cli.kernels.vectors import ONE
from msal_cli.light_dataclass import dataclass


@compiled
def _mean_offset(x, ring_start, ring, i):
    """The mean of x_k - x_i over the row of i; zero if it is empty."""
    m = ring_start[i + 1] - ring_start[i]
    return vec.times(1.0 / m if m else 0.0, vec.sum_offsets(x, ring_start, ring, i))


@compiled
def _umbrella(start, stop, x, ring_start, ring, moves):
    for i in range(start, stop):
        vec.store(moves, i, _mean_offset(x, ring_start, ring, i))


@compiled
def _even_out(start, stop, x, normals, ring_start, ring, free, share, longest, moved):
    for i in range(start, stop):
        position, normal = vec.load(x, i), vec.load(normals, i)
        if free[i]:
            offset = _mean_offset(x, ring_start, ring, i)
            across = vec.add_scaled(offset, -vec.dot(offset, normal), normal)
            if vec.dot(across, across) <= longest * longest:
                position = vec.add_scaled(position, share, across)
        vec.store(moved, i, position)


def even_out(
    positions: Floats,
    normals: Floats,
    ring_start: Ints,
    ring: Ints,
    free: Flags,
    share: float,
    longest: float,
) -> Floats:
    """The ``positions`` (n, 3), file units, after one relaxation of the triangles.

    Each ``free`` vertex (n,) moves by ``share`` (0 to 1; more is more even) of its umbrella within
    the tangent plane of its unit normal (n, 3), unless that is longer than ``longest``, file units.
    """
    args = positions, normals, ring_start, ring, free, share, longest
    return fill_array(_even_out, positions.shape, *args)


@dataclass(frozen=True, eq=False)
class Umbrella:
    """dx_i = mean of x_k - x_i over the row of i; eq. (3) of Huang and Ascher."""

    ring_start: Ints  # ring_start, ring: rows to average over, (n + 1,) and (...,)
    ring: Ints
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        return Step(fill_array(_umbrella, positions.shape, positions, self.ring_start, self.ring))


@compiled
def _scale_dependent_umbrella(start, stop, x, ring_start, ring, time_step, moves):
    """l edge lengths of the row; edges of length zero do not count."""
    for i in range(start, stop):
        total = vec.ORIGIN
        lengths = reciprocals = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            edge = vec.offset(x, ring[at], i)
            length = vec.norm(edge)
            if length > 0.0:
                total = vec.add(total, vec.divide(edge, length))
                lengths += length
                reciprocals += 1.0 / length
        share = min(2.0 * time_step / lengths, 1.0 / reciprocals) if lengths > 0.0 else 0.0
        vec.store(moves, i, vec.times(share, total))


@dataclass(frozen=True, eq=False)
class ScaleDependentUmbrella:
    """min(tau, limit_i) times 2/E sum(e/l), E = sum(l), over edges e of length l (Fujiwara).

    limit_i = E / (2 sum(1/l)) is the time step with which the vertex moves to the mean of its
    neighbours with weights 1/l; larger explicit steps would overshoot.
    """

    ring_start: Ints  # ring_start, ring: rows to average over, (n + 1,) and (...,)
    ring: Ints
    time_step: float  # tau, in squared file units
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        known = positions, self.ring_start, self.ring, self.time_step
        return Step(fill_array(_scale_dependent_umbrella, positions.shape, *known))


@compiled
def _average_and_correct(start, stop, o, q, ring_start, ring, alpha, p, b):
    """o input, q previous, p averaged positions, b corrections; letters of Vollmer et al."""
    for i in range(start, stop):
        step, own = _mean_offset(q, ring_start, ring, i), vec.load(q, i)
        vec.store(p, i, vec.add(own, step))
        # p - (alpha o + (1 - alpha) q), in a form that is exactly zero if nothing moves.
        vec.store(b, i, vec.add_scaled(step, -alpha, vec.subtract(vec.load(o, i), own)))


@compiled
def _push_back(start, stop, p, b, ring_start, ring, beta, q):
    for i in range(start, stop):
        m = ring_start[i + 1] - ring_start[i]
        if m:
            around = vec.times((1.0 - beta) / m, vec.sum_row(b, ring_start, ring, i))
            back = vec.add(vec.times(beta, vec.load(b, i)), around)
            vec.store(q, i, vec.subtract(vec.load(p, i), back))


def hc_sweep(
    original: Floats, positions: Floats, ring_start: Ints, ring: Ints, alpha: float, beta: float
) -> Floats:
    """Positions (n, 3) after one sweep from ``positions`` (n, 3); a new array.

    Each vertex moves to the mean p of its row; b is the difference of p and alpha times its
    ``original`` (n, 3) plus 1 - alpha times its previous position; then beta times its b and 1 -
    beta times the mean b of its row are subtracted.  A vertex with an empty row does not move.
    """
    n = len(positions)
    averaged, corrections = np.empty((n, 3)), np.empty((n, 3))
    moved = averaged, corrections
    over_ranges(_average_and_correct, n, original, positions, ring_start, ring, alpha, *moved)
    result = positions.copy()
    over_ranges(_push_back, n, *moved, ring_start, ring, beta, result)
    return result


NUTTALL = (0.355768, 0.487396, 0.144232, 0.012604)
"""Cosine terms of the Nuttall window, whose side lobes are below 1e-4."""

KEPT = 0.99904
"""The factor of a wave at the end of the pass band, about as in the search of VTK."""


@compiled
def _next_polynomial(start, stop, x, ring_start, ring, before, now, twice, weights, after, moves):
    """``twice`` (now + U now / 2) - (twice - 1) before; adds this term, by the weight of each
    filter, to the displacements of the filters.  Positions and displacements are flat."""
    rest = twice - 1.0
    for i in range(np.uint64(start), np.uint64(stop)):
        m = ring_start[i + ONE] - ring_start[i]
        share = 0.5 / np.float64(m) if m else 0.0
        middle = vec.add_scaled(vec.load(now, i), share, vec.sum_offsets(now, ring_start, ring, i))
        v = vec.subtract(vec.times(twice, middle), vec.times(rest, vec.load(before, i)))
        vec.store(after, i, v)
        v = vec.subtract(v, vec.load(x, i))
        for k in range(len(weights)):
            vec.store(moves[k], i, vec.add_scaled(vec.load(moves[k], i), weights[k], v))


def smooth_by_windowed_sinc(
    vertices: Floats,
    ring_start: Ints,
    ring: Ints,
    coefficients: Sequence[Floats],
    on_pass: Callable[[int, int], None] | None = None,
) -> list[Floats]:
    """The vertices (n, 3) after each filter, with rows (n + 1,), (...,) to average over.

    The ``coefficients`` (passes + 1,) of a filter, with sum 1, are those of its terms.  Constants
    and vertices with an empty row do not change.  Filters share the polynomials.
    """
    count = max(len(terms) for terms in coefficients) - 1
    weights = np.zeros((count + 1, len(coefficients)))
    for place, terms in enumerate(coefficients):
        weights[: len(terms), place] = terms
    x = np.ascontiguousarray(vertices).reshape(-1)
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    moves = np.zeros((len(coefficients), len(x)))
    before = now = x
    for done in range(1, count + 1):
        after = np.empty_like(x)
        known = x, *rows, before, now, 1.0 if done == 1 else 2.0, weights[done]
        over_ranges(_next_polynomial, len(vertices), *known, after, moves)
        before, now = now, after
        if on_pass is not None:
            on_pass(done, count)
    moves += x
    return [move.reshape(-1, 3) for move in moves]


def sinc_coefficients(pass_band: float, passes: int) -> Floats:
    """c_0 ... c_passes (passes + 1,) of the filter that keeps waves up to ``pass_band``.

    The window blurs the end of the pass band, so the end of the sinc's band is increased until a
    wave at ``pass_band`` keeps the factor ``KEPT``, as far as possible.
    """
    theta = np.arccos(1.0 - 0.5 * pass_band)
    order = np.arange(passes + 1)
    low, high = 0.0, np.pi - theta
    # Bisection, to the last bit after 60 steps.
    for _ in range(60):
        middle = 0.5 * (low + high)
        kept = float((_terms(theta + middle, passes) * np.cos(order * theta)).sum())
        if kept < KEPT:
            low = middle
        else:
            high = middle
    return _terms(theta + high, passes)


def _terms(theta: float, passes: int) -> Floats:
    """Windowed coefficients with sum 1 of a sinc whose band ends at ``theta``."""
    order = np.arange(1, passes + 1)
    angles = np.pi * order / (passes + 1.0)
    window = sum(term * np.cos(k * angles) for k, term in enumerate(NUTTALL))
    terms = np.empty(passes + 1)
    terms[0] = theta / np.pi
    terms[1:] = 2.0 * window * np.sin(order * theta) / (order * np.pi)
    return np.asarray(terms / terms.sum())
