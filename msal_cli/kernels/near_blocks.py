"""Faces near a face side by side with those near others: blocks whose lanes are faces.

Sums over the neighbours of one face are too short for vector code.  So the sums of eight faces are
made at a time, and what belongs to the k-th neighbour of each is in a row.  No sum goes across
lanes, so that no bit depends on the block, the lane or the thread that a face falls to.
"""

import numpy as np

from msal_cli.kernels.lanes import (
    LANES,
    choose_greater,
    fill_lanes,
    has_greater,
    load_columns,
    load_lanes,
    load_offsets,
    load_rows,
    root,
    store_lanes,
)
from msal_cli.kernels.library import compiled
from msal_cli.kernels.vectors import ONE, THREE, TWO, ZERO

R1, R2, R3, R4, R5, R6, R7, R9, R10, R13, R16, R19 = (
    LANES * np.uint64(rows) for rows in (1, 2, 3, 4, 5, 6, 7, 9, 10, 13, 16, 19)
)
"""What so many rows of lanes take."""

X, Y, Z, NX, NY, NZ, NARROW_WEIGHT, WIDE_WEIGHT, JUMP = (LANES * np.uint64(row) for row in range(9))
"""The rows of lanes that a neighbour has in a block."""

ENTRY = R9
"""What a neighbour takes in a block."""

GUIDES = R19
"""What a neighbour takes in a block of ``lay_guides``: a weight, and six vectors."""

RECORD = np.uint64(24)
"""Numbers of a face that ``lay_guides`` reads."""

NARROW, WIDE = 1.45, 2.7
"""The reaches of both weights, in local units."""

FOUR = np.uint64(4)

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-30)
_SMALL = np.float32(1e-24)
_EVEN = np.float32(1e-4)
_RATIO = np.float32((WIDE / NARROW) ** 2)


@compiled
def list_neighbours(first, last, near_start, near, units, unit, faces, counts, scales):
    """List the neighbours of the faces ``first`` to ``last`` side by side; return how many rows.

    The first row of ``faces`` is the faces themselves, which also fill lanes without a k-th
    neighbour; ``counts`` (8,) gets the numbers of neighbours, ``scales`` (8,) one over WIDE local
    units, of which each face has its own, ``unit`` where that is zero.
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
def lay_neighbours(rows, points, marks, faces, counts, scales, block):
    """Lay offsets, normals and weights of both reaches of the listed ``faces`` side by side.

    ``points`` are the centroids, ``marks`` normals and areas (m, 4), flat; see ``lanes``.  Beside
    them is |n_i - n_j|^2.  Returns the number of rows after which no narrow weight is above zero.
    """
    zero, one, ratio = fill_lanes(_0), fill_lanes(_1), fill_lanes(_RATIO)
    last, own = load_lanes(counts, ZERO), load_rows(faces, ZERO)
    own_x, own_y, own_z, _ = load_columns(marks, own, FOUR, ZERO)
    narrow_rows = ONE
    for k in range(rows):
        near = load_rows(faces, k * R1)
        x, y, z = load_offsets(points, own, near, scales)
        nx, ny, nz, area = load_columns(marks, near, FOUR, ZERO)
        area = choose_greater(fill_lanes(np.float32(k)), last, zero, area)
        square = x * x + y * y + z * z
        wide, close = one - square, one - square * ratio
        wide = choose_greater(wide, zero, wide, zero)
        close = choose_greater(close, zero, close, zero)
        close = area * close * close
        dx, dy, dz = nx - own_x, ny - own_y, nz - own_z
        at = k * ENTRY
        store_lanes(block, at + X, x)
        store_lanes(block, at + Y, y)
        store_lanes(block, at + Z, z)
        store_lanes(block, at + NX, nx)
        store_lanes(block, at + NY, ny)
        store_lanes(block, at + NZ, nz)
        store_lanes(block, at + NARROW_WEIGHT, close)
        store_lanes(block, at + WIDE_WEIGHT, area * wide * wide)
        store_lanes(block, at + JUMP, dx * dx + dy * dy + dz * dz)
        if has_greater(close, zero):
            narrow_rows = k + ONE
    return narrow_rows


@compiled
def lay_guides(row, stop, begin, points, records, is_later, faces, counts, scales, block, sums):
    """Lay the wide weights of ``lay_neighbours`` and what is filtered jointly side by side.

    They are those of the neighbours from ``row`` to ``stop``, in ``block`` from ``begin`` on.
    ``records`` has RECORD numbers of each face: six vectors, of which two are there ``is_later``,
    and behind each a number: the area, then the scatter and the ripples.  The vectors stand behind
    the weight.  The numbers are added to the first six rows of ``sums``.
    """
    zero, one = fill_lanes(_0), fill_lanes(_1)
    last, own = load_lanes(counts, ZERO), load_rows(faces, ZERO)
    areas, scatter = load_lanes(sums, ZERO), load_lanes(sums, R1)
    first, second = load_lanes(sums, R2), load_lanes(sums, R3)
    third, fourth = load_lanes(sums, R4), load_lanes(sums, R5)
    at = begin
    for k in range(row, stop):
        near, past = load_rows(faces, k * R1), fill_lanes(np.float32(k))
        x, y, z = load_offsets(points, own, near, scales)
        wide = one - (x * x + y * y + z * z)
        wide = choose_greater(wide, zero, wide, zero)
        x, y, z, number = load_columns(records, near, RECORD, ZERO)
        _store_row(block, at + R1, x, y, z)
        number = choose_greater(past, last, zero, number)
        areas = areas + number
        store_lanes(block, at, number * wide * wide)
        x, y, z, number = load_columns(records, near, RECORD, FOUR)
        _store_row(block, at + R4, x, y, z)
        scatter = scatter + choose_greater(past, last, zero, number)
        x, y, z, number = load_columns(records, near, RECORD, FOUR * TWO)
        _store_row(block, at + R7, x, y, z)
        first = first + choose_greater(past, last, zero, number)
        x, y, z, number = load_columns(records, near, RECORD, FOUR * THREE)
        _store_row(block, at + R10, x, y, z)
        second = second + choose_greater(past, last, zero, number)
        x, y, z, number = load_columns(records, near, RECORD, FOUR * FOUR)
        third = third + choose_greater(past, last, zero, number)
        if is_later:
            _store_row(block, at + R13, x, y, z)
        x, y, z, number = load_columns(records, near, RECORD, RECORD - FOUR)
        fourth = fourth + choose_greater(past, last, zero, number)
        if is_later:
            _store_row(block, at + R16, x, y, z)
        at += GUIDES
    _store_row(sums, ZERO, areas, scatter, first)
    _store_row(sums, R3, second, third, fourth)


@compiled
def _store_row(block, at, x, y, z):
    store_lanes(block, at, x)
    store_lanes(block, at + R1, y)
    store_lanes(block, at + R2, z)


@compiled
def add_narrow(rows, block):
    """Sums of w and w n with the narrow weights."""
    total = sum_x = sum_y = sum_z = fill_lanes(_0)
    for k in range(rows):
        at = k * ENTRY
        w = load_lanes(block, at + NARROW_WEIGHT)
        total = total + w
        sum_x = sum_x + w * load_lanes(block, at + NX)
        sum_y = sum_y + w * load_lanes(block, at + NY)
        sum_z = sum_z + w * load_lanes(block, at + NZ)
    return total, sum_x, sum_y, sum_z


@compiled
def add_ranges(rows, per_1, per_2, block):
    """Sums of w and w n with the wide weights for two ranges, given by 1 / s^2; 0 for all."""
    zero, one = fill_lanes(_0), fill_lanes(_1)
    first, second = fill_lanes(per_1), fill_lanes(per_2)
    a_total = a_x = a_y = a_z = b_total = b_x = b_y = b_z = zero
    for k in range(rows):
        at = k * ENTRY
        nx, ny = load_lanes(block, at + NX), load_lanes(block, at + NY)
        nz = load_lanes(block, at + NZ)
        w, jump = load_lanes(block, at + WIDE_WEIGHT), load_lanes(block, at + JUMP)
        a, b = one - jump * first, one - jump * second
        a, b = choose_greater(a, zero, a, zero), choose_greater(b, zero, b, zero)
        a, b = w * a * a, w * b * b
        a_total = a_total + a
        a_x, a_y, a_z = a_x + a * nx, a_y + a * ny, a_z + a * nz
        b_total = b_total + b
        b_x, b_y, b_z = b_x + b * nx, b_y + b * ny, b_z + b * nz
    return a_total, a_x, a_y, a_z, b_total, b_x, b_y, b_z


@compiled
def add_tensor(rows, block):
    """Sums of w n n^T with the wide weights: xx, xy, xz, yy, yz, zz."""
    xx = xy = xz = yy = yz = zz = fill_lanes(_0)
    for k in range(rows):
        at = k * ENTRY
        nx, ny = load_lanes(block, at + NX), load_lanes(block, at + NY)
        nz, w = load_lanes(block, at + NZ), load_lanes(block, at + WIDE_WEIGHT)
        wx, wy, wz = w * nx, w * ny, w * nz
        xx, xy, xz = xx + wx * nx, xy + wx * ny, xz + wx * nz
        yy, yz, zz = yy + wy * ny, yz + wy * nz, zz + wz * nz
    return xx, xy, xz, yy, yz, zz


@compiled
def add_skews(rows, axes, block):
    """Sums of w (n . e)^3 for each axis e; ``axes`` are nine lanes."""
    ax, ay, az, bx, by, bz, cx, cy, cz = axes
    first = second = third = fill_lanes(_0)
    for k in range(rows):
        at = k * ENTRY
        nx, ny = load_lanes(block, at + NX), load_lanes(block, at + NY)
        nz, w = load_lanes(block, at + NZ), load_lanes(block, at + WIDE_WEIGHT)
        a = nx * ax + ny * ay + nz * az
        b = nx * bx + ny * by + nz * bz
        c = nx * cx + ny * cy + nz * cz
        first, second = first + w * a * a * a, second + w * b * b * b
        third = third + w * c * c * c
    return first, second, third


@compiled
def add_scatter(rows, mean, block):
    """The greatest |n - mean|^2 within the narrow reach, and the sum by weight."""
    mx, my, mz = mean
    zero = fill_lanes(_0)
    greatest = total = zero
    for k in range(rows):
        at = k * ENTRY
        dx, dy = load_lanes(block, at + NX) - mx, load_lanes(block, at + NY) - my
        dz, w = load_lanes(block, at + NZ) - mz, load_lanes(block, at + NARROW_WEIGHT)
        square = dx * dx + dy * dy + dz * dz
        counted = choose_greater(w, zero, square, zero)
        greatest = choose_greater(counted, greatest, counted, greatest)
        total = total + w * square
    return greatest, total


@compiled
def add_plane(rows, per_range, block):
    """Sums of w, w d and w d d^T with the wide weights; ``per_range`` 0: all ranges."""
    zero, one, per_square = fill_lanes(_0), fill_lanes(_1), fill_lanes(per_range)
    total = sum_x = sum_y = sum_z = xx = xy = xz = yy = yz = zz = zero
    for k in range(rows):
        at = k * ENTRY
        x, y = load_lanes(block, at + X), load_lanes(block, at + Y)
        z = load_lanes(block, at + Z)
        part = one - load_lanes(block, at + JUMP) * per_square
        part = choose_greater(part, zero, part, zero)
        w = load_lanes(block, at + WIDE_WEIGHT) * part * part
        wx, wy, wz = w * x, w * y, w * z
        total = total + w
        sum_x, sum_y, sum_z = sum_x + wx, sum_y + wy, sum_z + wz
        xx, xy, xz = xx + wx * x, xy + wx * y, xz + wx * z
        yy, yz, zz = yy + wy * y, yz + wy * z, zz + wz * z
    return total, sum_x, sum_y, sum_z, xx, xy, xz, yy, yz, zz


@compiled
def normalise(vector, kept):
    """The unit vector of one; ``kept`` where it vanishes.  Vectors are three lanes."""
    x, y, z = vector
    square = x * x + y * y + z * z
    tiny, one = fill_lanes(_TINY), fill_lanes(_1)
    per_length = one / root(choose_greater(square, tiny, square, one))
    return (
        choose_greater(square, tiny, x * per_length, kept[0]),
        choose_greater(square, tiny, y * per_length, kept[1]),
        choose_greater(square, tiny, z * per_length, kept[2]),
    )


@compiled
def fit_plane(sums, base):
    """Unit normals of planes that fit heights along the vectors ``base``; ``sums`` of
    ``add_plane``.

    Also the mean square and the own height off the plane, and how far the mean centroid is off
    within it, squared; in reaches.
    """
    total, sum_x, sum_y, sum_z, xx, xy, xz, yy, yz, zz = sums
    bx, by, bz = base
    zero, one, tiny = fill_lanes(_0), fill_lanes(_1), fill_lanes(_TINY)
    even, small = fill_lanes(_EVEN), fill_lanes(_SMALL)
    per_weight = one / choose_greater(total, tiny, total, tiny)
    mx, my, mz = sum_x * per_weight, sum_y * per_weight, sum_z * per_weight
    xx = xx * per_weight - mx * mx + even
    xy = xy * per_weight - mx * my
    xz = xz * per_weight - mx * mz
    yy = yy * per_weight - my * my + even
    yz = yz * per_weight - my * mz
    zz = zz * per_weight - mz * mz + even
    # The cofactors of C times b: the direction of C^-1 b without a division.
    x = (yy * zz - yz * yz) * bx + (xz * yz - xy * zz) * by + (xy * yz - xz * yy) * bz
    y = (xz * yz - xy * zz) * bx + (xx * zz - xz * xz) * by + (xy * xz - xx * yz) * bz
    z = (xy * yz - xz * yy) * bx + (xy * xz - xx * yz) * by + (xx * yy - xy * xy) * bz
    square = x * x + y * y + z * z
    per_length = one / root(choose_greater(square, small, square, one))
    x = choose_greater(square, small, x * per_length, bx)
    y = choose_greater(square, small, y * per_length, by)
    z = choose_greater(square, small, z * per_length, bz)
    height = mx * x + my * y + mz * z
    deviation = (
        x * (xx * x + xy * y + xz * z)
        + y * (xy * x + yy * y + yz * z)
        + z * (xz * x + yz * y + zz * z)
    )
    off = mx * mx + my * my + mz * mz - height * height
    return (x, y, z), deviation, height, choose_greater(off, zero, off, zero)


@compiled
def add_pair(begin, end, guide, normal, per_1, per_2, block, sums, place):
    """Add w n for two ranges of the differences of guides to the six rows of ``sums`` at ``place``.

    They are those of the neighbours in ``block``, of ``lay_guides``, from ``begin`` to ``end``;
    the first one in it is the face itself.  ``guide`` and ``normal`` are the places of vectors.
    """
    zero, one = fill_lanes(_0), fill_lanes(_1)
    first, second = fill_lanes(per_1), fill_lanes(per_2)
    own_x, own_y = load_lanes(block, guide), load_lanes(block, guide + R1)
    own_z = load_lanes(block, guide + R2)
    a_x, a_y = load_lanes(sums, place), load_lanes(sums, place + R1)
    a_z, b_x = load_lanes(sums, place + R2), load_lanes(sums, place + R3)
    b_y, b_z = load_lanes(sums, place + R4), load_lanes(sums, place + R5)
    for at in range(begin, end, GUIDES):
        dx = load_lanes(block, at + guide) - own_x
        dy = load_lanes(block, at + guide + R1) - own_y
        dz = load_lanes(block, at + guide + R2) - own_z
        jump = dx * dx + dy * dy + dz * dz
        nx, ny = load_lanes(block, at + normal), load_lanes(block, at + normal + R1)
        nz, w = load_lanes(block, at + normal + R2), load_lanes(block, at)
        a, b = one - jump * first, one - jump * second
        a, b = choose_greater(a, zero, a, zero), choose_greater(b, zero, b, zero)
        a, b = w * a * a, w * b * b
        a_x, a_y, a_z = a_x + a * nx, a_y + a * ny, a_z + a * nz
        b_x, b_y, b_z = b_x + b * nx, b_y + b * ny, b_z + b * nz
    _store_row(sums, place, a_x, a_y, a_z)
    _store_row(sums, place + R3, b_x, b_y, b_z)


# Eigenvectors of eight symmetric 3 x 3 matrices at once, by Jacobi's rotations.

SWEEPS = 4
"""Rounds of three rotations: what is left beside the diagonal is below single precision."""

_2, _MINUS = np.float32(2.0), np.float32(-1.0)


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
