"""A low-pass filter over one-rings whose transfer function is a windowed sinc.

With the umbrella U x_i = mean of x_k - x_i a wave of frequency k, U x = -k x with 0 <= k <= 2, is
multiplied by

    f(k) = c_0 + sum over j of c_j cos(j theta),   cos(theta) = 1 - k / 2

where cos(j theta) is the Chebyshev polynomial T_j(1 - k / 2), so that one umbrella step more gives
the next term: T_(j+1) x = 2 (T_j x + U T_j x / 2) - T_(j-1) x.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.parallel import over_ranges

NUTTALL = (0.355768, 0.487396, 0.144232, 0.012604)
"""Cosine terms of the Nuttall window, whose side lobes are below 1e-4."""

KEPT = 0.99904
"""What is left of a wave at the end of the pass band: where the search of VTK stops, about."""


@compiled
def _next_polynomial(start, stop, x, ring_start, ring, before, now, twice, weight, after, moves):
    """``twice`` (now + U now / 2) - (twice - 1) before, and its term added to the moves."""
    for i in range(start, stop):
        m = ring_start[i + 1] - ring_start[i]
        share = 0.5 / m if m else 0.0
        for axis in range(3):
            here = now[i, axis]
            total = 0.0
            for at in range(ring_start[i], ring_start[i + 1]):
                total += now[ring[at], axis] - here
            value = twice * (here + share * total) - (twice - 1.0) * before[i, axis]
            after[i, axis] = value
            moves[i, axis] += weight * (value - x[i, axis])


def smooth_by_windowed_sinc(
    vertices: Floats,
    ring_start: Ints,
    ring: Ints,
    coefficients: Floats,
    on_pass: Callable[[int, int], None] | None = None,
) -> Floats:
    """The vertices (n, 3) filtered, each ring row (n + 1,), (...,) being averaged over.

    ``coefficients`` (passes + 1,) are those of the terms; the sum of all is taken for 1, so that
    what is constant stays, and so does a vertex whose row is empty.
    """
    moves = np.zeros_like(vertices)
    before = now = vertices
    spare: list[Floats] = []
    count = len(coefficients) - 1
    for done in range(1, count + 1):
        after = spare.pop() if spare else np.empty_like(vertices)
        over_ranges(
            _next_polynomial,
            len(vertices),
            vertices,
            ring_start,
            ring,
            before,
            now,
            1.0 if done == 1 else 2.0,
            float(coefficients[done]),
            after,
            moves,
        )
        if before is not vertices:
            spare.append(before)
        before, now = now, after
        if on_pass is not None:
            on_pass(done, count)
    moves += vertices
    return moves


def sinc_coefficients(pass_band: float, passes: int) -> Floats:
    """c_0 ... c_passes (passes + 1,) of the filter that keeps waves up to ``pass_band``.

    The window blurs the end of the pass band, so the sinc's own is moved out until a wave at
    ``pass_band`` keeps the part ``KEPT``, or as far as there is room.
    """
    theta = np.arccos(1.0 - 0.5 * pass_band)
    order = np.arange(passes + 1)
    low, high = 0.0, np.pi - theta
    # Each step halves the range: to the last bit after 60.
    for _ in range(60):
        middle = 0.5 * (low + high)
        kept = float((_terms(theta + middle, passes) * np.cos(order * theta)).sum())
        if kept < KEPT:
            low = middle
        else:
            high = middle
    return _terms(theta + high, passes)


def _terms(theta: float, passes: int) -> Floats:
    """Coefficients of sum 1 of a sinc whose band ends at ``theta``, under the window."""
    order = np.arange(1, passes + 1)
    angles = np.pi * order / (passes + 1.0)
    window = sum(term * np.cos(k * angles) for k, term in enumerate(NUTTALL))
    terms = np.empty(passes + 1)
    terms[0] = theta / np.pi
    terms[1:] = 2.0 * window * np.sin(order * theta) / (order * np.pi)
    return np.asarray(terms / terms.sum())
