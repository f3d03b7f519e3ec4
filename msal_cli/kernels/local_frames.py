"""Eigenvectors of eight symmetric 3 x 3 matrices at once, by Jacobi's rotations in lanes."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.lanes import choose_greater, fill_lanes, root

SWEEPS = 4
"""Rounds of three rotations: what is left beside the diagonal is below single precision."""

_0, _1, _2 = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_MINUS, _TINY = np.float32(-1.0), np.float32(1e-30)


@compiled
def find_axes(tensor):
    """Unit eigenvectors, three of three lanes, and eigenvalues, greatest first.

    ``tensor`` are the lanes xx, xy, xz, yy, yz, zz.
    """
    xx, xy, xz, yy, yz, zz = tensor
    zero, one = fill_lanes(_0), fill_lanes(_1)
    a, b, c = (one, zero, zero), (zero, one, zero), (zero, zero, one)
    for _ in range(SWEEPS):
        xx, yy, xy, xz, yz, a, b = _rotate(xx, yy, xy, xz, yz, a, b)
        xx, zz, xz, xy, yz, a, c = _rotate(xx, zz, xz, xy, yz, a, c)
        yy, zz, yz, xy, xz, b, c = _rotate(yy, zz, yz, xy, xz, b, c)
    xx, yy, a, b = _sort(xx, yy, a, b)
    yy, zz, b, c = _sort(yy, zz, b, c)
    xx, yy, a, b = _sort(xx, yy, a, b)
    return a, b, c, xx, yy, zz


@compiled
def _rotate(p, q, off, rest_p, rest_q, first, second):
    """One rotation of two axes, by the smaller angle that makes ``off`` zero.

    ``p`` and ``q`` are their entries of the diagonal, ``off`` is the one of both, ``rest_p`` and
    ``rest_q`` those with the third axis.
    """
    zero, one, minus = fill_lanes(_0), fill_lanes(_1), fill_lanes(_MINUS)
    gap = q - p
    size = choose_greater(zero, gap, gap * minus, gap)
    double = fill_lanes(_2) * off
    t = double / (size + root(gap * gap + double * double) + fill_lanes(_TINY))
    t = choose_greater(zero, gap, t * minus, t)
    c = one / root(one + t * t)
    s = t * c
    change = t * off
    ax, ay, az = first
    bx, by, bz = second
    return (
        p - change,
        q + change,
        zero,
        c * rest_p - s * rest_q,
        s * rest_p + c * rest_q,
        (c * ax - s * bx, c * ay - s * by, c * az - s * bz),
        (s * ax + c * bx, s * ay + c * by, s * az + c * bz),
    )


@compiled
def _sort(p, q, first, second):
    """Two eigenvalues and their axes, the greater first."""
    ax, ay, az = first
    bx, by, bz = second
    return (
        choose_greater(q, p, q, p),
        choose_greater(q, p, p, q),
        (choose_greater(q, p, bx, ax), choose_greater(q, p, by, ay), choose_greater(q, p, bz, az)),
        (choose_greater(q, p, ax, bx), choose_greater(q, p, ay, by), choose_greater(q, p, az, bz)),
    )


@compiled
def turn_axis(skew, axis):
    """The axis, turned round where ``skew`` is negative."""
    x, y, z = axis
    zero, minus = fill_lanes(_0), fill_lanes(_MINUS)
    return (
        choose_greater(zero, skew, x * minus, x),
        choose_greater(zero, skew, y * minus, y),
        choose_greater(zero, skew, z * minus, z),
    )
