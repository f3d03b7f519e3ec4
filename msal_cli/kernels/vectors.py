"""Vectors, triangles and rows, for kernels to call."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled

ZERO, ONE, TWO, THREE = np.uint64(0), np.uint64(1), np.uint64(2), np.uint64(3)


@compiled
def most_neighbours(start, stop, ring_start):
    """The largest number of neighbours in a range of vertices; ``ring_start`` as uint32."""
    widest = ZERO
    for i in range(np.uint64(start), np.uint64(stop)):
        widest = max(widest, ring_start[i + ONE] - ring_start[i])
    return widest


@compiled
def longest_row(start, stop, row_start):
    """The same for rows whose starts are signed."""
    longest = 0
    for i in range(start, stop):
        longest = max(longest, row_start[i + 1] - row_start[i])
    return longest


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
