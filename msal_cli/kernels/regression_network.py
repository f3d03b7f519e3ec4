"""A small network that weighs candidate normals: layers of products, a block of faces at a time.

The inputs of a face are its vectors along its three axes, one behind the other, and its numbers
(``normal_descriptors``).  Each layer is W x + b, followed by x -> max(x, x / 64) but for the last.
The last one gives a coefficient for each vector; the normal is their combination, normalised.
So where all vectors are one, the normal is that one, whatever the coefficients.

Inputs and vectors are made for FACES at a time, and are not kept.  Every sum over inputs goes from
the first to the last.  ``TILE`` outputs of twice ``LANES`` faces are summed at a time, which takes
half of the registers that any processor has.
"""

import numpy as np

from msal_cli.kernels.lanes import LANES, choose_greater, fill_lanes, load_lanes, store_lanes
from msal_cli.kernels.library import compiled
from msal_cli.kernels.near_blocks import GUIDES, R1
from msal_cli.kernels.normal_descriptors import CHUNK, FACES, S1, S2, S3, SUMS, lay_inputs
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO, longest_row

TILE = np.uint64(4)
"""Outputs that are summed at a time; layers have a multiple of it, filled up with zeros."""

LEAK = np.float32(1.0 / 64.0)

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = 1e-12


@compiled
def _multiply(n_in, n_out, weights, at, x, y, leak):
    """One layer: ``y`` of ``x``; from ``at`` on are n_out biases, then the matrix.

    Of the matrix ``TILE`` rows are beside each other: for each input their weights.  Returns where
    the next layer begins.
    """
    row, step = at + n_out, n_in * TILE
    slope, zero = fill_lanes(leak), fill_lanes(_0)
    for o in range(ZERO, n_out, TILE):
        bias = at + o
        for face in range(ZERO, FACES, LANES + LANES):
            a0 = a1 = fill_lanes(weights[bias])
            b0 = b1 = fill_lanes(weights[bias + ONE])
            c0 = c1 = fill_lanes(weights[bias + TWO])
            d0 = d1 = fill_lanes(weights[bias + THREE])
            of, of_end, w = np.uint64(face), face + n_in * S1, row
            while of < of_end:
                x0, x1 = load_lanes(x, of), load_lanes(x, of + LANES)
                weight = fill_lanes(weights[w])
                a0, a1 = a0 + weight * x0, a1 + weight * x1
                weight = fill_lanes(weights[w + ONE])
                b0, b1 = b0 + weight * x0, b1 + weight * x1
                weight = fill_lanes(weights[w + TWO])
                c0, c1 = c0 + weight * x0, c1 + weight * x1
                weight = fill_lanes(weights[w + THREE])
                d0, d1 = d0 + weight * x0, d1 + weight * x1
                of += S1
                w += TILE
            to = o * S1 + face
            store_lanes(y, to, choose_greater(a0, zero, a0, a0 * slope))
            store_lanes(y, to + LANES, choose_greater(a1, zero, a1, a1 * slope))
            to += S1
            store_lanes(y, to, choose_greater(b0, zero, b0, b0 * slope))
            store_lanes(y, to + LANES, choose_greater(b1, zero, b1, b1 * slope))
            to += S1
            store_lanes(y, to, choose_greater(c0, zero, c0, c0 * slope))
            store_lanes(y, to + LANES, choose_greater(c1, zero, c1, c1 * slope))
            to += S1
            store_lanes(y, to, choose_greater(d0, zero, d0, d0 * slope))
            store_lanes(y, to + LANES, choose_greater(d1, zero, d1, d1 * slope))
        row += step
    return row


@compiled
def predict_normals(
    start,
    stop,
    points,
    units,
    unit,
    near_start,
    near,
    known,
    records,
    statistics,
    others,
    is_later,
    n_vectors,
    n_in,
    n_hidden,
    n_out,
    weights,
    normals,
):
    """The unit normals (m, 3), flat, of a network with two hidden layers; see ``lay_inputs``.

    ``n_in`` is the number of inputs, ``n_hidden`` and ``n_out`` are multiples of ``TILE``, the
    last of at least ``n_vectors``.  ``weights`` has the three layers one behind another.
    """
    n_in, n_hidden, n_out = np.uint64(n_in), np.uint64(n_hidden), np.uint64(n_out)
    of = points, units, unit, near_start, near, known, records, statistics, others
    widest = longest_row(start, stop, near_start) + ONE
    faces = np.empty(np.int64(widest * R1), dtype=np.uint32)
    block = np.empty(np.int64((CHUNK + ONE) * GUIDES), dtype=np.float32)
    counts, scales = np.empty(8, dtype=np.float32), np.empty(8)
    sums = np.empty(np.int64(SUMS), dtype=np.float32)
    vectors = np.zeros(np.int64(S3) * n_vectors, dtype=np.float32)
    x = np.zeros(np.int64(n_in * S1), dtype=np.float32)
    first_layer = np.empty(np.int64(n_hidden * S1), dtype=np.float32)
    second_layer = np.empty(np.int64(n_hidden * S1), dtype=np.float32)
    shares = np.empty(np.int64(n_out * S1), dtype=np.float32)
    last, n_vectors = np.uint64(stop), np.uint64(n_vectors)
    for chunk in range(np.uint64(start), last, FACES):
        for group in range(ZERO, min(FACES, last - chunk), LANES):
            first = chunk + group
            lay_inputs(
                first, last, group, of, is_later, faces, counts, scales, block, sums, vectors, x
            )
        at = _multiply(n_in, n_hidden, weights, ZERO, x, first_layer, LEAK)
        at = _multiply(n_hidden, n_hidden, weights, at, first_layer, second_layer, LEAK)
        _multiply(n_hidden, n_out, weights, at, second_layer, shares, _1)
        for lane in range(min(FACES, last - chunk)):
            nx = ny = nz = np.float64(0.0)
            at = lane
            for k in range(n_vectors):
                share = shares[k * S1 + lane]
                nx += share * vectors[at]
                ny += share * vectors[at + S1]
                nz += share * vectors[at + S2]
                at += S3
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            is_there = length > _TINY
            to = THREE * (chunk + lane)
            normals[to] = nx / length if is_there else vectors[lane]
            normals[to + ONE] = ny / length if is_there else vectors[S1 + lane]
            normals[to + TWO] = nz / length if is_there else vectors[S2 + lane]
