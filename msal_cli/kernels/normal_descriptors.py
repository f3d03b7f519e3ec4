"""What is known of the normal of a face: filtered normals of many widths, and how they spread.

For every face a row of unit vectors (``VECTORS``) and a row of numbers (``NUMBERS``), both from
the faces near it.  Lengths are in local units: the mean distance from the face's centroid to those
of the faces that touch it.  With w = A (1 - d^2 / R^2)^2 for the reaches R = 1.5 and 2.8, areas A
and distances d of centroids, a filtered normal is the normalised sum over the faces j near i of

    w (1 - |g_i - g_j|^2 / s^2)^2 n_j,    the bracket zero beyond the range s,

where the guides g are the normals themselves or some that were filtered before: bilateral means
whose Gaussians are replaced by biweights, which need no exponential and end where the
neighbourhood does.  Planes are fitted to the centroids with the same weights: with C their
covariance, the plane that fits the heights along b best has the normal C^-1 b, up to its length.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.local_frames import find_axes, turn_axes
from msal_cli.kernels.near_blocks import (
    ENTRY,
    FIVE,
    FOUR,
    LANES,
    R1,
    R2,
    R3,
    R4,
    R6,
    R9,
    R10,
    R12,
    R16,
    SIX,
    add_narrow,
    add_pair,
    add_plane,
    add_ranges,
    add_scatter,
    add_skews,
    add_tensor,
    fit_plane,
    lay_neighbours,
    lay_vectors,
    normalise,
    weigh_block,
)
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO, most_neighbours

WIDE_RANGES = (0.4, 0.7, 1.2)
"""Ranges s of the differences between unit normals; one more mean has all of them."""

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-30)
_WIDE_1, _WIDE_2, _WIDE_3 = (np.float32(1.0 / s**2) for s in WIDE_RANGES)


VECTORS = 14
"""Unit vectors of a face, beside those of other filters and of earlier stages."""

NORMAL = 0
NARROW_MEAN = 1
WIDE_FILTERED = 3
WIDE_MEAN = 5
PLANE = 6
REFINED = 8
TWICE = 10
WIDER = 12
"""The places of: the face's own normal; the narrow mean; the wide ranges 0.4, 0.7 and 1.2 from 2
on, and all; planes (wide, wide of range 0.7); the normals filtered by the second wide range; that
range once more; the wide mean once more."""

NUMBERS = 21
"""Numbers of a face: the shares of the wide weight within each range; the roots of the second and
third eigenvalue; the deviation from the wide plane, the height above it, the distance from its
middle; faces near; scatter of the normals, its mean among those near; the own unit, and the own
area, each over itself plus the mean; the four ripples, their means among those near."""

DEVIATION, SCATTER, UNIT = 5, 9, 11
"""The places of the deviation from the plane, the own scatter, the own unit."""

_PER_MOST = np.float32(1.0 / 64.0)


@compiled
def describe(
    start, stop, points, marks, per_reach, near_start, near, width, table, per_face, numbers, axes
):
    """Fill the vectors up to the planes, and the first ten numbers, of each face.

    ``table`` has ``width`` vectors of each face, ``numbers`` ``per_face`` numbers, ``axes`` three
    vectors; all are flat and in single precision, but for ``points``; see ``lay_neighbours``.
    """
    widest = most_neighbours(start, stop, near_start) + ONE
    block = np.empty(np.int64(widest * ENTRY), dtype=np.float32)
    sums = np.empty(np.int64(R16 * np.uint64(3)), dtype=np.float32)
    vectors = np.empty(np.int64(R3 * np.uint64(REFINED)), dtype=np.float32)
    values = np.empty(np.int64(R6), dtype=np.float32)
    own_axes = np.empty(np.int64(R9), dtype=np.float32)
    spread = np.empty(np.int64(R6), dtype=np.float32)
    skews = np.empty(np.int64(R3), dtype=np.float32)
    scatter = np.empty(np.int64(R2), dtype=np.float32)
    own = np.empty(np.int64(R3), dtype=np.float32)
    last, per_face = np.uint64(stop), np.uint64(per_face)
    wide, narrow = ZERO, R16
    tensor = narrow + R4
    planes = tensor + R6
    for first in range(np.uint64(start), last, LANES):
        rows = lay_neighbours(first, last, points, marks, per_reach, near_start, near, block, own)
        close = weigh_block(rows, block, own)
        add_narrow(close, block, sums, narrow)
        add_ranges(rows, _WIDE_1, _WIDE_2, _WIDE_3, block, sums, wide)
        add_tensor(rows, block, sums, tensor)
        add_plane(rows, _0, block, sums, planes)
        add_plane(rows, _WIDE_2, block, sums, planes + R10)
        for at in range(R3):
            vectors[at] = own[at]
        normalise(sums, narrow + R1, own, vectors, np.uint64(NARROW_MEAN))
        for k in range(np.uint64(4)):
            normalise(sums, wide + k * R4 + R1, own, vectors, TWO + k)
        base = np.uint64(WIDE_FILTERED)
        fit_plane(sums, planes, base, vectors, np.uint64(PLANE), ZERO, spread)
        fit_plane(sums, planes + R10, base, vectors, np.uint64(PLANE) + ONE, R3, spread)
        find_axes(sums, tensor, own_axes, values)
        add_skews(rows, own_axes, block, skews)
        turn_axes(skews, own_axes)
        for at in range(R3):
            skews[at] = vectors[R3 * np.uint64(NARROW_MEAN) + at]
        add_scatter(close, skews, block, scatter)
        for lane in range(LANES):
            if first + lane >= last:
                break
            f = first + lane
            place = THREE * np.uint64(width) * f
            for k in range(THREE * np.uint64(REFINED)):
                table[place + k] = vectors[k * R1 + lane]
            for k in range(np.uint64(9)):
                axes[np.uint64(9) * f + k] = own_axes[k * R1 + lane]
            _write_numbers(lane, sums, values, spread, scatter, numbers, per_face * f)
            near_count = np.float32(near_start[f + ONE] - near_start[f])
            numbers[per_face * f + np.uint64(8)] = near_count * _PER_MOST


@compiled
def _write_numbers(lane, sums, values, spread, scatter, numbers, to):
    """The numbers of one face but those of its neighbours', from the sums of its block."""
    narrow = sums[lane + R16]
    narrow = _1 / (narrow if narrow > _TINY else _TINY)
    wide = sums[lane + R12]
    wide = _1 / (wide if wide > _TINY else _TINY)
    for k in range(THREE):
        numbers[to + k] = sums[lane + k * R4] * wide
    second, third = values[R1 + lane] * wide, values[R2 + lane] * wide
    numbers[to + np.uint64(3)] = np.sqrt(second if second > _0 else _0)
    numbers[to + np.uint64(4)] = np.sqrt(third if third > _0 else _0)
    square = spread[lane]
    numbers[to + np.uint64(DEVIATION)] = np.sqrt(square if square > _0 else _0)
    numbers[to + np.uint64(6)] = spread[R1 + lane]
    numbers[to + np.uint64(7)] = np.sqrt(spread[R2 + lane])
    mean = scatter[R1 + lane] * narrow
    numbers[to + np.uint64(SCATTER)] = np.sqrt(np.sqrt(scatter[lane] * mean))


@compiled
def average_around(start, stop, marks, near_start, near, ripples, per_face, numbers):
    """Fill the numbers that a face takes from those near, and its own ripples.

    ``ripples`` has five numbers of each face; the first is its scatter.
    """
    per_face = np.uint64(per_face)
    for f in range(np.uint64(start), np.uint64(stop)):
        own = FIVE * f
        total, first, second = ripples[own], ripples[own + ONE], ripples[own + TWO]
        third, sideways = ripples[own + THREE], ripples[own + FOUR]
        area = marks[FOUR * f + THREE]
        row, end = near_start[f], near_start[f + ONE]
        for entry in range(row, end):
            j = np.uint64(near[entry])
            at = FIVE * j
            total += ripples[at]
            first += ripples[at + ONE]
            second += ripples[at + TWO]
            third += ripples[at + THREE]
            sideways += ripples[at + FOUR]
            area += marks[FOUR * j + THREE]
        per_count = _1 / np.float32(end - row + ONE)
        to = per_face * f
        numbers[to + np.uint64(10)] = total * per_count
        mean = area / np.float64(end - row + ONE)
        both = marks[FOUR * f + THREE] + mean
        share = marks[FOUR * f + THREE] / both if both > 0.0 else 0.5
        numbers[to + np.uint64(12)] = np.float32(share)
        for k in range(FOUR):
            numbers[to + np.uint64(13) + k] = ripples[own + ONE + k]
        numbers[to + np.uint64(17)] = first * per_count
        numbers[to + np.uint64(18)] = second * per_count
        numbers[to + np.uint64(19)] = third * per_count
        numbers[to + np.uint64(20)] = sideways * per_count


@compiled
def filter_jointly(
    start,
    stop,
    points,
    marks,
    per_reach,
    near_start,
    near,
    tasks,
    ranges,
    n_read,
    width,
    read,
    table,
):
    """Fill two vectors for each task: filtered normals of two ranges.

    A row of ``tasks`` has the places of the guide and of the normals in ``read``, which has
    ``n_read`` vectors of each face, and that of the first outcome in ``table``, which has
    ``width``.  Its row of ``ranges`` has 1 / s^2 of both.
    """
    width, n_read = THREE * np.uint64(width), np.uint64(n_read)
    entry_size = (THREE * n_read + ONE) * R1
    widest = most_neighbours(start, stop, near_start) + ONE
    block = np.empty(np.int64(widest * entry_size), dtype=np.float32)
    sums = np.empty(np.int64(R6), dtype=np.float32)
    vectors = np.empty(np.int64(R6), dtype=np.float32)
    own = np.empty(np.int64(R3), dtype=np.float32)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        rows = lay_vectors(
            first, last, points, marks, per_reach, near_start, near, n_read, read, block
        )
        for task in range(len(tasks)):
            guide = R1 + R3 * np.uint64(tasks[task, 0])
            normal = R1 + R3 * np.uint64(tasks[task, 1])
            to = THREE * np.uint64(tasks[task, 2])
            add_pair(rows, entry_size, guide, normal, ranges[task, 0], ranges[task, 1], block, sums)
            for at in range(R3):
                own[at] = block[normal + at]
            normalise(sums, ZERO, own, vectors, ZERO)
            normalise(sums, R3, own, vectors, ONE)
            for lane in range(LANES):
                if first + lane >= last:
                    break
                place = width * (first + lane) + to
                for k in range(SIX):
                    table[place + k] = vectors[k * R1 + lane]
