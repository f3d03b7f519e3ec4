"""Eigenvectors of many symmetric 3 x 3 matrices at once, by Jacobi's rotations in lanes."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.near_blocks import LANES, R1, R2, R3, R4, R5

SWEEPS = 4
"""Rounds of three rotations: what is left beside the diagonal is below single precision."""

_0, _1, _2 = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_TINY = np.float32(1e-30)


@compiled
def _tangent(p, q, off):
    """Tangent of the smaller angle whose rotation makes ``off`` zero beside diagonal p, q."""
    gap = q - p
    size = gap if gap >= _0 else -gap
    double = _2 * off
    turn = double / (size + np.sqrt(gap * gap + double * double) + _TINY)
    return turn if gap >= _0 else -turn


@compiled
def find_axes(tensors, at, axes, values):
    """Unit eigenvectors and eigenvalues, greatest first, of the matrices of all lanes.

    Parameters
    ----------
    tensors : rows of lanes xx, xy, xz, yy, yz, zz from the place ``at`` on.
    axes : gets nine rows of lanes, the coordinates of the first axis first.
    values : gets three rows of lanes.
    """
    for lane in range(LANES):
        for row in range(np.uint64(9)):
            axes[row * R1 + lane] = _1 if row % np.uint64(4) == np.uint64(0) else _0
        o = at + lane
        values[lane] = tensors[o]
        values[R1 + lane] = tensors[o + R3]
        values[R2 + lane] = tensors[o + R5]
        values[R3 + lane] = tensors[o + R1]
        values[R4 + lane] = tensors[o + R2]
        values[R5 + lane] = tensors[o + R4]
    for _ in range(SWEEPS):
        _rotate(R1 - R1, R1, R3, R4, R5, axes, values)
        _rotate(R1 - R1, R2, R4, R3, R5, axes, values)
        _rotate(R1, R2, R5, R3, R4, axes, values)
    _exchange(R1 - R1, R1, axes, values)
    _exchange(R1, R2, axes, values)
    _exchange(R1 - R1, R1, axes, values)


@compiled
def _rotate(p, q, off, rest_p, rest_q, axes, values):
    """One rotation of the axes ``p`` and ``q``, given as the rows of their diagonal entries."""
    first, second = p * np.uint64(3), q * np.uint64(3)
    for lane in range(LANES):
        t = _tangent(values[p + lane], values[q + lane], values[off + lane])
        c = _1 / np.sqrt(_1 + t * t)
        s = t * c
        change = t * values[off + lane]
        values[p + lane] -= change
        values[q + lane] += change
        values[off + lane] = _0
        a, b = values[rest_p + lane], values[rest_q + lane]
        values[rest_p + lane] = c * a - s * b
        values[rest_q + lane] = s * a + c * b
        a, b = axes[first + lane], axes[second + lane]
        axes[first + lane] = c * a - s * b
        axes[second + lane] = s * a + c * b
        a, b = axes[first + R1 + lane], axes[second + R1 + lane]
        axes[first + R1 + lane] = c * a - s * b
        axes[second + R1 + lane] = s * a + c * b
        a, b = axes[first + R2 + lane], axes[second + R2 + lane]
        axes[first + R2 + lane] = c * a - s * b
        axes[second + R2 + lane] = s * a + c * b


@compiled
def _exchange(p, q, axes, values):
    """Exchange two axes where the second has the greater value."""
    first, second = p * np.uint64(3), q * np.uint64(3)
    for lane in range(LANES):
        a, b = values[p + lane], values[q + lane]
        is_less = a < b
        values[p + lane] = b if is_less else a
        values[q + lane] = a if is_less else b
        a, b = axes[first + lane], axes[second + lane]
        axes[first + lane] = b if is_less else a
        axes[second + lane] = a if is_less else b
        a, b = axes[first + R1 + lane], axes[second + R1 + lane]
        axes[first + R1 + lane] = b if is_less else a
        axes[second + R1 + lane] = a if is_less else b
        a, b = axes[first + R2 + lane], axes[second + R2 + lane]
        axes[first + R2 + lane] = b if is_less else a
        axes[second + R2 + lane] = a if is_less else b


@compiled
def turn_axes(skews, axes):
    """Turn each axis round where its row of ``skews`` is negative."""
    for lane in range(LANES):
        for axis in range(np.uint64(3)):
            is_turned = skews[axis * R1 + lane] < _0
            for row in range(axis * np.uint64(3), axis * np.uint64(3) + np.uint64(3)):
                value = axes[row * R1 + lane]
                axes[row * R1 + lane] = -value if is_turned else value
