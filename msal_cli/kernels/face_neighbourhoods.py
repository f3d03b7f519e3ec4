"""Which faces lie within a distance of a face, found along the surface.

A flood through the connectivity, not a ball in space: the other side of a thin wall is not found,
and no search tree is needed.  It goes on through faces whose centroids are within the distance.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, most_neighbours
from msal_cli.kernels.variable_rows import found_rows


@compiled
def _reached(start, stop, first, c, ring_start, ring, radii, most, sizes, near):
    """Find rows as ``found_rows`` wants them; c centroids, flat; ``radii`` one, or one a face."""
    has_own = len(radii) > 1
    seen = np.empty(len(ring_start) - 1, dtype=np.uint32)
    nobody = np.uint32(len(seen))
    for face in range(np.uint64(len(seen))):
        seen[face] = nobody
    most = np.uint64(most)
    found = np.empty(np.int64(most + most_neighbours(np.uint64(0), nobody, ring_start)), np.uint32)
    filled = np.uint64(start) * most
    for own in range(np.uint64(first + start), np.uint64(first + stop)):
        p = THREE * own
        x, y, z = c[p], c[p + ONE], c[p + TWO]
        radius = radii[own] if has_own else radii[0]
        square_radius = radius * radius
        name = np.uint32(own)
        seen[own] = name
        g = np.uint64(own)
        count = at = np.uint64(0)
        while True:
            for entry in range(np.uint64(ring_start[g]), np.uint64(ring_start[g + ONE])):
                # Whether a face is new and near cannot be foreseen: without a branch each is
                # written down, and kept by being counted.
                k = np.uint64(ring[entry])
                p = THREE * k
                dx, dy, dz = c[p] - x, c[p + ONE] - y, c[p + TWO] - z
                is_near = dx * dx + dy * dy + dz * dz <= square_radius
                found[count] = ring[entry]
                count += np.uint64(is_near & (seen[k] != name))
                seen[k] = name
            if at >= count or count >= most:
                break
            g = np.uint64(found[at])
            at += ONE
        count = min(count, most)
        for place in range(count):
            near[filled + place] = found[place]
        sizes[own] = count
        filled += count
    return start * np.int64(most), np.int64(filled)


def faces_within(
    centroids: Floats, ring_start: Ints, ring: Ints, radius: float | Floats, most: int
) -> tuple[Longs, Ints]:
    """Rows of the faces near each face: ``near_start`` (m + 1,) int64 and ``near``.

    Parameters
    ----------
    centroids : (m, 3), file units.
    ring_start, ring : rows of the neighbours that the flood goes through, (m + 1,) and (k,).
    radius : distance between centroids up to which a face is near, file units; or (m,), one for
        each face, from which the distance is measured.
    most : faces at which the flood from a face stops; the first that it meets are kept.

    A face is not in its own row.  Rows begin with the nearest neighbours, in steps along ``ring``.
    """
    sizes, near = found_rows(
        _reached,
        len(centroids),
        most,
        centroids.reshape(-1),
        ring_start.view(np.uint32),
        ring.view(np.uint32),
        np.atleast_1d(np.float64(radius)),
        most,
    )
    near_start = np.zeros(len(centroids) + 1, dtype=np.int64)
    np.cumsum(sizes, dtype=np.int64, out=near_start[1:])
    return near_start, near
