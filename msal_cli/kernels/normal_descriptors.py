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
    NARROW_WEIGHT,
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
    WIDE_WEIGHT,
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

NARROW_RANGES = (0.35, 0.7, 1.1)
WIDE_RANGES = (0.2, 0.4, 0.7, 1.2)
"""Ranges s of the differences between unit normals; one more mean has all of them."""

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-30)
_NARROW_1, _NARROW_2, _NARROW_3 = (np.float32(1.0 / s**2) for s in NARROW_RANGES)
_WIDE_1, _WIDE_2, _WIDE_3, _WIDE_4 = (np.float32(1.0 / s**2) for s in WIDE_RANGES)


VECTORS = 22
"""Unit vectors of a face, beside those of earlier stages."""

NORMAL = 0
NARROW_MEAN = 4
WIDE_FILTERED = 7
WIDE_MEAN = 9
GUIDE = 13
GUIDED = 14
REFINED = 16
TWICE = 18
WIDER = 20
"""The places of: the face's own normal; narrow ranges 0.35, 0.7, 1.1 from 1 on and all; wide ranges
0.2, 0.4, 0.7 and 1.2 from 5 on, and all; planes (wide, wide of range 0.7, narrow) from 10 on; the
guide; the normals filtered twice by it; by the third wide range; the second of these once more,
and the wide mean."""

NUMBERS = 27
"""Numbers of a face: the shares of the weight within each range, narrow and wide (7); the roots of
the second and third eigenvalue; the deviations from the wide and the narrow plane, the height
above the first, the distance from its middle; faces near; scatter of the normals, its least and
mean among those near; the own unit, and the own area, each over itself plus the mean; the four
ripples, their means among those near."""

PATCHES = np.uint64(16)
"""Faces near that may lend their mean as a guide."""

_PER_MOST = np.float32(1.0 / 64.0)


@compiled
def describe(start, stop, points, marks, per_reach, near_start, near, width, table, numbers, axes):
    """Fill the first vectors (all up to the guide) and the first 15 numbers of each face.

    ``table`` has ``width`` vectors of each face, ``numbers`` NUMBERS, ``axes`` three vectors; all
    are flat and in single precision, but for ``points``; see ``lay_neighbours``.
    """
    widest = most_neighbours(start, stop, near_start) + ONE
    block = np.empty(np.int64(widest * ENTRY), dtype=np.float32)
    sums = np.empty(np.int64(R16 * np.uint64(5)), dtype=np.float32)
    vectors = np.empty(np.int64(R3 * np.uint64(13)), dtype=np.float32)
    values = np.empty(np.int64(R6), dtype=np.float32)
    own_axes = np.empty(np.int64(R9), dtype=np.float32)
    spread = np.empty(np.int64(R9), dtype=np.float32)
    skews = np.empty(np.int64(R3), dtype=np.float32)
    scatter = np.empty(np.int64(R2), dtype=np.float32)
    own = np.empty(np.int64(R3), dtype=np.float32)
    last = np.uint64(stop)
    narrow, wide, tensor = ZERO, R16, R16 + R16
    planes = tensor + R9
    for first in range(np.uint64(start), last, LANES):
        rows = lay_neighbours(first, last, points, marks, per_reach, near_start, near, block, own)
        close = weigh_block(rows, block, own)
        add_ranges(close, NARROW_WEIGHT, _NARROW_1, _NARROW_2, _NARROW_3, _0, block, sums, narrow)
        add_ranges(rows, WIDE_WEIGHT, _WIDE_1, _WIDE_2, _WIDE_3, _WIDE_4, block, sums, wide)
        add_tensor(rows, block, sums, tensor)
        add_plane(rows, WIDE_WEIGHT, _0, block, sums, planes)
        add_plane(rows, WIDE_WEIGHT, _WIDE_3, block, sums, planes + R10)
        add_plane(close, NARROW_WEIGHT, _0, block, sums, planes + R10 + R10)
        for at in range(R3):
            vectors[at] = own[at]
        for k in range(np.uint64(4)):
            normalise(sums, narrow + k * R4 + R1, own, vectors, ONE + k)
            normalise(sums, wide + k * R4 + R1, own, vectors, np.uint64(5) + k)
        normalise(sums, tensor + R6, own, vectors, np.uint64(WIDE_MEAN))
        fit_plane(sums, planes, np.uint64(WIDE_FILTERED), vectors, np.uint64(10), ZERO, spread)
        fit_plane(sums, planes + R10, np.uint64(WIDE_FILTERED), vectors, np.uint64(11), R3, spread)
        fit_plane(
            sums, planes + R10 + R10, np.uint64(NARROW_MEAN), vectors, np.uint64(12), R6, spread
        )
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
            for k in range(THREE * np.uint64(GUIDE)):
                table[place + k] = vectors[k * R1 + lane]
            for k in range(np.uint64(9)):
                axes[np.uint64(9) * f + k] = own_axes[k * R1 + lane]
            _write_numbers(lane, sums, values, spread, scatter, numbers, np.uint64(NUMBERS) * f)
            near_count = np.float32(near_start[f + ONE] - near_start[f])
            numbers[np.uint64(NUMBERS) * f + np.uint64(13)] = near_count * _PER_MOST


@compiled
def _write_numbers(lane, sums, values, spread, scatter, numbers, to):
    """The numbers of one face but those of its neighbours', from the sums of its block."""
    narrow = sums[lane + R12]
    narrow = _1 / (narrow if narrow > _TINY else _TINY)
    wide = sums[lane + R16 + R16 + R9]
    wide = _1 / (wide if wide > _TINY else _TINY)
    for k in range(np.uint64(3)):
        numbers[to + k] = sums[lane + k * R4] * narrow
    for k in range(np.uint64(4)):
        numbers[to + THREE + k] = sums[lane + R16 + k * R4] * wide
    second, third = values[R1 + lane] * wide, values[R2 + lane] * wide
    numbers[to + np.uint64(7)] = np.sqrt(second if second > _0 else _0)
    numbers[to + np.uint64(8)] = np.sqrt(third if third > _0 else _0)
    square, other = spread[lane], spread[R6 + lane]
    numbers[to + np.uint64(9)] = np.sqrt(square if square > _0 else _0)
    numbers[to + np.uint64(10)] = np.sqrt(other if other > _0 else _0)
    numbers[to + np.uint64(11)] = spread[R1 + lane]
    numbers[to + np.uint64(12)] = np.sqrt(spread[R2 + lane])
    mean = scatter[R1 + lane] * narrow
    numbers[to + np.uint64(14)] = np.sqrt(np.sqrt(scatter[lane] * mean))


@compiled
def pick_guides(start, stop, marks, near_start, near, ripples, width, table, numbers):
    """Fill the guide of each face and the numbers that it takes from those near.

    The guide is the narrow mean of the face with the least scatter among the first ``PATCHES``
    near: beside an edge one whose patch lies on one side of it.  ``ripples`` has five numbers of
    each face; the first is its scatter.
    """
    width = THREE * np.uint64(width)
    per_face = np.uint64(NUMBERS)
    for f in range(np.uint64(start), np.uint64(stop)):
        own = FIVE * f
        best, least = np.uint64(f), ripples[own]
        total, first, second = least, ripples[own + ONE], ripples[own + TWO]
        third, sideways = ripples[own + THREE], ripples[own + FOUR]
        area = marks[FOUR * f + THREE]
        row, end = near_start[f], near_start[f + ONE]
        for entry in range(row, end):
            j = np.uint64(near[entry])
            at = FIVE * j
            value = ripples[at]
            total += value
            first += ripples[at + ONE]
            second += ripples[at + TWO]
            third += ripples[at + THREE]
            sideways += ripples[at + FOUR]
            area += marks[FOUR * j + THREE]
            if entry - row < PATCHES and value < least:
                best, least = j, value
        for axis in range(THREE):
            value = table[width * best + THREE * np.uint64(NARROW_MEAN) + axis]
            table[width * f + THREE * np.uint64(GUIDE) + axis] = value
        per_count = _1 / np.float32(end - row + ONE)
        to = per_face * f
        numbers[to + np.uint64(15)] = least
        numbers[to + np.uint64(16)] = total * per_count
        mean = area / np.float64(end - row + ONE)
        both = marks[FOUR * f + THREE] + mean
        share = marks[FOUR * f + THREE] / both if both > 0.0 else 0.5
        numbers[to + np.uint64(18)] = np.float32(share)
        for k in range(FOUR):
            numbers[to + np.uint64(19) + k] = ripples[own + ONE + k]
        numbers[to + np.uint64(23)] = first * per_count
        numbers[to + np.uint64(24)] = second * per_count
        numbers[to + np.uint64(25)] = third * per_count
        numbers[to + np.uint64(26)] = sideways * per_count


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
