"""One sweep of the HC algorithm: average, then push back by the neighbourhood's own correction."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.parallel import over_ranges


@compiled
def _averaged(start, stop, o, q, ring_start, ring, alpha, p, b):
    """o input, q previous, p averaged positions, b corrections; letters of Vollmer et al."""
    for i in range(start, stop):
        m = ring_start[i + 1] - ring_start[i]
        qx, qy, qz = q[i, 0], q[i, 1], q[i, 2]
        sx = sy = sz = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            sx += q[k, 0] - qx
            sy += q[k, 1] - qy
            sz += q[k, 2] - qz
        share = 1.0 / m if m else 0.0
        p[i, 0], p[i, 1], p[i, 2] = qx + share * sx, qy + share * sy, qz + share * sz
        # p - (alpha o + (1 - alpha) q), so written that it is zero where nothing moves.
        b[i, 0] = share * sx - alpha * (o[i, 0] - qx)
        b[i, 1] = share * sy - alpha * (o[i, 1] - qy)
        b[i, 2] = share * sz - alpha * (o[i, 2] - qz)


@compiled
def _pushed(start, stop, p, b, ring_start, ring, beta, q):
    for i in range(start, stop):
        m = ring_start[i + 1] - ring_start[i]
        if m == 0:
            continue
        sx = sy = sz = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            sx += b[k, 0]
            sy += b[k, 1]
            sz += b[k, 2]
        share = (1.0 - beta) / m
        q[i, 0] = p[i, 0] - (beta * b[i, 0] + share * sx)
        q[i, 1] = p[i, 1] - (beta * b[i, 1] + share * sy)
        q[i, 2] = p[i, 2] - (beta * b[i, 2] + share * sz)


def pushed_back(
    original: Floats, positions: Floats, ring_start: Ints, ring: Ints, alpha: float, beta: float
) -> Floats:
    """Positions (n, 3) after one sweep from ``positions`` (n, 3); a new array.

    Every vertex goes to the mean p of its row; b is how far p lies from alpha parts of its
    ``original`` (n, 3) and 1 - alpha parts of its previous position; then p is moved back by beta
    parts of its own b and 1 - beta parts of the mean b of its row.  A vertex with an empty row
    stays.
    """
    n = len(positions)
    averaged, corrections = np.empty((n, 3)), np.empty((n, 3))
    over_ranges(_averaged, n, original, positions, ring_start, ring, alpha, averaged, corrections)
    result = positions.copy()
    over_ranges(_pushed, n, averaged, corrections, ring_start, ring, beta, result)
    return result
