"""Faces near a face side by side with those near others: blocks whose lanes are faces.

Sums over the neighbours of one face are too short for vector code.  So ``LANES`` faces are worked
on at a time, and what belongs to the k-th neighbour of each stands in a row.  No sum goes across
lanes, so that no bit depends on the block, the lane or the thread that a face falls to.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO

LANES = np.uint64(32)
"""Faces that are worked on at a time."""

R1, R2, R3, R4, R5, R6, R7, R8, R9, R10, R11, R12, R13, R14, R15, R16 = (
    np.uint64(32 * rows) for rows in range(1, 17)
)
"""What so many rows of lanes take."""

RECORD = np.uint64(8)
"""Numbers of a face in the table that neighbours are read from: centroid, normal, area, 0."""

X, Y, Z, NX, NY, NZ, NARROW_WEIGHT, WIDE_WEIGHT, JUMP = (np.uint64(32 * row) for row in range(9))
"""The rows of lanes that a neighbour has in a block."""

ENTRY = R9
"""What a neighbour takes in a block."""

NARROW, WIDE = 1.45, 2.7
"""The reaches of both weights, in local units."""

FOUR, FIVE, SIX = np.uint64(4), np.uint64(5), np.uint64(6)

_0, _1 = np.float32(0.0), np.float32(1.0)
_RATIO = np.float32((WIDE / NARROW) ** 2)


@compiled
def lay_neighbours(first, last, records, per_reach, near_start, near, block, own):
    """Lay the neighbours of the faces ``first`` to ``last`` side by side; return how many rows.

    ``records`` flat, ``per_reach`` (m,) one over WIDE local units.  The first row is the faces
    themselves.  Lanes without a k-th neighbour have weight zero, and their own normal.  ``own``
    gets the normals of the lanes.
    """
    rows = ONE
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        at = RECORD * f
        block[X + lane], block[Y + lane], block[Z + lane] = _0, _0, _0
        nx, ny, nz = (
            np.float32(records[at + THREE]),
            np.float32(records[at + FOUR]),
            np.float32(records[at + FIVE]),
        )
        own[lane], own[R1 + lane], own[R2 + lane] = nx, ny, nz
        block[NX + lane], block[NY + lane], block[NZ + lane] = nx, ny, nz
        block[WIDE_WEIGHT + lane] = np.float32(records[at + SIX])
        rows = max(rows, near_start[f + ONE] - near_start[f] + ONE)
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        at = RECORD * f
        x, y, z, scale = records[at], records[at + ONE], records[at + TWO], per_reach[f]
        row, end = near_start[f], near_start[f + ONE]
        place = ENTRY + lane
        for entry in range(row, end):
            k = RECORD * near[entry]
            block[place + X] = np.float32((records[k] - x) * scale)
            block[place + Y] = np.float32((records[k + ONE] - y) * scale)
            block[place + Z] = np.float32((records[k + TWO] - z) * scale)
            block[place + NX] = np.float32(records[k + THREE])
            block[place + NY] = np.float32(records[k + FOUR])
            block[place + NZ] = np.float32(records[k + FIVE])
            block[place + WIDE_WEIGHT] = np.float32(records[k + SIX])
            place += ENTRY
        for _ in range(end - row + ONE, rows):
            block[place + X], block[place + Y], block[place + Z] = _0, _0, _0
            block[place + NX] = own[lane]
            block[place + NY] = own[R1 + lane]
            block[place + NZ] = own[R2 + lane]
            block[place + WIDE_WEIGHT] = _0
            place += ENTRY
    return rows


@compiled
def weigh_block(rows, block, own):
    """Turn areas into the weights of both reaches, and put |n_i - n_j|^2 beside them."""
    for k in range(rows):
        row = k * ENTRY
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
            block[at + NARROW_WEIGHT] = area * close * close
            dx = block[at + NX] - own[lane]
            dy = block[at + NY] - own[R1 + lane]
            dz = block[at + NZ] - own[R2 + lane]
            block[at + JUMP] = dx * dx + dy * dy + dz * dz


@compiled
def lay_weights(first, last, records, per_reach, near_start, near, block):
    """Lay only the wide weights side by side, those of ``weigh_block``."""
    rows = ONE
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        block[WIDE_WEIGHT + lane] = np.float32(records[RECORD * f + SIX])
        rows = max(rows, near_start[f + ONE] - near_start[f] + ONE)
    for lane in range(LANES):
        f = first + lane if first + lane < last else last - ONE
        at = RECORD * f
        cx, cy, cz, scale = records[at], records[at + ONE], records[at + TWO], per_reach[f]
        row, end = near_start[f], near_start[f + ONE]
        place = ENTRY + lane
        for entry in range(row, end):
            k = RECORD * near[entry]
            x = np.float32((records[k] - cx) * scale)
            y = np.float32((records[k + ONE] - cy) * scale)
            z = np.float32((records[k + TWO] - cz) * scale)
            wide = _1 - (x * x + y * y + z * z)
            wide = wide if wide > _0 else _0
            block[place + WIDE_WEIGHT] = np.float32(records[k + SIX]) * wide * wide
            place += ENTRY
        for _ in range(end - row + ONE, rows):
            block[place + WIDE_WEIGHT] = _0
            place += ENTRY
    return rows
