"""The corners of faces, gathered from those blocks of the vertices that are in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags, Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.parallel import over_ranges

BLOCK_BITS = 16
"""A block has 2 ** 16 vertices."""


@compiled
def _mark_blocks(triangles, needed):
    bits = np.uint64(BLOCK_BITS)
    for f in range(len(triangles)):
        for k in range(3):
            needed[np.uint64(triangles[f, k]) >> bits] = True


def blocks_of(triangles: NDArray[np.uint32], n_blocks: int) -> Flags:
    """Which blocks (n_blocks,) have a corner of the triangles (m, 3)."""
    needed = np.zeros(n_blocks, dtype=bool)
    _mark_blocks(triangles, needed)
    return needed


@compiled
def _gather(start, stop, triangles, slots, blocks, corners):
    bits = np.uint64(BLOCK_BITS)
    mask = (np.uint64(1) << bits) - np.uint64(1)
    for f in range(start, stop):
        for k in range(3):
            vertex = np.uint64(triangles[f, k])
            slot = slots[vertex >> bits]
            if slot >= 0:
                row = vertex & mask
                for axis in range(3):
                    corners[f, 3 * k + axis] = blocks[slot, row, axis]


def gather_corners(
    triangles: NDArray[np.uint32],
    slots: Ints,
    blocks: NDArray[np.floating],
    corners: NDArray[np.floating],
) -> None:
    """Write the positions of the corners of ``triangles`` (m, 3) to ``corners`` (m, 9), as far as
    their blocks are in memory.

    ``slots`` says for each block of the file where it lies in ``blocks`` (k, 2 ** 16, 3), -1 for
    those that are not there.
    """
    over_ranges(_gather, len(triangles), triangles, slots, blocks, corners)


@compiled
def _in_boxes(corners, low, high, found):
    count = 0
    for f in range(len(corners)):
        x, y, z = corners[f, 0], corners[f, 1], corners[f, 2]
        for box in range(len(low)):
            if (
                low[box, 0] <= x <= high[box, 0]
                and low[box, 1] <= y <= high[box, 1]
                and low[box, 2] <= z <= high[box, 2]
            ):
                found[count] = f
                count += 1
                break
    return count


def faces_in_boxes(corners: NDArray[np.floating], low: Floats, high: Floats) -> Longs:
    """Which faces, of ``corners`` (m, 9), have their first corner in one of the boxes from ``low``
    to ``high`` (k, 3)."""
    found = np.empty(len(corners), dtype=np.int64)
    return found[: _in_boxes(corners, low, high, found)]
