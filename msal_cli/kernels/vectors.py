"""Vectors and triangles, for kernels to call."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO


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
