"""From the positions of a mesh back to those of the file that it was made from."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.parallel import over_ranges


@compiled
def _scattered(start, stop, before, after, is_used, place, origin, original, result):
    for i in range(start, stop):
        k = place[i] if len(place) else np.int32(i)
        if k >= 0 and is_used[k]:
            x, y, z = after[k, 0], after[k, 1], after[k, 2]
            if x != before[k, 0] or y != before[k, 1] or z != before[k, 2]:
                result[i, 0] = x + origin[0]
                result[i, 1] = y + origin[1]
                result[i, 2] = z + origin[2]
                continue
        result[i, 0], result[i, 1], result[i, 2] = original[i, 0], original[i, 1], original[i, 2]


def scattered(
    before: Floats,
    after: Floats,
    is_used: NDArray[np.bool_],
    place: Ints | None,
    origin: Floats,
    original: Floats,
) -> Floats:
    """File positions (n_file, 3) for mesh positions ``after`` (n, 3), which were ``before``.

    ``place`` (n_file,) names the mesh vertex of each file vertex, -1 for none; None where they are
    the same.  A vertex that did not move or that ``is_used`` (n,) leaves out keeps its
    ``original``'s very value; ``origin`` (3,) is added to the others.
    """
    result = np.empty_like(original)
    nowhere = np.empty(0, dtype=np.int32)
    over_ranges(
        _scattered,
        len(original),
        before,
        after,
        is_used,
        nowhere if place is None else place,
        origin,
        original,
        result,
    )
    return result


@compiled
def _widest_gap(positions, place, first):
    widest = 0.0
    for i in range(len(place)):
        k = place[i]
        if k < 0:
            continue
        if first[k] < 0:
            first[k] = i
        at = first[k]
        dx = positions[i, 0] - positions[at, 0]
        dy = positions[i, 1] - positions[at, 1]
        dz = positions[i, 2] - positions[at, 2]
        widest = max(widest, dx * dx + dy * dy + dz * dz)
    return np.sqrt(widest)


def widest_gap(positions: Floats, place: Ints, n_places: int) -> float:
    """Largest distance of ``positions`` (n, 3) from the first one at the same place."""
    first = np.full(n_places, -1, dtype=np.int32)
    return float(_widest_gap(positions, place, first))
