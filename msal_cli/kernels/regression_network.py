"""A small network that weighs candidate normals: layers of products, a block of faces at a time.

The inputs of a face are its vectors along its three axes, one behind the other, and its numbers
(``normal_descriptors``).  Each layer is W x + b, followed by x -> max(x, x / 64) but for the last.
The last one gives a coefficient for each vector; the normal is their combination, normalised.
So where all vectors are one, the normal is that one, whatever the coefficients.

Products run over lanes of ``LANES`` faces, and every sum over inputs from the first to the last.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO

LANES = np.uint64(64)
"""Faces that are worked on at a time: with fewer the loops are too short."""

R1, R2, R3, R4, R5, R6, R7 = (np.uint64(64 * rows) for rows in range(1, 8))
"""What so many rows of lanes take."""

STEP = np.uint64(8)
"""Inputs that are added at a time; layers have a multiple of it, filled up with zeros."""

LEAK = np.float32(1.0 / 64.0)

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = 1e-12


@compiled
def _lay_inputs(first, last, width, table, per_face, numbers, axes, x):
    """Put the inputs of the faces ``first`` to ``last`` side by side, a row of lanes for each."""
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        at = np.uint64(9) * f
        ax, ay, az = axes[at], axes[at + ONE], axes[at + TWO]
        at += THREE
        bx, by, bz = axes[at], axes[at + ONE], axes[at + TWO]
        at += THREE
        cx, cy, cz = axes[at], axes[at + ONE], axes[at + TWO]
        at = THREE * width * f
        row = ZERO + lane
        for _ in range(width):
            vx, vy, vz = table[at], table[at + ONE], table[at + TWO]
            x[row] = vx * ax + vy * ay + vz * az
            x[row + R1] = vx * bx + vy * by + vz * bz
            x[row + R2] = vx * cx + vy * cy + vz * cz
            row += R3
            at += THREE
        at = per_face * f
        for _ in range(per_face):
            x[row] = numbers[at]
            row += R1
            at += ONE


@compiled
def _multiply(n_in, n_out, weights, at, x, y, leak):
    """One layer: ``y`` of ``x``; from ``at`` on are n_out biases, then the rows of the matrix.

    Returns where the next layer begins.
    """
    row = at + n_out
    for o in range(n_out):
        to = o * R1
        bias = weights[at + o]
        for lane in range(LANES):
            y[to + lane] = bias
        for i in range(ZERO, n_in, STEP):
            w0, w1 = weights[row], weights[row + ONE]
            w2, w3 = weights[row + TWO], weights[row + THREE]
            w4, w5 = weights[row + np.uint64(4)], weights[row + np.uint64(5)]
            w6, w7 = weights[row + np.uint64(6)], weights[row + np.uint64(7)]
            row += STEP
            of = i * R1
            for lane in range(LANES):
                p = of + lane
                total = y[to + lane] + w0 * x[p]
                total += w1 * x[p + R1]
                total += w2 * x[p + R2]
                total += w3 * x[p + R3]
                total += w4 * x[p + R4]
                total += w5 * x[p + R5]
                total += w6 * x[p + R6]
                total += w7 * x[p + R7]
                y[to + lane] = total
        for lane in range(LANES):
            total = y[to + lane]
            y[to + lane] = total if total > _0 else total * leak
    return row


@compiled
def predict_normals(
    start, stop, width, table, per_face, numbers, axes, n_in, n_hidden, n_out, weights, normals
):
    """The unit normals (m, 3), flat, of a network with two hidden layers.

    ``n_in``, ``n_hidden`` and ``n_out`` are multiples of ``STEP``, the first ones of at least
    as many as there are inputs and vectors.  ``weights`` has the three layers one behind another.
    """
    width, per_face = np.uint64(width), np.uint64(per_face)
    n_in, n_hidden, n_out = np.uint64(n_in), np.uint64(n_hidden), np.uint64(n_out)
    x = np.zeros(np.int64(n_in * R1), dtype=np.float32)
    first_layer = np.empty(np.int64(n_hidden * R1), dtype=np.float32)
    second_layer = np.empty(np.int64(n_hidden * R1), dtype=np.float32)
    shares = np.empty(np.int64(n_out * R1), dtype=np.float32)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        _lay_inputs(first, last, width, table, per_face, numbers, axes, x)
        at = _multiply(n_in, n_hidden, weights, ZERO, x, first_layer, LEAK)
        at = _multiply(n_hidden, n_hidden, weights, at, first_layer, second_layer, LEAK)
        _multiply(n_hidden, n_out, weights, at, second_layer, shares, _1)
        for lane in range(LANES):
            f = first + lane
            if f >= last:
                break
            at = THREE * width * f
            nx = ny = nz = 0.0
            for k in range(width):
                share = shares[k * R1 + lane]
                nx += share * table[at]
                ny += share * table[at + ONE]
                nz += share * table[at + TWO]
                at += THREE
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            at = THREE * width * f
            is_there = length > _TINY
            to = THREE * f
            normals[to] = nx / length if is_there else table[at]
            normals[to + ONE] = ny / length if is_there else table[at + ONE]
            normals[to + TWO] = nz / length if is_there else table[at + TWO]


@compiled
def collect_inputs(start, stop, width, table, per_face, numbers, axes, inputs):
    """The inputs (m, 3 width + per_face) of all faces, for training."""
    width, per_face = np.uint64(width), np.uint64(per_face)
    count = THREE * width + per_face
    x = np.empty(np.int64(count * R1), dtype=np.float32)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        _lay_inputs(first, last, width, table, per_face, numbers, axes, x)
        for lane in range(LANES):
            if first + lane >= last:
                break
            for k in range(count):
                inputs[first + lane, k] = x[k * R1 + lane]
