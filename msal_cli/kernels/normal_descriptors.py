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
from msal_cli.kernels.lanes import (
    LANES,
    choose_greater,
    fill_lanes,
    load_columns,
    load_lanes,
    load_rows,
    root,
    store_lanes,
)
from msal_cli.kernels.local_frames import find_axes, turn_axis
from msal_cli.kernels.near_blocks import (
    ENTRY,
    FOUR,
    GUIDES,
    LATER_GUIDES,
    R1,
    R2,
    R3,
    R4,
    R7,
    R9,
    R10,
    R13,
    R16,
    RECORD,
    add_narrow,
    add_pair,
    add_plane,
    add_ranges,
    add_scatter,
    add_skews,
    add_tensor,
    fit_plane,
    lay_guides,
    lay_neighbours,
    list_neighbours,
    normalise,
)
from msal_cli.kernels.vectors import ONE, TWO, ZERO, most_neighbours

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

_FIRST, _SECOND, _THIRD, _FOURTH = (np.float32(1.0 / s**2) for s in (0.25, 0.5, 0.3, 0.6))
_PER_MOST = np.float32(1.0 / 64.0)

OWN_VECTORS, OWN_NUMBERS = 8, 12
"""Vectors and numbers of a face that ``describe`` writes down, the numbers with room for the unit;
``lay_inputs`` makes the others."""

_OWN_VECTORS, _OWN_NUMBERS = np.uint64(3 * OWN_VECTORS), np.uint64(OWN_NUMBERS)
_OTHERS = np.uint64(3 * 4)
_FIVE, _NINE, _TEN = np.uint64(5), np.uint64(9), np.uint64(10)

FACES = np.uint64(16)
"""Faces whose inputs are side by side for a network: they fit a first-level cache."""

S1, S2, S3 = (FACES * np.uint64(rows) for rows in range(1, 4))
"""What so many rows of them take."""


@compiled
def describe(start, stop, points, marks, per_reach, near_start, near, table, numbers, axes):
    """Fill the vectors up to the planes, the first ten numbers and the axes of each face.

    ``table`` has OWN_VECTORS of each face, ``numbers`` OWN_NUMBERS, ``axes`` three vectors; all are
    flat and in single precision, but for ``points``; see ``lay_neighbours``.
    """
    widest = most_neighbours(start, stop, near_start) + ONE
    faces = np.empty(np.int64(widest * R1), dtype=np.uint32)
    block = np.empty(np.int64(widest * ENTRY), dtype=np.float32)
    counts, scales = np.empty(8, dtype=np.float32), np.empty(8)
    vectors = np.empty(np.int64(R1 * _OWN_VECTORS), dtype=np.float32)
    own_numbers = np.empty(np.int64(R10), dtype=np.float32)
    own_axes = np.empty(np.int64(R9), dtype=np.float32)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        rows = list_neighbours(first, last, near_start, near, per_reach, faces, counts, scales)
        close = lay_neighbours(rows, points, marks, faces, counts, scales, block)
        _describe_block(rows, close, marks, faces, counts, block, vectors, own_numbers, own_axes)
        for lane in range(LANES):
            if first + lane >= last:
                break
            f = first + lane
            place = _OWN_VECTORS * f
            for k in range(_OWN_VECTORS):
                table[place + k] = vectors[k * R1 + lane]
            place = _NINE * f
            for k in range(_NINE):
                axes[place + k] = own_axes[k * R1 + lane]
            place = _OWN_NUMBERS * f
            for k in range(_TEN):
                numbers[place + k] = own_numbers[k * R1 + lane]


@compiled
def _store_vector(vectors, place, vector):
    """Write three lanes as the vector of that place."""
    at = np.uint64(place) * R3
    store_lanes(vectors, at, vector[0])
    store_lanes(vectors, at + R1, vector[1])
    store_lanes(vectors, at + R2, vector[2])


@compiled
def _describe_block(rows, close, marks, faces, counts, block, vectors, numbers, axes):
    """The vectors, numbers and axes of the faces of a block, of which ``close`` rows are within
    the narrow reach."""
    x, y, z, _ = load_columns(marks, load_rows(faces, ZERO), FOUR, ZERO)
    own = (x, y, z)
    _store_vector(vectors, NORMAL, own)
    narrow, x, y, z = add_narrow(close, block)
    mean = normalise((x, y, z), own)
    _store_vector(vectors, NARROW_MEAN, mean)
    first, x, y, z, second, bx, by, bz = add_ranges(rows, _WIDE_1, _WIDE_2, block)
    _store_vector(vectors, WIDE_FILTERED - 1, normalise((x, y, z), own))
    base = normalise((bx, by, bz), own)
    _store_vector(vectors, WIDE_FILTERED, base)
    third, x, y, z, wide, bx, by, bz = add_ranges(rows, _WIDE_3, _0, block)
    _store_vector(vectors, WIDE_FILTERED + 1, normalise((x, y, z), own))
    _store_vector(vectors, WIDE_MEAN, normalise((bx, by, bz), own))
    normal, deviation, height, off = fit_plane(add_plane(rows, _0, block), base)
    _store_vector(vectors, PLANE, normal)
    normal, _, _, _ = fit_plane(add_plane(rows, _WIDE_2, block), base)
    _store_vector(vectors, PLANE + 1, normal)
    a, b, c, _, middle, least = find_axes(add_tensor(rows, block))
    skews = add_skews(rows, (*a, *b, *c), block)
    _store_vector(axes, 0, turn_axis(skews[0], a))
    _store_vector(axes, 1, turn_axis(skews[1], b))
    _store_vector(axes, 2, turn_axis(skews[2], c))
    greatest, scatter = add_scatter(close, mean, block)
    zero, one, tiny = fill_lanes(_0), fill_lanes(_1), fill_lanes(_TINY)
    narrow = one / choose_greater(narrow, tiny, narrow, tiny)
    wide = one / choose_greater(wide, tiny, wide, tiny)
    middle, least = middle * wide, least * wide
    _store_vector(numbers, 0, (first * wide, second * wide, third * wide))
    middle = root(choose_greater(middle, zero, middle, zero))
    least = root(choose_greater(least, zero, least, zero))
    deviation = root(choose_greater(deviation, zero, deviation, zero))
    _store_vector(numbers, 1, (middle, least, deviation))
    near_share = load_lanes(counts, ZERO) * fill_lanes(_PER_MOST)
    _store_vector(numbers, 2, (height, root(off), near_share))
    store_lanes(numbers, _NINE * R1, root(root(greatest * (scatter * narrow))))


@compiled
def lay_inputs(first, last, group, of, is_later, faces, counts, scales, block, spare, vectors, x):
    """Put the inputs and the vectors of the faces ``first`` to ``last``, eight at most, side by
    side.

    They are the columns from ``group`` on of ``x`` and ``vectors``, whose rows have FACES.  The
    inputs are the vectors along the axes, one behind the other, then NUMBERS and the statistics.

    Parameters
    ----------
    of : ``points``, ``marks``, ``per_reach``, ``near_start`` and ``near``; ``table``, ``numbers``
        and ``axes`` that ``describe`` has filled; ``records`` of ``lay_guides``; ``statistics``
        (m, 5); ``others`` (m, 12), four vectors of each face; flat.
    is_later : whether vectors of earlier stages are in the records.
    faces, counts, scales, block, spare : memory.
    """
    points, _, per_reach, near_start, near, table, numbers, axes, records, statistics, others = of
    rows = list_neighbours(first, last, near_start, near, per_reach, faces, counts, scales)
    means = lay_guides(rows, points, records, is_later, faces, counts, scales, block)
    ids = load_rows(faces, ZERO)
    ax, ay, az, bx = load_columns(axes, ids, _NINE, ZERO)
    by, bz, cx, cy = load_columns(axes, ids, _NINE, FOUR)
    _, _, _, cz = load_columns(axes, ids, _NINE, _FIVE)
    own = (ax, ay, az), (bx, by, bz), (cx, cy, cz)
    to = group
    for column in range(ZERO, _OWN_VECTORS, _OTHERS):
        _copy_vectors(table, ids, _OWN_VECTORS, column, own, vectors, x, to)
        to += FOUR * S3
    entry = LATER_GUIDES if is_later else GUIDES
    normal, filtered, mean, other = R1, R4, R7, R10
    _filter(rows, entry, filtered, normal, _FIRST, _SECOND, block, own, vectors, x, to)
    to += S3 + S3
    _filter(rows, entry, filtered, filtered, _FIRST, _SECOND, block, own, vectors, x, to)
    to += S3 + S3
    _filter(rows, entry, mean, mean, _FIRST, _WIDE_2, block, own, vectors, x, to)
    to += S3 + S3
    _copy_vectors(others, ids, _OTHERS, ZERO, own, vectors, x, to)
    _keep_normals(group, to, own, vectors, x)
    to += FOUR * S3
    _filter(rows, entry, other, normal, _THIRD, _FOURTH, block, own, vectors, x, to)
    to += S3 + S3
    if is_later:
        _store_seen(_load(block, R13), own, vectors, x, to)
        _store_seen(_load(block, R16), own, vectors, x, to + S3)
        to += S3 + S3
        _filter(rows, entry, R16, R13, _THIRD, _FOURTH, block, own, vectors, x, to)
        to += S3 + S3
    _lay_numbers(numbers, records, statistics, means, ids, counts, spare, x, to)


@compiled
def _load(block, at):
    return load_lanes(block, at), load_lanes(block, at + R1), load_lanes(block, at + R2)


@compiled
def _store_seen(vector, axes, vectors, x, to):
    """Write a vector, and as three inputs what it is along the axes."""
    vx, vy, vz = vector
    store_lanes(vectors, to, vx)
    store_lanes(vectors, to + S1, vy)
    store_lanes(vectors, to + S2, vz)
    for axis in range(3):
        ax, ay, az = axes[axis]
        store_lanes(x, to, vx * ax + vy * ay + vz * az)
        to += S1


@compiled
def _copy_vectors(array, ids, width, column, axes, vectors, x, to):
    """Write four vectors of the faces, from a column of ``array`` on."""
    px, py, pz, qx = load_columns(array, ids, width, column)
    qy, qz, rx, ry = load_columns(array, ids, width, column + FOUR)
    rz, sx, sy, sz = load_columns(array, ids, width, column + FOUR + FOUR)
    _store_seen((px, py, pz), axes, vectors, x, to)
    _store_seen((qx, qy, qz), axes, vectors, x, to + S3)
    _store_seen((rx, ry, rz), axes, vectors, x, to + S3 + S3)
    _store_seen((sx, sy, sz), axes, vectors, x, to + S3 + S3 + S3)


@compiled
def _keep_normals(group, to, axes, vectors, x):
    """Put the own normal in place of those of four vectors from ``to`` on that are zero."""
    nx, ny = load_lanes(vectors, group), load_lanes(vectors, group + S1)
    nz, zero = load_lanes(vectors, group + S2), fill_lanes(_0)
    for _ in range(4):
        vx, vy = load_lanes(vectors, to), load_lanes(vectors, to + S1)
        vz = load_lanes(vectors, to + S2)
        square = vx * vx + vy * vy + vz * vz
        vx, vy = choose_greater(square, zero, vx, nx), choose_greater(square, zero, vy, ny)
        _store_seen((vx, vy, choose_greater(square, zero, vz, nz)), axes, vectors, x, to)
        to += S3


@compiled
def _filter(rows, entry_size, guide, normal, per_1, per_2, block, axes, vectors, x, to):
    """Write normals filtered by guides, with two ranges given by 1 / s^2."""
    first, second = add_pair(rows, entry_size, guide, normal, per_1, per_2, block)
    kept = _load(block, normal)
    _store_seen(normalise(first, kept), axes, vectors, x, to)
    _store_seen(normalise(second, kept), axes, vectors, x, to + S3)


@compiled
def _lay_numbers(numbers, records, statistics, means, ids, counts, spare, x, to):
    """The numbers of faces as inputs; ``means`` are the sums of ``lay_guides``."""
    areas, scatter, first, second, third, sideways = means
    per_count = fill_lanes(_1) / (load_lanes(counts, ZERO) + fill_lanes(_1))
    for column in range(ZERO, _OWN_NUMBERS, FOUR):
        a, b, c, d = load_columns(numbers, ids, _OWN_NUMBERS, column)
        store_lanes(x, to + column * S1, a)
        store_lanes(x, to + column * S1 + S1, b)
        store_lanes(x, to + column * S1 + S2, c)
        store_lanes(x, to + column * S1 + S3, d)
    store_lanes(x, to + _TEN * S1, scatter * per_count)
    to += _OWN_NUMBERS * S1
    _, _, _, area = load_columns(records, ids, RECORD, ZERO)
    store_lanes(spare, ZERO, areas)
    store_lanes(spare, R1, area)
    for lane in range(LANES):
        mean = spare[lane] / (np.float64(counts[lane]) + 1.0)
        both = spare[R1 + lane] + mean
        share = spare[R1 + lane] / both if both > 0.0 else 0.5
        spare[lane] = np.float32(share)
    store_lanes(x, to, load_lanes(spare, ZERO))
    to += S1
    for column in range(FOUR * TWO, RECORD, FOUR):
        _, _, _, ripple = load_columns(records, ids, RECORD, column)
        store_lanes(x, to, ripple)
        to += S1
    store_lanes(x, to, first * per_count)
    store_lanes(x, to + S1, second * per_count)
    store_lanes(x, to + S2, third * per_count)
    store_lanes(x, to + S3, sideways * per_count)
    to += FOUR * S1
    a, b, c, d = load_columns(statistics, ids, _FIVE, ZERO)
    _, _, _, e = load_columns(statistics, ids, _FIVE, ONE)
    store_lanes(x, to, a)
    store_lanes(x, to + S1, b)
    store_lanes(x, to + S2, c)
    store_lanes(x, to + S3, d)
    store_lanes(x, to + FOUR * S1, e)
