"""Faces near a face side by side with those near others: blocks whose lanes are faces.

Sums over the neighbours of one face are too short for vector code.  So ``LANES`` faces are worked
on at a time, and what belongs to the k-th neighbour of each is in a row.  No sum goes across
lanes, so that no bit depends on the block, the lane or the thread that a face falls to.

Sums over the neighbours are in rows of lanes too, and are named by the place of their first row.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.vectors import ONE, THREE, TWO

LANES = np.uint64(16)
"""Faces that are worked on at a time: what belongs to them fits a first-level cache."""

R1, R2, R3, R4, R5, R6, R7, R8, R9, R10, R11, R12, R13, R14, R15, R16 = (
    LANES * np.uint64(rows) for rows in range(1, 17)
)
"""What so many rows of lanes take."""

X, Y, Z, NX, NY, NZ, NARROW_WEIGHT, WIDE_WEIGHT, JUMP = (LANES * np.uint64(row) for row in range(9))
"""The rows of lanes that a neighbour has in a block."""

ENTRY = R9
"""What a neighbour takes in a block."""

NARROW, WIDE = 1.45, 2.7
"""The reaches of both weights, in local units."""

FOUR, FIVE, SIX = np.uint64(4), np.uint64(5), np.uint64(6)

_0, _1 = np.float32(0.0), np.float32(1.0)
_TINY = np.float32(1e-30)
_SMALL = np.float32(1e-24)
_EVEN = np.float32(1e-4)
_RATIO = np.float32((WIDE / NARROW) ** 2)


@compiled
def lay_neighbours(first, last, points, marks, per_reach, near_start, near, block, own):
    """Lay the neighbours of the faces ``first`` to ``last`` side by side; return how many rows.

    ``points`` are the centroids, ``marks`` normals and areas (m, 4), flat; ``per_reach`` (m,) one
    over WIDE local units.  The first row is the faces themselves.  Lanes without a k-th neighbour
    have weight zero, and their own normal.  ``own`` gets the normals of the lanes.
    """
    rows = ONE
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        rows = max(rows, near_start[f + ONE] - near_start[f] + ONE)
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        at, mark = THREE * f, FOUR * f
        x, y, z, scale = points[at], points[at + ONE], points[at + TWO], per_reach[f]
        nx, ny, nz = marks[mark], marks[mark + ONE], marks[mark + TWO]
        own[lane], own[R1 + lane], own[R2 + lane] = nx, ny, nz
        block[X + lane], block[Y + lane], block[Z + lane] = _0, _0, _0
        block[NX + lane], block[NY + lane], block[NZ + lane] = nx, ny, nz
        block[WIDE_WEIGHT + lane] = marks[mark + THREE]
        row, end = near_start[f], near_start[f + ONE]
        place = ENTRY + lane
        for entry in range(row, end):
            at, mark = THREE * near[entry], FOUR * near[entry]
            block[place + X] = np.float32((points[at] - x) * scale)
            block[place + Y] = np.float32((points[at + ONE] - y) * scale)
            block[place + Z] = np.float32((points[at + TWO] - z) * scale)
            block[place + NX] = marks[mark]
            block[place + NY] = marks[mark + ONE]
            block[place + NZ] = marks[mark + TWO]
            block[place + WIDE_WEIGHT] = marks[mark + THREE]
            place += ENTRY
        for _ in range(end - row + ONE, rows):
            block[place + X], block[place + Y], block[place + Z] = _0, _0, _0
            block[place + NX], block[place + NY], block[place + NZ] = nx, ny, nz
            block[place + WIDE_WEIGHT] = _0
            place += ENTRY
    return rows


@compiled
def weigh_block(rows, block, own):
    """Turn areas into the weights of both reaches, and put |n_i - n_j|^2 beside them.

    Returns the number of rows after which no narrow weight is above zero.
    """
    narrow_rows = ONE
    for k in range(rows):
        row = k * ENTRY
        near = np.uint32(0)
        for lane in range(LANES):
            at = row + lane
            x, y, z = block[at + X], block[at + Y], block[at + Z]
            square = x * x + y * y + z * z
            wide = _1 - square
            wide = wide if wide > _0 else _0
            close = _1 - square * _RATIO
            close = close if close > _0 else _0
            area = block[at + WIDE_WEIGHT]
            block[at + WIDE_WEIGHT] = area * wide * wide
            close = area * close * close
            block[at + NARROW_WEIGHT] = close
            # A sum of integers is vector code; the greatest number would not be.
            near += np.uint32(close > _0)
            dx = block[at + NX] - own[lane]
            dy = block[at + NY] - own[R1 + lane]
            dz = block[at + NZ] - own[R2 + lane]
            block[at + JUMP] = dx * dx + dy * dy + dz * dz
        if near > np.uint32(0):
            narrow_rows = k + ONE
    return narrow_rows


@compiled
def lay_vectors(first, last, points, marks, per_reach, near_start, near, n_read, read, block):
    """Lay the wide weights of ``weigh_block`` and the vectors of neighbours side by side.

    ``read`` has ``n_read`` vectors of each face, which take 3 ``n_read`` rows after the weight's.
    Returns how many rows of neighbours.
    """
    rows, numbers = ONE, THREE * n_read
    entry_size = (numbers + ONE) * R1
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        rows = max(rows, near_start[f + ONE] - near_start[f] + ONE)
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        at = THREE * f
        x, y, z, scale = points[at], points[at + ONE], points[at + TWO], per_reach[f]
        block[lane] = marks[FOUR * f + THREE]
        for k in range(numbers):
            block[lane + R1 + k * R1] = read[numbers * f + k]
        row, end = near_start[f], near_start[f + ONE]
        place = entry_size + lane
        for entry in range(row, end):
            j = np.uint64(near[entry])
            at = THREE * j
            dx = np.float32((points[at] - x) * scale)
            dy = np.float32((points[at + ONE] - y) * scale)
            dz = np.float32((points[at + TWO] - z) * scale)
            wide = _1 - (dx * dx + dy * dy + dz * dz)
            wide = wide if wide > _0 else _0
            block[place] = marks[FOUR * j + THREE] * wide * wide
            at, to = numbers * j, place + R1
            for _ in range(n_read):
                block[to], block[to + R1], block[to + R2] = read[at], read[at + ONE], read[at + TWO]
                at += THREE
                to += R3
            place += entry_size
        for _ in range(end - row + ONE, rows):
            for k in range(numbers + ONE):
                block[place + k * R1] = _0
            place += entry_size
    return rows


@compiled
def add_narrow(rows, block, sums, to):
    """Sums of w and w n with the narrow weights."""
    for place in range(to, to + R4):
        sums[place] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            w = block[at + NARROW_WEIGHT]
            o = to + lane
            sums[o] += w
            sums[o + R1] += w * block[at + NX]
            sums[o + R2] += w * block[at + NY]
            sums[o + R3] += w * block[at + NZ]


@compiled
def add_ranges(rows, per_1, per_2, per_3, block, sums, to):
    """Sums of w, w n with the wide weights for three ranges and for all: 16 sums from ``to`` on."""
    for place in range(to, to + R16):
        sums[place] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            nx, ny, nz = block[at + NX], block[at + NY], block[at + NZ]
            w, jump = block[at + WIDE_WEIGHT], block[at + JUMP]
            a, b, c = _1 - jump * per_1, _1 - jump * per_2, _1 - jump * per_3
            a = a if a > _0 else _0
            b = b if b > _0 else _0
            c = c if c > _0 else _0
            a, b, c = w * a * a, w * b * b, w * c * c
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
            sums[o + R12] += w
            sums[o + R13] += w * nx
            sums[o + R14] += w * ny
            sums[o + R15] += w * nz


@compiled
def add_tensor(rows, block, sums, to):
    """Sums of w n n^T with the wide weights: xx, xy, xz, yy, yz, zz."""
    for place in range(to, to + R6):
        sums[place] = _0
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


@compiled
def add_skews(rows, axes, block, skews):
    """Sums of w (n . e)^3 for each axis e."""
    for place in range(R3):
        skews[place] = _0
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
def add_scatter(rows, mean, block, sums):
    """The greatest |n - mean|^2 within the narrow reach, and the sum by weight."""
    for place in range(R2):
        sums[place] = _0
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
def add_plane(rows, per_range, block, sums, to):
    """Sums of w, w d and w d d^T with the wide weights, ten from ``to`` on; ``per_range`` 0: all
    ranges."""
    for place in range(to, to + R10):
        sums[place] = _0
    for k in range(rows):
        row = k * ENTRY
        for lane in range(LANES):
            at = row + lane
            x, y, z = block[at + X], block[at + Y], block[at + Z]
            part = _1 - block[at + JUMP] * per_range
            part = part if part > _0 else _0
            w = block[at + WIDE_WEIGHT] * part * part
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
def normalise(sums, at, kept, vectors, place):
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
def fit_plane(sums, at, base, vectors, place, to, spread):
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
        vectors[o], vectors[o + R1], vectors[o + R2] = x, y, z
        height = mx * x + my * y + mz * z
        spread[to + lane] = (
            x * (xx * x + xy * y + xz * z)
            + y * (xy * x + yy * y + yz * z)
            + z * (xz * x + yz * y + zz * z)
        )
        spread[to + R1 + lane] = height
        off = mx * mx + my * my + mz * mz - height * height
        spread[to + R2 + lane] = off if off > _0 else _0


@compiled
def add_pair(rows, entry_size, guide, normal, per_1, per_2, block, sums):
    """Sums of w n for two ranges of the differences of guides: six rows.

    ``guide`` and ``normal`` are the places of their vectors in a block of ``lay_vectors``.
    """
    for place in range(R6):
        sums[place] = _0
    for k in range(rows):
        row = k * entry_size
        for lane in range(LANES):
            g, n = row + guide + lane, row + normal + lane
            dx = block[g] - block[guide + lane]
            dy = block[g + R1] - block[guide + R1 + lane]
            dz = block[g + R2] - block[guide + R2 + lane]
            jump = dx * dx + dy * dy + dz * dz
            nx, ny, nz = block[n], block[n + R1], block[n + R2]
            w = block[row + lane]
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
