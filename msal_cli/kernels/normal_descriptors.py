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

import numpy as np

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
from msal_cli.kernels.library import compiled
from msal_cli.kernels.near_blocks import (
    ENTRY,
    FOUR,
    GUIDES,
    R1,
    R2,
    R3,
    R4,
    R6,
    R7,
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
    find_axes,
    fit_plane,
    lay_guides,
    lay_neighbours,
    list_neighbours,
    normalise,
    turn_axis,
)
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO, longest_row

WIDE_RANGES = (0.4, 0.7, 1.2)
"""Ranges s of the differences between unit normals; one more mean has all of them."""

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-30)
_WIDE_1, _WIDE_2, _WIDE_3 = (np.float32(1.0 / s**2) for s in WIDE_RANGES)


VECTORS = 14
"""Unit vectors of a face, beside those of other filters and of earlier stages: its own normal; the
narrow mean; wide means of the ranges 0.4, 0.7 and 1.2, and of all; planes, wide and wide of range
0.7; the normals filtered by the second wide mean; that mean once more; the last one once more."""

WIDE_FILTERED = 3
"""The place of the wide mean of range 0.7."""

NUMBERS = 21
"""Numbers of a face: the shares of the wide weight within each range; the roots of the second and
third eigenvalue; the deviation from the wide plane, the height above it, the distance from its
middle; faces near; scatter of the normals, its mean among those near; the own unit, and the own
area, each over itself plus the mean; the four ripples, their means among those near."""

DEVIATION = 5
"""The place of the deviation from the plane."""

_FIRST, _SECOND, _THIRD, _FOURTH = (np.float32(1.0 / s**2) for s in (0.25, 0.5, 0.3, 0.6))
_PER_MOST = np.float32(1.0 / 64.0)

KNOWN = np.uint64(36)
"""Numbers of a face that ``describe`` writes down and only the face itself needs: the vectors up to
the planes that are not in its record, its axes, and twelve of its NUMBERS, with room for one."""

AXES, OWN_NUMBERS = 15, 24
"""Where among them the axes and the numbers begin."""

CHUNK = np.uint64(8)
"""Neighbours of eight faces that are filtered at a time: they fit a first-level cache."""

PAIRS = (
    (R4, R1, _FIRST, _SECOND),
    (R4, R4, _FIRST, _SECOND),
    (R7, R7, _FIRST, _WIDE_2),
    (R10, R1, _THIRD, _FOURTH),
    (R16, R13, _THIRD, _FOURTH),
)
"""Guides and normals, by their places in a block, that ``lay_inputs`` filters with two ranges each;
the last ones in later stages."""

SUMS = R6 * np.uint64(1 + len(PAIRS))
"""What the sums of a block take."""

_OTHERS = np.uint64(3 * 4)
_FIVE, _TEN, _TWELVE = np.uint64(5), np.uint64(10), np.uint64(12)
_SCATTER, _UNIT, _TO_RECORD = np.uint64(33), np.uint64(35), KNOWN * R1
_OWN_NUMBERS = np.uint64(OWN_NUMBERS)

FACES = np.uint64(32)
"""Faces whose inputs are side by side for a network: they fit a first-level cache."""

S1, S2, S3 = (FACES * np.uint64(rows) for rows in range(1, 4))
"""What so many rows of them take."""


@compiled
def describe(
    start,
    stop,
    points,
    marks,
    units,
    unit,
    near_start,
    near,
    faces,
    ripples,
    others,
    known,
    records,
):
    """Fill in what is known of each face, (m, KNOWN), and its record, see ``lay_guides``.

    The vectors of records are the normal, two means, the first of the ``others``, and two that are
    there before; their numbers are the area, the scatter, and means of the ``ripples`` (n, 4) of
    the corners of ``faces`` in the unit of the face.  Its own of the ``units`` counts over itself
    plus their mean, ``unit``.  Arrays are flat; see ``lay_neighbours``.
    """
    widest = longest_row(start, stop, near_start) + ONE
    listed = np.empty(np.int64(widest * R1), dtype=np.uint32)
    block = np.empty(np.int64(widest * ENTRY), dtype=np.float32)
    counts, scales = np.empty(8, dtype=np.float32), np.empty(8)
    found = np.empty(np.int64(_TO_RECORD + R6), dtype=np.float32)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        rows = list_neighbours(first, last, near_start, near, units, unit, listed, counts, scales)
        close = lay_neighbours(rows, points, marks, listed, counts, scales, block)
        _describe_block(rows, close, marks, listed, counts, block, found)
        for f in range(first, min(first + LANES, last)):
            own, to, lane = KNOWN * f, RECORD * f, f - first
            for k in range(_SCATTER + ONE):
                known[own + k] = found[k * R1 + lane]
            known[own + _UNIT] = np.float32(units[f] / (units[f] + unit))
            for k in range(THREE):
                records[to + k] = marks[FOUR * f + k]
                records[to + FOUR + k] = found[_TO_RECORD + k * R1 + lane]
                records[to + TWO * FOUR + k] = found[_TO_RECORD + R3 + k * R1 + lane]
                records[to + THREE * FOUR + k] = others[_OTHERS * f + k]
            records[to + THREE] = marks[FOUR * f + THREE]
            records[to + THREE + FOUR] = known[own + _SCATTER]
            a, b, c = faces[THREE * f], faces[THREE * f + ONE], faces[THREE * f + TWO]
            per_unit = 1.0 / (3.0 * units[f]) if units[f] > 0.0 else 0.0
            for k in range(FOUR):
                value = (ripples[a, k] + ripples[b, k] + ripples[c, k]) * per_unit
                # Bounded, so that a single spike does not decide a mean.
                place = to + THREE + TWO * FOUR + FOUR * k
                records[place] = np.float32(value / (1.0 + value))


@compiled
def _store_vector(vectors, place, vector):
    """Write three lanes as the vector of that place."""
    at = np.uint64(place) * R3
    store_lanes(vectors, at, vector[0])
    store_lanes(vectors, at + R1, vector[1])
    store_lanes(vectors, at + R2, vector[2])


@compiled
def _describe_block(rows, close, marks, faces, counts, block, found):
    """What is known of the faces of a block, of which ``close`` rows are within the narrow reach,
    and two vectors for their records."""
    x, y, z, _ = load_columns(marks, load_rows(faces, ZERO), FOUR, ZERO)
    own = (x, y, z)
    narrow, x, y, z = add_narrow(close, block)
    mean = normalise((x, y, z), own)
    _store_vector(found, 0, mean)
    first, x, y, z, second, bx, by, bz = add_ranges(rows, _WIDE_1, _WIDE_2, block)
    _store_vector(found, 1, normalise((x, y, z), own))
    base = normalise((bx, by, bz), own)
    _store_vector(found, 12, base)
    third, x, y, z, wide, bx, by, bz = add_ranges(rows, _WIDE_3, _0, block)
    _store_vector(found, 2, normalise((x, y, z), own))
    _store_vector(found, 13, normalise((bx, by, bz), own))
    normal, deviation, height, off = fit_plane(add_plane(rows, _0, block), base)
    _store_vector(found, 3, normal)
    normal, _, _, _ = fit_plane(add_plane(rows, _WIDE_2, block), base)
    _store_vector(found, 4, normal)
    a, b, c, _, middle, least = find_axes(add_tensor(rows, block))
    skews = add_skews(rows, (*a, *b, *c), block)
    _store_vector(found, 5, turn_axis(skews[0], a))
    _store_vector(found, 6, turn_axis(skews[1], b))
    _store_vector(found, 7, turn_axis(skews[2], c))
    greatest, scatter = add_scatter(close, mean, block)
    zero, one, tiny = fill_lanes(_0), fill_lanes(_1), fill_lanes(_TINY)
    narrow = one / choose_greater(narrow, tiny, narrow, tiny)
    wide = one / choose_greater(wide, tiny, wide, tiny)
    middle, least = middle * wide, least * wide
    _store_vector(found, 8, (first * wide, second * wide, third * wide))
    middle = root(choose_greater(middle, zero, middle, zero))
    least = root(choose_greater(least, zero, least, zero))
    deviation = root(choose_greater(deviation, zero, deviation, zero))
    _store_vector(found, 9, (middle, least, deviation))
    near_share = load_lanes(counts, ZERO) * fill_lanes(_PER_MOST)
    _store_vector(found, 10, (height, root(off), near_share))
    store_lanes(found, _SCATTER * R1, root(root(greatest * (scatter * narrow))))


@compiled
def lay_inputs(first, last, group, of, is_later, faces, counts, scales, block, sums, vectors, x):
    """Put the inputs and the vectors of the faces ``first`` to ``last``, eight at most, side by
    side.

    They are the columns from ``group`` on of ``x`` and ``vectors``, whose rows have FACES.  The
    inputs are the vectors along the axes, one behind the other, then NUMBERS and the statistics.

    Parameters
    ----------
    of : ``points``, ``units``, ``unit``, ``near_start`` and ``near``; what is ``known``, and the
        ``records``, from ``describe``; ``statistics`` (m, 5); ``others`` (m, 12), four vectors of
        each face; flat.
    is_later : whether vectors of earlier stages are in the records.
    faces, counts, scales, block, sums : memory.
    """
    points, units, unit, near_start, near, known, records, statistics, others = of
    rows = list_neighbours(first, last, near_start, near, units, unit, faces, counts, scales)
    for at in range(ZERO, SUMS, LANES):
        store_lanes(sums, at, fill_lanes(_0))
    for row in range(ZERO, rows, CHUNK):
        stop = min(row + CHUNK, rows)
        # The face itself stays in the first place.
        begin = GUIDES if row else ZERO
        end = begin + (stop - row) * GUIDES
        lay_guides(row, stop, begin, points, records, is_later, faces, counts, scales, block, sums)
        for pair in range(5 if is_later else 4):
            guide, normal, per_1, per_2 = PAIRS[pair]
            place = R6 * np.uint64(1 + pair)
            add_pair(begin, end, guide, normal, per_1, per_2, block, sums, place)
    ids = load_rows(faces, ZERO)
    nx, ny, nz, px = load_columns(known, ids, KNOWN, ZERO)
    py, pz, qx, qy = load_columns(known, ids, KNOWN, FOUR)
    qz, rx, ry, rz = load_columns(known, ids, KNOWN, FOUR * TWO)
    sx, sy, sz, ax = load_columns(known, ids, KNOWN, FOUR * THREE)
    ay, az, bx, by = load_columns(known, ids, KNOWN, FOUR * FOUR)
    bz, cx, cy, cz = load_columns(known, ids, KNOWN, FOUR * _FIVE)
    own = (ax, ay, az), (bx, by, bz), (cx, cy, cz)
    to = group
    to = _store_seen(_load(block, R1), own, vectors, x, to)
    to = _store_seen((nx, ny, nz), own, vectors, x, to)
    to = _store_seen((px, py, pz), own, vectors, x, to)
    to = _store_seen(_load(block, R4), own, vectors, x, to)
    to = _store_seen((qx, qy, qz), own, vectors, x, to)
    to = _store_seen(_load(block, R7), own, vectors, x, to)
    to = _store_seen((rx, ry, rz), own, vectors, x, to)
    to = _store_seen((sx, sy, sz), own, vectors, x, to)
    for pair in range(3):
        to = _store_pair(pair, block, sums, own, vectors, x, to)
    to = _store_others(others, ids, _load(block, R1), own, vectors, x, to)
    to = _store_pair(3, block, sums, own, vectors, x, to)
    if is_later:
        to = _store_seen(_load(block, R13), own, vectors, x, to)
        to = _store_seen(_load(block, R16), own, vectors, x, to)
        to = _store_pair(4, block, sums, own, vectors, x, to)
    _lay_numbers(known, records, statistics, ids, counts, sums, x, to)


@compiled
def _load(block, at):
    return load_lanes(block, at), load_lanes(block, at + R1), load_lanes(block, at + R2)


@compiled
def _store_seen(vector, axes, vectors, x, to):
    """Write a vector, and as three inputs what it is along the axes; where the next one goes."""
    vx, vy, vz = vector
    store_lanes(vectors, to, vx)
    store_lanes(vectors, to + S1, vy)
    store_lanes(vectors, to + S2, vz)
    for axis in range(3):
        ax, ay, az = axes[axis]
        store_lanes(x, to, vx * ax + vy * ay + vz * az)
        to += S1
    return to


@compiled
def _store_pair(pair, block, sums, axes, vectors, x, to):
    """Write the normals of two ranges that ``add_pair`` has added up."""
    kept, place = _load(block, PAIRS[pair][1]), R6 * np.uint64(1 + pair)
    to = _store_seen(normalise(_load(sums, place), kept), axes, vectors, x, to)
    return _store_seen(normalise(_load(sums, place + R3), kept), axes, vectors, x, to)


@compiled
def _store_others(others, ids, normal, axes, vectors, x, to):
    """Write four vectors of the faces; the own normal in place of those that are zero."""
    px, py, pz, qx = load_columns(others, ids, _OTHERS, ZERO)
    qy, qz, rx, ry = load_columns(others, ids, _OTHERS, FOUR)
    rz, sx, sy, sz = load_columns(others, ids, _OTHERS, FOUR + FOUR)
    nx, ny, nz = normal
    zero = fill_lanes(_0)
    for vx, vy, vz in ((px, py, pz), (qx, qy, qz), (rx, ry, rz), (sx, sy, sz)):
        square = vx * vx + vy * vy + vz * vz
        vx, vy = choose_greater(square, zero, vx, nx), choose_greater(square, zero, vy, ny)
        vz = choose_greater(square, zero, vz, nz)
        to = _store_seen((vx, vy, vz), axes, vectors, x, to)
    return to


@compiled
def _lay_numbers(known, records, statistics, ids, counts, sums, x, to):
    """The numbers of faces as inputs; the first of ``sums`` are those of ``lay_guides``."""
    _, scatter, first = _load(sums, ZERO)
    second, third, sideways = _load(sums, R3)
    per_count = fill_lanes(_1) / (load_lanes(counts, ZERO) + fill_lanes(_1))
    for column in range(ZERO, _TWELVE, FOUR):
        a, b, c, d = load_columns(known, ids, KNOWN, _OWN_NUMBERS + column)
        store_lanes(x, to + column * S1, a)
        store_lanes(x, to + column * S1 + S1, b)
        store_lanes(x, to + column * S1 + S2, c)
        store_lanes(x, to + column * S1 + S3, d)
    store_lanes(x, to + _TEN * S1, scatter * per_count)
    to += _TWELVE * S1
    _, _, _, area = load_columns(records, ids, RECORD, ZERO)
    store_lanes(sums, R1, area)
    for lane in range(LANES):
        mean = sums[lane] / (np.float64(counts[lane]) + 1.0)
        both = sums[R1 + lane] + mean
        share = sums[R1 + lane] / both if both > 0.0 else 0.5
        sums[lane] = np.float32(share)
    store_lanes(x, to, load_lanes(sums, ZERO))
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
