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

from msal_cli.core.compiled import compiled
from msal_cli.core.local_frames import find_axes, turn_axes
from msal_cli.core.near_blocks import (
    ENTRY,
    JUMP,
    LANES,
    NARROW_WEIGHT,
    NX,
    NY,
    NZ,
    R1,
    R2,
    R3,
    R4,
    R5,
    R6,
    R7,
    R8,
    R9,
    R10,
    R11,
    R12,
    R13,
    R14,
    R15,
    R16,
    RECORD,
    SIX,
    WIDE_WEIGHT,
    X,
    Y,
    Z,
    near_block,
    weigh_block,
)
from msal_cli.core.ring_blocks import ONE, THREE, TWO, ZERO

NARROW_RANGES = (0.35, 0.7, 1.1)
WIDE_RANGES = (0.2, 0.4, 0.7, 1.2)
"""Ranges s of the differences between unit normals; one more mean has all of them."""

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-30)
_SMALL = np.float32(1e-24)
_EVEN = np.float32(1e-4)
_NARROW_1, _NARROW_2, _NARROW_3 = (np.float32(1.0 / s**2) for s in NARROW_RANGES)
_WIDE_1, _WIDE_2, _WIDE_3, _WIDE_4 = (np.float32(1.0 / s**2) for s in WIDE_RANGES)


@compiled
def _add_ranges(rows, weight, per_1, per_2, per_3, per_4, block, sums, to):  # type: ignore[no-untyped-def]
    """Sums of w, w n for four ranges: 16 sums from the place ``to`` on."""
    for at in range(to, to + R16):
        sums[at] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            nx, ny, nz = block[at + NX], block[at + NY], block[at + NZ]
            w, jump = block[at + weight], block[at + JUMP]
            a, b = _1 - jump * per_1, _1 - jump * per_2
            c, d = _1 - jump * per_3, _1 - jump * per_4
            a = a if a > _0 else _0
            b = b if b > _0 else _0
            c = c if c > _0 else _0
            d = d if d > _0 else _0
            a, b, c, d = w * a * a, w * b * b, w * c * c, w * d * d
            o = to + lane
            sums[o] += a
            sums[o + R1] += a * nx
            sums[o + R2] += a * ny
            sums[o + R3] += a * nz
            sums[o + R4] += b
            sums[o + R5] += b * nx
            sums[o + R6] += b * ny
            sums[o + R7] += b * nz
            sums[o + R8] += c
            sums[o + R9] += c * nx
            sums[o + R10] += c * ny
            sums[o + R11] += c * nz
            sums[o + R12] += d
            sums[o + R13] += d * nx
            sums[o + R14] += d * ny
            sums[o + R15] += d * nz


@compiled
def _add_tensor(rows, block, sums, to):  # type: ignore[no-untyped-def]
    """Sums of w n n^T and w n with the wide weights: xx, xy, xz, yy, yz, zz, x, y, z."""
    for at in range(to, to + R9):
        sums[at] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            nx, ny, nz = block[at + NX], block[at + NY], block[at + NZ]
            w = block[at + WIDE_WEIGHT]
            o = to + lane
            wx, wy, wz = w * nx, w * ny, w * nz
            sums[o] += wx * nx
            sums[o + R1] += wx * ny
            sums[o + R2] += wx * nz
            sums[o + R3] += wy * ny
            sums[o + R4] += wy * nz
            sums[o + R5] += wz * nz
            sums[o + R6] += wx
            sums[o + R7] += wy
            sums[o + R8] += wz


@compiled
def _add_skews(rows, axes, block, skews):  # type: ignore[no-untyped-def]
    """Sums of w (n . e)^3 for each axis e."""
    for at in range(R3):
        skews[at] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            nx, ny, nz = block[at + NX], block[at + NY], block[at + NZ]
            w = block[at + WIDE_WEIGHT]
            a = nx * axes[lane] + ny * axes[R1 + lane] + nz * axes[R2 + lane]
            b = nx * axes[R3 + lane] + ny * axes[R4 + lane] + nz * axes[R5 + lane]
            c = nx * axes[R6 + lane] + ny * axes[R7 + lane] + nz * axes[R8 + lane]
            skews[lane] += w * a * a * a
            skews[R1 + lane] += w * b * b * b
            skews[R2 + lane] += w * c * c * c


@compiled
def _add_scatter(rows, mean, block, sums):  # type: ignore[no-untyped-def]
    """The greatest |n - mean|^2 within the narrow reach, and the sum by weight."""
    for at in range(R2):
        sums[at] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            dx = block[at + NX] - mean[lane]
            dy = block[at + NY] - mean[R1 + lane]
            dz = block[at + NZ] - mean[R2 + lane]
            w = block[at + NARROW_WEIGHT]
            square = dx * dx + dy * dy + dz * dz
            counted = square if w > _0 else _0
            greatest = sums[lane]
            sums[lane] = counted if counted > greatest else greatest
            sums[R1 + lane] += w * square


@compiled
def _add_plane(rows, weight, per_range, block, sums, to):  # type: ignore[no-untyped-def]
    """Sums of w, w d and w d d^T, ten from the place ``to`` on; ``per_range`` 0: all ranges."""
    for at in range(to, to + R10):
        sums[at] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            x, y, z = block[at + X], block[at + Y], block[at + Z]
            part = _1 - block[at + JUMP] * per_range
            part = part if part > _0 else _0
            w = block[at + weight] * part * part
            o = to + lane
            wx, wy, wz = w * x, w * y, w * z
            sums[o] += w
            sums[o + R1] += wx
            sums[o + R2] += wy
            sums[o + R3] += wz
            sums[o + R4] += wx * x
            sums[o + R5] += wx * y
            sums[o + R6] += wx * z
            sums[o + R7] += wy * y
            sums[o + R8] += wy * z
            sums[o + R9] += wz * z


@compiled
def _normalise(sums, at, kept, vectors, place):  # type: ignore[no-untyped-def]
    """Unit vectors of the sums from ``at`` on as vector ``place``; ``kept`` where they vanish."""
    for lane in range(LANES):
        x, y, z = sums[at + lane], sums[at + R1 + lane], sums[at + R2 + lane]
        square = x * x + y * y + z * z
        is_there = square > _TINY
        per_length = _1 / np.sqrt(square if is_there else _1)
        o = place * R3 + lane
        vectors[o] = x * per_length if is_there else kept[lane]
        vectors[o + R1] = y * per_length if is_there else kept[R1 + lane]
        vectors[o + R2] = z * per_length if is_there else kept[R2 + lane]


@compiled
def _fit_plane(sums, at, base, vectors, place, to, spread):  # type: ignore[no-untyped-def]
    """The unit normals of planes that fit heights along the vector of place ``base``.

    ``spread`` gets three rows: the mean square and the own height off the plane, and how far the
    mean centroid is off within it; in reaches.
    """
    for lane in range(LANES):
        o = at + lane
        total = sums[o]
        per_weight = _1 / (total if total > _TINY else _TINY)
        mx, my, mz = (
            sums[o + R1] * per_weight,
            sums[o + R2] * per_weight,
            sums[o + R3] * per_weight,
        )
        xx = sums[o + R4] * per_weight - mx * mx + _EVEN
        xy = sums[o + R5] * per_weight - mx * my
        xz = sums[o + R6] * per_weight - mx * mz
        yy = sums[o + R7] * per_weight - my * my + _EVEN
        yz = sums[o + R8] * per_weight - my * mz
        zz = sums[o + R9] * per_weight - mz * mz + _EVEN
        b = base * R3 + lane
        bx, by, bz = vectors[b], vectors[b + R1], vectors[b + R2]
        # The cofactors of C times b: the direction of C^-1 b without a division.
        x = (yy * zz - yz * yz) * bx + (xz * yz - xy * zz) * by + (xy * yz - xz * yy) * bz
        y = (xz * yz - xy * zz) * bx + (xx * zz - xz * xz) * by + (xy * xz - xx * yz) * bz
        z = (xy * yz - xz * yy) * bx + (xy * xz - xx * yz) * by + (xx * yy - xy * xy) * bz
        square = x * x + y * y + z * z
        is_there = square > _SMALL
        per_length = _1 / np.sqrt(square if is_there else _1)
        x = x * per_length if is_there else bx
        y = y * per_length if is_there else by
        z = z * per_length if is_there else bz
        o = place * R3 + lane
        vectors[o] = x
        vectors[o + R1] = y
        vectors[o + R2] = z
        height = mx * x + my * y + mz * z
        spread[to + lane] = (
            x * (xx * x + xy * y + xz * z)
            + y * (xy * x + yy * y + yz * z)
            + z * (xz * x + yz * y + zz * z)
        )
        spread[to + R1 + lane] = height
        off = mx * mx + my * my + mz * mz - height * height
        spread[to + R2 + lane] = off if off > _0 else _0


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
"""The places of: the face's own normal; narrow ranges 0.35, 0.7, 1.1 from 1 on and all; wide ranges
0.2, 0.4, 0.7 and 1.2 from 5 on, and all; planes (wide, wide of range 0.7, narrow) from 10 on; the
guide; the normals filtered twice by it; by the third wide range; the second of these once more,
and the wide mean."""

NUMBERS = 19
"""Numbers of a face: the shares of the weight within each range, narrow and wide (7); the roots of
the second and third eigenvalue; the deviations from the wide and the narrow plane, the height
above the first, the distance from its middle; faces near; scatter of the normals, its least and
mean among those near; the own unit, and the own area, each over itself plus the mean."""

PATCHES = np.uint64(16)
"""Faces near that may lend their mean as a guide."""

_PER_MOST = np.float32(1.0 / 64.0)


@compiled
def describe(start, stop, records, per_reach, near_start, near, width, table, numbers, axes):  # type: ignore[no-untyped-def]
    """Fill the first vectors (all up to the guide) and the first 15 numbers of each face.

    ``table`` has ``width`` vectors of each face, ``numbers`` NUMBERS, ``axes`` three vectors; all
    are flat and in single precision, as are ``records`` (double) otherwise; see ``near_block``.
    """
    widest = ONE
    for f in range(np.uint64(start), np.uint64(stop)):
        widest = max(widest, near_start[f + ONE] - near_start[f] + ONE)
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
        rows = near_block(first, last, records, per_reach, near_start, near, block, own)
        weigh_block(rows, block, own)
        _add_ranges(rows, NARROW_WEIGHT, _NARROW_1, _NARROW_2, _NARROW_3, _0, block, sums, narrow)
        _add_ranges(rows, WIDE_WEIGHT, _WIDE_1, _WIDE_2, _WIDE_3, _WIDE_4, block, sums, wide)
        _add_tensor(rows, block, sums, tensor)
        _add_plane(rows, WIDE_WEIGHT, _0, block, sums, planes)
        _add_plane(rows, WIDE_WEIGHT, _WIDE_3, block, sums, planes + R10)
        _add_plane(rows, NARROW_WEIGHT, _0, block, sums, planes + R10 + R10)
        for at in range(R3):
            vectors[at] = own[at]
        for k in range(np.uint64(4)):
            _normalise(sums, narrow + k * R4 + R1, own, vectors, ONE + k)
            _normalise(sums, wide + k * R4 + R1, own, vectors, np.uint64(5) + k)
        _normalise(sums, tensor + R6, own, vectors, np.uint64(WIDE_MEAN))
        _fit_plane(sums, planes, np.uint64(WIDE_FILTERED), vectors, np.uint64(10), ZERO, spread)
        _fit_plane(sums, planes + R10, np.uint64(WIDE_FILTERED), vectors, np.uint64(11), R3, spread)
        _fit_plane(
            sums, planes + R10 + R10, np.uint64(NARROW_MEAN), vectors, np.uint64(12), R6, spread
        )
        find_axes(sums, tensor, own_axes, values)
        _add_skews(rows, own_axes, block, skews)
        turn_axes(skews, own_axes)
        for at in range(R3):
            skews[at] = vectors[R3 * np.uint64(NARROW_MEAN) + at]
        _add_scatter(rows, skews, block, scatter)
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
def _write_numbers(lane, sums, values, spread, scatter, numbers, to):  # type: ignore[no-untyped-def]
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
def pick_guides(start, stop, records, near_start, near, width, table, numbers):  # type: ignore[no-untyped-def]
    """Fill the guide of each face and the numbers that it takes from those near.

    The guide is the narrow mean of the face with the least scatter among the first ``PATCHES``
    near: beside an edge one whose patch lies on one side of it.
    """
    width = THREE * np.uint64(width)
    per_face, scatter = np.uint64(NUMBERS), np.uint64(14)
    for f in range(np.uint64(start), np.uint64(stop)):
        best, least = f, numbers[per_face * f + scatter]
        total, area = least, records[RECORD * f + SIX]
        row, end = near_start[f], near_start[f + ONE]
        for entry in range(row, end):
            j = np.uint64(near[entry])
            value = numbers[per_face * j + scatter]
            total += value
            area += records[RECORD * j + SIX]
            if entry - row < PATCHES and value < least:
                best, least = j, value
        count = end - row + ONE
        for axis in range(THREE):
            value = table[width * best + THREE * np.uint64(NARROW_MEAN) + axis]
            table[width * f + THREE * np.uint64(GUIDE) + axis] = value
        numbers[per_face * f + np.uint64(15)] = least
        numbers[per_face * f + np.uint64(16)] = total / np.float32(count)
        own = records[RECORD * f + SIX]
        mean = area / np.float64(count)
        both = own + mean
        numbers[per_face * f + np.uint64(18)] = np.float32(own / both if both > 0.0 else 0.5)


@compiled
def _add_pair(rows, per_1, per_2, block, sums):  # type: ignore[no-untyped-def]
    """Sums of w n for two ranges: six rows."""
    for at in range(R6):
        sums[at] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            nx, ny, nz = block[at + NX], block[at + NY], block[at + NZ]
            w, jump = block[at + WIDE_WEIGHT], block[at + JUMP]
            a, b = _1 - jump * per_1, _1 - jump * per_2
            a = a if a > _0 else _0
            b = b if b > _0 else _0
            a, b = w * a * a, w * b * b
            sums[lane] += a * nx
            sums[R1 + lane] += a * ny
            sums[R2 + lane] += a * nz
            sums[R3 + lane] += b * nx
            sums[R4 + lane] += b * ny
            sums[R5 + lane] += b * nz


@compiled
def filter_jointly(  # type: ignore[no-untyped-def]
    start, stop, records, per_reach, near_start, near, tasks, ranges, width, table
):
    """Fill two vectors for each task: filtered normals of two ranges.

    A row of ``tasks`` has the places of the guide, of the normals, and of the first outcome; its
    row of ``ranges`` has 1 / s^2 of both.
    """
    widest = ONE
    for f in range(np.uint64(start), np.uint64(stop)):
        widest = max(widest, near_start[f + ONE] - near_start[f] + ONE)
    block = np.empty(np.int64(widest * ENTRY), dtype=np.float32)
    sums = np.empty(np.int64(R6), dtype=np.float32)
    vectors = np.empty(np.int64(R6), dtype=np.float32)
    own = np.empty(np.int64(R3), dtype=np.float32)
    width = THREE * np.uint64(width)
    last = np.uint64(stop)
    for first in range(np.uint64(start), last, LANES):
        rows = near_block(first, last, records, per_reach, near_start, near, block, own)
        weigh_block(rows, block, own)
        for task in range(len(tasks)):
            guide, normal, to = (
                THREE * np.uint64(tasks[task, 0]),
                THREE * np.uint64(tasks[task, 1]),
                THREE * np.uint64(tasks[task, 2]),
            )
            _lay_normals(first, last, near_start, near, guide, normal, width, table, block, own)
            _add_pair(rows, ranges[task, 0], ranges[task, 1], block, sums)
            _normalise(sums, ZERO, own, vectors, ZERO)
            _normalise(sums, R3, own, vectors, ONE)
            for lane in range(LANES):
                if first + lane >= last:
                    break
                place = width * (first + lane) + to
                for k in range(SIX):
                    table[place + k] = vectors[k * R1 + lane]


@compiled
def _lay_normals(first, last, near_start, near, guide, normal, width, table, block, own):  # type: ignore[no-untyped-def]
    """Put other normals into a block, and the squares of the differences of their guides."""
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        at = width * f
        gx, gy, gz = table[at + guide], table[at + guide + ONE], table[at + guide + TWO]
        nx, ny, nz = table[at + normal], table[at + normal + ONE], table[at + normal + TWO]
        own[lane], own[R1 + lane], own[R2 + lane] = nx, ny, nz
        block[lane + NX], block[lane + NY], block[lane + NZ] = nx, ny, nz
        block[lane + JUMP] = _0
        place = ENTRY + lane
        for entry in range(near_start[f], near_start[f + ONE]):
            at = width * near[entry]
            dx = table[at + guide] - gx
            dy = table[at + guide + ONE] - gy
            dz = table[at + guide + TWO] - gz
            block[place + JUMP] = dx * dx + dy * dy + dz * dz
            block[place + NX] = table[at + normal]
            block[place + NY] = table[at + normal + ONE]
            block[place + NZ] = table[at + normal + TWO]
            place += ENTRY
