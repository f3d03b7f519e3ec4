"""Vectors, triangles and rows, for kernels to call."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled

ZERO, ONE, TWO, THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)


@compiled
def longest_row(start, stop, row_start):
    """The most items of a row in a range of rows; of the type of differences of ``row_start``."""
    longest = row_start[start] - row_start[start]
    for i in range(np.int64(start), np.int64(stop)):
        longest = max(longest, row_start[i + 1] - row_start[i])
    return longest


@compiled
def sort_few(values, count):
    """Sort ``values[:count]`` by Shell's method.

    A one-ring is sorted by insertion in effect; the gaps keep a hub of 50,000 affordable.
    """
    gap = 1
    while gap < count // 3:
        gap = 3 * gap + 1
    while gap > 0:
        for at in range(gap, count):
            value = values[at]
            hole = at
            while hole >= gap and values[hole - gap] > value:
                values[hole] = values[hole - gap]
                hole -= gap
            values[hole] = value
        gap //= 3


@compiled
def write_unit(x, y, z, least, kept, i, result):
    """Write the unit vector of (x, y, z) as item i of ``result``, (m, 3) flat; where it is no
    longer than ``least``, that of ``kept``."""
    length = np.sqrt(x * x + y * y + z * z)
    at = THREE * np.uint64(i)
    is_longer = length > least
    result[at] = x / length if is_longer else kept[at]
    result[at + ONE] = y / length if is_longer else kept[at + ONE]
    result[at + TWO] = z / length if is_longer else kept[at + TWO]


@compiled
def edges_and_normal(x, a, b, c):
    """Edges u = x_b - x_a and w = x_c - x_a of a triangle, and u x w: twice its area long."""
    ux, uy, uz = x[b, 0] - x[a, 0], x[b, 1] - x[a, 1], x[b, 2] - x[a, 2]
    wx, wy, wz = x[c, 0] - x[a, 0], x[c, 1] - x[a, 1], x[c, 2] - x[a, 2]
    nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
    return ux, uy, uz, wx, wy, wz, nx, ny, nz


@compiled
def longest_square(ux, uy, uz, wx, wy, wz):
    """The squared length of the longest edge of a triangle with edges u and w from one corner."""
    vx, vy, vz = wx - ux, wy - uy, wz - uz
    return max(
        ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz, vx * vx + vy * vy + vz * vz
    )
