"""Which faces lie within a distance of a face, found along the surface.

A flood through the connectivity, not a ball in space: the other side of a thin wall is not found,
and no search tree is needed.  It goes on through faces whose centroids are within the distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
LongInts = NDArray[np.int64]


@compiled
def _reached(  # type: ignore[no-untyped-def]
    start, stop, centroids, ring_start, ring, square_radius, most, sizes, near_start, near
):
    """Fill the rows of ``near``; where it is empty, count their ``sizes``."""
    seen = np.full(len(centroids), -1, dtype=np.int32)
    found = np.empty(most + 1, dtype=np.int32)
    filling = len(near) > 0
    for f in range(start, stop):
        x, y, z = centroids[f, 0], centroids[f, 1], centroids[f, 2]
        seen[f] = f
        found[0] = f
        count = 1
        at = 0
        while at < count and count <= most:
            g = found[at]
            at += 1
            for entry in range(ring_start[g], ring_start[g + 1]):
                k = ring[entry]
                if seen[k] == f:
                    continue
                seen[k] = f
                dx, dy, dz = centroids[k, 0] - x, centroids[k, 1] - y, centroids[k, 2] - z
                if dx * dx + dy * dy + dz * dz <= square_radius:
                    found[count] = k
                    count += 1
                    if count > most:
                        break
        sizes[f] = count - 1
        if filling:
            row = near_start[f]
            for at in range(1, count):
                near[row + at - 1] = found[at]


def faces_within(
    centroids: Floats, ring_start: Ints, ring: Ints, radius: float, most: int
) -> tuple[LongInts, Ints]:
    """Rows of the faces near each face: ``near_start`` (m + 1,) int64 and ``near``.

    Parameters
    ----------
    centroids : (m, 3), file units.
    ring_start, ring : rows of the neighbours that the flood goes through, (m + 1,) and (k,).
    radius : distance between centroids up to which a face is near, file units.
    most : faces at which the flood from a face stops; the first that it meets are kept.

    A face is not in its own row.  Rows begin with the nearest neighbours, in steps along ``ring``.
    """
    sizes = np.empty(len(centroids), dtype=np.int32)
    near_start = np.zeros(len(centroids) + 1, dtype=np.int64)
    near = np.empty(0, dtype=np.int32)
    known = (centroids, ring_start, ring, radius * radius, most, sizes)
    over_ranges(_reached, len(centroids), *known, near_start, near)
    np.cumsum(sizes, dtype=np.int64, out=near_start[1:])
    if near_start[-1]:
        near = np.empty(near_start[-1], dtype=np.int32)
        over_ranges(_reached, len(centroids), *known, near_start, near)
    return near_start, near
