"""Descriptors of a face for the prediction of its normal: filtered normals and their scatter.

Each face has a row of unit vectors (``VECTORS``) and a row of features (``NUMBERS``), both from the
faces near it.  Lengths are in local units: the mean distance from the face's centroid to those of
the faces that touch it.  With w = A (1 - d^2 / R^2)^2 for two reaches R (``NARROW``, ``WIDE``),
areas A and distances d of centroids, a filtered normal is the normalised sum over the faces j near
i of

    w (1 - |g_i - g_j|^2 / s^2)^2 n_j,    the bracket zero beyond the range s,

where the guides g are the normals themselves or filtered ones: bilateral means with biweights
instead of Gaussians, which need no exponential and have a finite support.  Planes are fitted to the
centroids with the same weights: with C their covariance, the plane that fits the heights along b
best has the normal C^-1 b, up to its length.

Sums over the neighbours of one face are too short for vector code.  So those of eight faces are
computed at once: lanes are faces (``lanes``), and a block has a row for the k-th neighbours of all.
No sum goes across lanes, so that no bit depends on the block, the lane or the thread of a face.  A
vector is three lanes.
"""

import numpy as np

from msal_cli.kernels import vectors as vec
from msal_cli.kernels.lanes import (
    LANES,
    choose_greater,
    choose_vector,
    fill_lanes,
    find_axes,
    has_greater,
    load_columns,
    load_lanes,
    load_offsets,
    load_rows,
    root,
    store_lanes,
)
from msal_cli.kernels.library import compiled
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO, longest_row

NARROW, WIDE = 1.45, 2.7
"""The reaches of both weights, in local units."""

WIDE_RANGES = (0.4, 0.7, 1.2)
"""Ranges s of the differences between unit normals; one more mean has all of them."""

VECTORS = 14
"""Unit vectors of a face, in addition to those of other filters and of earlier stages: its own
normal; the narrow mean; wide means of the ranges 0.4, 0.7 and 1.2, and of all; planes, wide and
wide of range 0.7; the normals filtered with the second wide mean as guide; that mean, and the last,
filtered."""

WIDE_FILTERED = 3
"""Index of the wide mean of range 0.7."""

NUMBERS = 21
"""Features of a face: the shares of the wide weight within each range; the roots of the second and
third eigenvalue; the deviation from the wide plane, the height above it, the distance from its
centre; the number of faces near; scatter of the normals, its mean among those near; the own unit,
and the own area, each over itself plus the mean; the four ripples, their means among those near."""

DEVIATION = 5
"""Index of the deviation from the plane."""

R1, R2, R3, R4, R6, R7, R8, R9, R10, R12, R13, R16, R19 = (
    LANES * np.uint64(rows) for rows in (1, 2, 3, 4, 6, 7, 8, 9, 10, 12, 13, 16, 19)
)
"""Sizes of so many rows of lanes."""

OFFSET, NORMAL, NARROW_WEIGHT, WIDE_WEIGHT, JUMP = ZERO, R3, R6, R7, R8
"""Offsets of a neighbour's rows of lanes in a block; offset and normal have three rows."""

ENTRY = R9
"""Size of a neighbour in a block."""

GUIDES = R19
"""Size of a neighbour in a block of ``_lay_guides``: a weight, and six vectors."""

RECORD = np.uint64(24)
"""Numbers of a face that ``_lay_guides`` reads."""

KNOWN = np.uint64(36)
"""Numbers that ``describe`` stores for a face and only the face itself needs: the vectors up to the
planes that are not in its record, its axes, and twelve of its NUMBERS, with room for one."""

AXES, OWN_NUMBERS = 15, 24
"""Where among them the axes and the features begin."""

CHUNK = np.uint64(8)
"""Neighbours of eight faces that are filtered at once, which fit a first-level cache."""

_0, _1, _MINUS = (np.float32(number) for number in (0.0, 1.0, -1.0))
_TINY, _SMALL, _EVEN = np.float32(1e-30), np.float32(1e-24), np.float32(1e-4)
_RATIO = np.float32((WIDE / NARROW) ** 2)
_WIDE_1, _WIDE_2, _WIDE_3 = (np.float32(1.0 / s**2) for s in WIDE_RANGES)
_FIRST, _SECOND, _THIRD, _FOURTH = (np.float32(1.0 / s**2) for s in (0.25, 0.5, 0.3, 0.6))
_PER_MOST = np.float32(1.0 / 64.0)

PAIRS = (
    (R4, R1, _FIRST, _SECOND),
    (R4, R4, _FIRST, _SECOND),
    (R7, R7, _FIRST, _WIDE_2),
    (R10, R1, _THIRD, _FOURTH),
    (R16, R13, _THIRD, _FOURTH),
)
"""Guides and normals, by their offsets in a block, that ``lay_inputs`` filters with two ranges
each; the last pair in later stages."""

SUMS = R6 * np.uint64(1 + len(PAIRS))
"""Size of the sums of a block."""

_OTHERS = np.uint64(3 * 4)
FOUR, _FIVE, _TEN, _TWELVE = np.uint64(4), np.uint64(5), np.uint64(10), np.uint64(12)
_SCATTER, _UNIT, _TO_RECORD = np.uint64(33), np.uint64(35), KNOWN * R1
_OWN_NUMBERS = np.uint64(OWN_NUMBERS)

FACES = np.uint64(32)
"""Faces in a batch of inputs for the network, which fit a first-level cache."""

S1, S2, S3 = (FACES * np.uint64(rows) for rows in range(1, 4))
"""Sizes of so many rows of them."""


@compiled
def _load_vector(block, at):
    return load_lanes(block, at), load_lanes(block, at + R1), load_lanes(block, at + R2)


@compiled
def _store_vector(block, at, vector):
    store_lanes(block, at, vector[0])
    store_lanes(block, at + R1, vector[1])
    store_lanes(block, at + R2, vector[2])


@compiled
def _zeros():
    return fill_lanes(_0), fill_lanes(_0), fill_lanes(_0)


@compiled
def _greater(a, b):
    """The maximum in each lane."""
    return choose_greater(a, b, a, b)


@compiled
def _biweigh(weight, square, per_square):
    """w (1 - d^2 / R^2)^2, zero beyond the reach or range R, with ``per_square`` = 1 / R^2."""
    part = _greater(fill_lanes(_1) - square * per_square, fill_lanes(_0))
    return weight * part * part


@compiled
def _normalise(vector, kept, least):
    """Normalize a vector; ``kept`` if its square is at most ``least``."""
    square, bound, one = vec.dot(vector, vector), fill_lanes(least), fill_lanes(_1)
    per_length = one / root(choose_greater(square, bound, square, one))
    return choose_vector(square, bound, vec.times(per_length, vector), kept)


# Blocks of near faces


@compiled
def _list_neighbours(first, last, near_start, near, units, unit, faces, counts, scales):
    """List the neighbours of the faces ``first`` to ``last`` in lanes; returns the number of rows.

    The first row of ``faces`` is the faces themselves, which also fill lanes without a k-th
    neighbour; ``counts`` (8,) gets the numbers of neighbours, ``scales`` (8,) one over WIDE local
    units of each face, or over WIDE ``unit`` if that of a face is zero.
    """
    rows = ONE
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        rows = max(rows, near_start[f + ONE] - near_start[f] + ONE)
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        row, end = near_start[f], near_start[f + ONE]
        counts[lane] = np.float32(end - row)
        scales[lane] = 1.0 / ((units[f] if units[f] > 0.0 else unit) * WIDE)
        faces[lane] = f
        place = R1 + lane
        for entry in range(row, end):
            faces[place] = near[entry]
            place += R1
        for _ in range(end - row + ONE, rows):
            faces[place] = f
            place += R1
    return rows


@compiled
def _lay_neighbours(rows, points, marks, faces, counts, scales, block):
    """Fill a block with offsets, normals and weights of both reaches of the listed ``faces``.

    ``points`` are the centroids, ``marks`` normals and areas (m, 4), flat; see ``lanes``.  The
    block also gets |n_i - n_j|^2.  Returns the number of rows with narrow weights above zero.
    """
    zero, one, ratio = fill_lanes(_0), fill_lanes(_1), fill_lanes(_RATIO)
    last, own = load_lanes(counts, ZERO), load_rows(faces, ZERO)
    own_mark = load_columns(marks, own, FOUR, ZERO)
    narrow_rows = ONE
    for k in range(rows):
        near = load_rows(faces, k * R1)
        offset = load_offsets(points, own, near, scales)
        mark = load_columns(marks, near, FOUR, ZERO)
        area = choose_greater(fill_lanes(np.float32(k)), last, zero, mark[3])
        square = vec.dot(offset, offset)
        close = _biweigh(area, square, ratio)
        at = k * ENTRY
        _store_vector(block, at + OFFSET, offset)
        _store_vector(block, at + NORMAL, mark)
        store_lanes(block, at + NARROW_WEIGHT, close)
        store_lanes(block, at + WIDE_WEIGHT, _biweigh(area, square, one))
        store_lanes(block, at + JUMP, vec.square_distance(mark, own_mark))
        if has_greater(close, zero):
            narrow_rows = k + ONE
    return narrow_rows


@compiled
def _lay_part(part, of, at):
    """Store a vector of the records of neighbours in a block; their number, 0 past the last."""
    records, near, past, last, block = of
    four = load_columns(records, near, RECORD, FOUR * part)
    _store_vector(block, at, four)
    return choose_greater(past, last, fill_lanes(_0), four[3])


@compiled
def _lay_guides(row, stop, begin, points, records, memory):
    """Fill a block with the wide weights of ``_lay_neighbours`` and the vectors to be filtered.

    They are those of the neighbours from ``row`` to ``stop``, in the block from ``begin`` on.
    ``records`` has RECORD numbers of each face: six vectors, of which the last one is undefined in
    the first stage, and after each a number: the area, then the scatter and the ripples.  The
    vectors follow the weight.  The numbers are added to the first six rows of the sums.
    """
    faces, counts, scales, block, sums = memory
    zero, one = fill_lanes(_0), fill_lanes(_1)
    last, own = load_lanes(counts, ZERO), load_rows(faces, ZERO)
    areas, scatter, first = _load_vector(sums, ZERO)
    second, third, fourth = _load_vector(sums, R3)
    at = begin
    for k in range(row, stop):
        near, past = load_rows(faces, k * R1), fill_lanes(np.float32(k))
        offset = load_offsets(points, own, near, scales)
        part = load_columns(records, near, RECORD, ZERO)
        area = choose_greater(past, last, zero, part[3])
        areas = areas + area
        store_lanes(block, at, _biweigh(area, vec.dot(offset, offset), one))
        _store_vector(block, at + R1, part)
        at += R4
        parts = records, near, past, last, block
        scatter = scatter + _lay_part(ONE, parts, at)
        first = first + _lay_part(TWO, parts, at + R3)
        second = second + _lay_part(THREE, parts, at + R6)
        third = third + _lay_part(FOUR, parts, at + R9)
        fourth = fourth + _lay_part(_FIVE, parts, at + R12)
        at += GUIDES - R4
    _store_vector(sums, ZERO, (areas, scatter, first))
    _store_vector(sums, R3, (second, third, fourth))


# Sums over blocks


@compiled
def _add_narrow(rows, block):
    """Sums of w and w n with the narrow weights."""
    total, normals = fill_lanes(_0), _zeros()
    for k in range(rows):
        at = k * ENTRY
        w = load_lanes(block, at + NARROW_WEIGHT)
        total = total + w
        normals = vec.add_scaled(normals, w, _load_vector(block, at + NORMAL))
    return total, normals


@compiled
def _add_ranges(rows, per_1, per_2, block):
    """Sums of w and w n with the wide weights for two ranges, given by 1 / s^2; 0 for all."""
    first, second = fill_lanes(per_1), fill_lanes(per_2)
    a_total, a_normals = fill_lanes(_0), _zeros()
    b_total, b_normals = fill_lanes(_0), _zeros()
    for k in range(rows):
        at = k * ENTRY
        normal = _load_vector(block, at + NORMAL)
        w, jump = load_lanes(block, at + WIDE_WEIGHT), load_lanes(block, at + JUMP)
        a, b = _biweigh(w, jump, first), _biweigh(w, jump, second)
        a_total, a_normals = a_total + a, vec.add_scaled(a_normals, a, normal)
        b_total, b_normals = b_total + b, vec.add_scaled(b_normals, b, normal)
    return a_total, a_normals, b_total, b_normals


@compiled
def _add_products(tensor, u, v):
    """A symmetric ``tensor``, the lanes xx, xy, xz, yy, yz, zz, plus u v^T."""
    xx, xy, xz, yy, yz, zz = tensor
    xx, xy, xz = xx + u[0] * v[0], xy + u[0] * v[1], xz + u[0] * v[2]
    return xx, xy, xz, yy + u[1] * v[1], yz + u[1] * v[2], zz + u[2] * v[2]


@compiled
def _add_tensor(rows, block):
    """Sums of w n n^T with the wide weights."""
    zero = fill_lanes(_0)
    tensor = zero, zero, zero, zero, zero, zero
    for k in range(rows):
        at = k * ENTRY
        normal, w = _load_vector(block, at + NORMAL), load_lanes(block, at + WIDE_WEIGHT)
        tensor = _add_products(tensor, vec.times(w, normal), normal)
    return tensor


@compiled
def _add_skews(rows, a, b, c, block):
    """Sums of w (n . e)^3 for each of three axes e."""
    first = second = third = fill_lanes(_0)
    for k in range(rows):
        at = k * ENTRY
        normal, w = _load_vector(block, at + NORMAL), load_lanes(block, at + WIDE_WEIGHT)
        p, q, r = vec.dot(normal, a), vec.dot(normal, b), vec.dot(normal, c)
        first, second = first + w * p * p * p, second + w * q * q * q
        third = third + w * r * r * r
    return first, second, third


@compiled
def _add_scatter(rows, mean, block):
    """The largest |n - mean|^2 within the narrow reach, and the weighted sum."""
    zero = fill_lanes(_0)
    greatest = total = zero
    for k in range(rows):
        at = k * ENTRY
        w = load_lanes(block, at + NARROW_WEIGHT)
        square = vec.square_distance(_load_vector(block, at + NORMAL), mean)
        greatest = _greater(choose_greater(w, zero, square, zero), greatest)
        total = total + w * square
    return greatest, total


@compiled
def _add_plane(rows, per_range, block):
    """Sums of w, w d and w d d^T with the wide weights; ``per_range`` 0: all ranges."""
    zero, per_square = fill_lanes(_0), fill_lanes(per_range)
    total, offsets, tensor = zero, _zeros(), (zero, zero, zero, zero, zero, zero)
    for k in range(rows):
        at = k * ENTRY
        offset = _load_vector(block, at + OFFSET)
        jump = load_lanes(block, at + JUMP)
        w = _biweigh(load_lanes(block, at + WIDE_WEIGHT), jump, per_square)
        weighted = vec.times(w, offset)
        total, offsets = total + w, vec.add(offsets, weighted)
        tensor = _add_products(tensor, weighted, offset)
    return total, offsets, tensor


@compiled
def _fit_plane(sums, base):
    """Unit normals of planes that fit heights along the vectors ``base``; ``sums`` of
    ``_add_plane``.

    Also the mean squared deviation from the plane, the own height above it, and the squared
    tangential distance of the mean centroid; in reaches.
    """
    total, offsets, (xx, xy, xz, yy, yz, zz) = sums
    even = fill_lanes(_EVEN)
    per_weight = fill_lanes(_1) / _greater(total, fill_lanes(_TINY))
    mean = vec.times(per_weight, offsets)
    mx, my, mz = mean
    xx = xx * per_weight - mx * mx + even
    xy = xy * per_weight - mx * my
    xz = xz * per_weight - mx * mz
    yy = yy * per_weight - my * my + even
    yz = yz * per_weight - my * mz
    zz = zz * per_weight - mz * mz + even
    # The adjugate of C times b has the direction of C^-1 b, without a division.
    x = vec.dot((yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy), base)
    y = vec.dot((xz * yz - xy * zz, xx * zz - xz * xz, xy * xz - xx * yz), base)
    z = vec.dot((xy * yz - xz * yy, xy * xz - xx * yz, xx * yy - xy * xy), base)
    normal = _normalise((x, y, z), base, _SMALL)
    height = vec.dot(mean, normal)
    rows = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
    along = vec.dot(rows[0], normal), vec.dot(rows[1], normal), vec.dot(rows[2], normal)
    off = vec.dot(mean, mean) - height * height
    return normal, vec.dot(normal, along), height, _greater(off, fill_lanes(_0))


@compiled
def _add_pair(begin, end, guide, normal, per_1, per_2, block, sums, place):
    """Add w n for two ranges of the differences of guides to the six rows of ``sums`` at ``place``.

    The neighbours are those in ``block``, of ``_lay_guides``, from ``begin`` to ``end``; the first
    one in it is the face itself.  ``guide`` and ``normal`` are offsets of vectors.
    """
    first, second = fill_lanes(per_1), fill_lanes(per_2)
    own = _load_vector(block, guide)
    a, b = _load_vector(sums, place), _load_vector(sums, place + R3)
    for at in range(begin, end, GUIDES):
        jump = vec.square_distance(_load_vector(block, at + guide), own)
        other, w = _load_vector(block, at + normal), load_lanes(block, at)
        a = vec.add_scaled(a, _biweigh(w, jump, first), other)
        b = vec.add_scaled(b, _biweigh(w, jump, second), other)
    _store_vector(sums, place, a)
    _store_vector(sums, place + R3, b)


@compiled
def _turn_axis(skew, axis):
    """The axis, reversed if ``skew`` is negative."""
    return choose_vector(fill_lanes(_0), skew, vec.times(fill_lanes(_MINUS), axis), axis)


# Descriptors, and the inputs of a network


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
    """Compute the descriptors ``known`` (m, KNOWN) of faces, and records, see ``_lay_guides``.

    The vectors of records are the normal, two means, the first of the ``others``, and two that are
    already there; their numbers are the area, the scatter, and means of the ``ripples`` (n, 4) of
    the corners of ``faces`` in the unit of the face.  The feature of a face's unit, of ``units``,
    is its share of the sum with the mean, ``unit``.  Arrays are flat; see ``_lay_neighbours``.
    """
    widest = longest_row(start, stop, near_start) + ONE
    listed = np.empty(np.int64(widest * R1), dtype=np.uint32)
    block = np.empty(np.int64(widest * ENTRY), dtype=np.float32)
    counts, scales = np.empty(8, dtype=np.float32), np.empty(8)
    found = np.empty(np.int64(_TO_RECORD + R6), dtype=np.float32)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        rows = _list_neighbours(first, last, near_start, near, units, unit, listed, counts, scales)
        close = _lay_neighbours(rows, points, marks, listed, counts, scales, block)
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
            a, b, c = vec.load(faces, f)
            per_unit = 1.0 / (3.0 * units[f]) if units[f] > 0.0 else 0.0
            for k in range(FOUR):
                value = (ripples[a, k] + ripples[b, k] + ripples[c, k]) * per_unit
                # Bounded, so that a single spike does not decide a mean.
                place = to + THREE + TWO * FOUR + FOUR * k
                records[place] = np.float32(value / (1.0 + value))


@compiled
def _describe_block(rows, close, marks, faces, counts, block, found):
    """The descriptors of the faces of a block, of which ``close`` rows are within the narrow reach,
    and two vectors for their records."""
    own = load_columns(marks, load_rows(faces, ZERO), FOUR, ZERO)
    narrow, normals = _add_narrow(close, block)
    mean = _normalise(normals, own, _TINY)
    _store_vector(found, ZERO, mean)
    first, a_normals, second, b_normals = _add_ranges(rows, _WIDE_1, _WIDE_2, block)
    _store_vector(found, R3, _normalise(a_normals, own, _TINY))
    base = _normalise(b_normals, own, _TINY)
    _store_vector(found, _TO_RECORD, base)
    third, a_normals, wide, b_normals = _add_ranges(rows, _WIDE_3, _0, block)
    _store_vector(found, TWO * R3, _normalise(a_normals, own, _TINY))
    _store_vector(found, _TO_RECORD + R3, _normalise(b_normals, own, _TINY))
    normal, deviation, height, off = _fit_plane(_add_plane(rows, _0, block), base)
    _store_vector(found, THREE * R3, normal)
    normal, _, _, _ = _fit_plane(_add_plane(rows, _WIDE_2, block), base)
    _store_vector(found, FOUR * R3, normal)
    a, b, c, _, middle, least = find_axes(_add_tensor(rows, block))
    skews = _add_skews(rows, a, b, c, block)
    at = np.uint64(AXES) * R1
    _store_vector(found, at, _turn_axis(skews[0], a))
    _store_vector(found, at + R3, _turn_axis(skews[1], b))
    _store_vector(found, at + R6, _turn_axis(skews[2], c))
    greatest, scatter = _add_scatter(close, mean, block)
    zero, one, tiny = fill_lanes(_0), fill_lanes(_1), fill_lanes(_TINY)
    narrow, wide = one / _greater(narrow, tiny), one / _greater(wide, tiny)
    at = _OWN_NUMBERS * R1
    _store_vector(found, at, vec.times(wide, (first, second, third)))
    middle, least = root(_greater(middle * wide, zero)), root(_greater(least * wide, zero))
    _store_vector(found, at + R3, (middle, least, root(_greater(deviation, zero))))
    near_share = load_lanes(counts, ZERO) * fill_lanes(_PER_MOST)
    _store_vector(found, at + R6, (height, root(off), near_share))
    store_lanes(found, _SCATTER * R1, root(root(greatest * (scatter * narrow))))


@compiled
def memory_for_inputs(start, stop, near_start):
    """Buffers of ``lay_inputs`` for these faces: their neighbours, their counts and scales, the
    block, its sums."""
    widest = longest_row(start, stop, near_start) + ONE
    faces = np.empty(np.int64(widest * R1), dtype=np.uint32)
    counts, scales = np.empty(8, dtype=np.float32), np.empty(8)
    block = np.empty(np.int64((CHUNK + ONE) * GUIDES), dtype=np.float32)
    return faces, counts, scales, block, np.empty(np.int64(SUMS), dtype=np.float32)


@compiled
def lay_inputs(first, last, group, of, is_later, memory, vectors, x):
    """Write the inputs and the vectors of the faces ``first`` to ``last``, eight at most.

    They are the columns from ``group`` on of ``x`` and ``vectors``, whose rows have FACES.  The
    inputs are the coordinates of the vectors along the axes, then NUMBERS and the statistics.

    Parameters
    ----------
    of : ``points``, ``units``, ``unit``, ``near_start``, ``near``; ``known`` and ``records``
        of ``describe``; ``statistics`` (m, 5); ``others`` (m, 12), four vectors a face; flat.
    is_later : whether vectors of earlier stages are in the records.
    memory : of ``memory_for_inputs``.
    """
    points, units, unit, near_start, near, known, records, statistics, others = of
    faces, counts, scales, block, sums = memory
    rows = _list_neighbours(first, last, near_start, near, units, unit, faces, counts, scales)
    for at in range(ZERO, SUMS, LANES):
        store_lanes(sums, at, fill_lanes(_0))
    for row in range(ZERO, rows, CHUNK):
        stop = min(row + CHUNK, rows)
        # The face itself stays first.
        begin = GUIDES if row else ZERO
        end = begin + (stop - row) * GUIDES
        _lay_guides(row, stop, begin, points, records, memory)
        for pair in range(5 if is_later else 4):
            guide, normal, per_1, per_2 = PAIRS[pair]
            place = R6 * np.uint64(1 + pair)
            _add_pair(begin, end, guide, normal, per_1, per_2, block, sums, place)
    ids = load_rows(faces, ZERO)
    axes = _load_known(known, ids, 5), _load_known(known, ids, 6), _load_known(known, ids, 7)
    own = _load_vector(block, R1)
    to = _store_seen(own, axes, vectors, x, group)
    to = _store_seen(_load_known(known, ids, 0), axes, vectors, x, to)
    to = _store_seen(_load_known(known, ids, 1), axes, vectors, x, to)
    to = _store_seen(_load_vector(block, R4), axes, vectors, x, to)
    to = _store_seen(_load_known(known, ids, 2), axes, vectors, x, to)
    to = _store_seen(_load_vector(block, R7), axes, vectors, x, to)
    to = _store_seen(_load_known(known, ids, 3), axes, vectors, x, to)
    to = _store_seen(_load_known(known, ids, 4), axes, vectors, x, to)
    for pair in range(3):
        to = _store_pair(pair, block, sums, axes, vectors, x, to)
    to = _store_others(others, ids, own, axes, vectors, x, to)
    to = _store_pair(3, block, sums, axes, vectors, x, to)
    if is_later:
        to = _store_seen(_load_vector(block, R13), axes, vectors, x, to)
        to = _store_seen(_load_vector(block, R16), axes, vectors, x, to)
        to = _store_pair(4, block, sums, axes, vectors, x, to)
    _lay_numbers(known, records, statistics, ids, counts, sums, x, to)


@compiled
def _load_known(known, ids, place):
    """The vectors at an index of the descriptors of faces."""
    x, y, z, _ = load_columns(known, ids, KNOWN, THREE * np.uint64(place))
    return x, y, z


@compiled
def _store_seen(vector, axes, vectors, x, to):
    """Write a vector, and its coordinates along the axes as inputs; returns the next index."""
    store_lanes(vectors, to, vector[0])
    store_lanes(vectors, to + S1, vector[1])
    store_lanes(vectors, to + S2, vector[2])
    for axis in range(3):
        store_lanes(x, to, vec.dot(vector, axes[axis]))
        to += S1
    return to


@compiled
def _store_pair(pair, block, sums, axes, vectors, x, to):
    """Write the two filtered normals of ``_add_pair``."""
    kept, place = _load_vector(block, PAIRS[pair][1]), R6 * np.uint64(1 + pair)
    first, second = _load_vector(sums, place), _load_vector(sums, place + R3)
    to = _store_seen(_normalise(first, kept, _TINY), axes, vectors, x, to)
    return _store_seen(_normalise(second, kept, _TINY), axes, vectors, x, to)


@compiled
def _store_others(others, ids, normal, axes, vectors, x, to):
    """Write four vectors of the faces; zero ones are replaced by the own normal."""
    px, py, pz, qx = load_columns(others, ids, _OTHERS, ZERO)
    qy, qz, rx, ry = load_columns(others, ids, _OTHERS, FOUR)
    rz, sx, sy, sz = load_columns(others, ids, _OTHERS, FOUR + FOUR)
    for vector in ((px, py, pz), (qx, qy, qz), (rx, ry, rz), (sx, sy, sz)):
        square = vec.dot(vector, vector)
        to = _store_seen(
            choose_vector(square, fill_lanes(_0), vector, normal), axes, vectors, x, to
        )
    return to


@compiled
def _store_four(x, to, lanes):
    store_lanes(x, to, lanes[0])
    store_lanes(x, to + S1, lanes[1])
    store_lanes(x, to + S2, lanes[2])
    store_lanes(x, to + S3, lanes[3])


@compiled
def _lay_numbers(known, records, statistics, ids, counts, sums, x, to):
    """Write the features of faces as inputs; the first of ``sums`` are those of ``_lay_guides``."""
    _, scatter, first = _load_vector(sums, ZERO)
    second, third, fourth = _load_vector(sums, R3)
    per_count = fill_lanes(_1) / (load_lanes(counts, ZERO) + fill_lanes(_1))
    for column in range(ZERO, _TWELVE, FOUR):
        four = load_columns(known, ids, KNOWN, _OWN_NUMBERS + column)
        _store_four(x, to + column * S1, four)
    store_lanes(x, to + _TEN * S1, scatter * per_count)
    to += _TWELVE * S1
    store_lanes(sums, R1, load_columns(records, ids, RECORD, ZERO)[3])
    for lane in range(LANES):
        mean = sums[lane] / (np.float64(counts[lane]) + 1.0)
        both = sums[R1 + lane] + mean
        share = sums[R1 + lane] / both if both > 0.0 else 0.5
        sums[lane] = np.float32(share)
    store_lanes(x, to, load_lanes(sums, ZERO))
    to += S1
    for column in range(FOUR * TWO, RECORD, FOUR):
        store_lanes(x, to, load_columns(records, ids, RECORD, column)[3])
        to += S1
    ripples = first * per_count, second * per_count, third * per_count, fourth * per_count
    _store_four(x, to, ripples)
    to += FOUR * S1
    _store_four(x, to, load_columns(statistics, ids, _FIVE, ZERO))
    store_lanes(x, to + FOUR * S1, load_columns(statistics, ids, _FIVE, ONE)[3])
