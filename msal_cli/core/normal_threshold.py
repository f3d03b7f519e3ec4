"""Face normals averaged with those that deviate less than a threshold (Sun et al. 2007)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.geometry import VANISHED
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


@compiled
def _averaged(start, stop, normals, threshold, ring_start, ring, result):  # type: ignore[no-untyped-def]
    for f in range(start, stop):
        nx, ny, nz = normals[f, 0], normals[f, 1], normals[f, 2]
        own = 1.0 - threshold
        weights = own * own
        sx, sy, sz = weights * nx, weights * ny, weights * nz
        for at in range(ring_start[f], ring_start[f + 1]):
            g = ring[at]
            mx, my, mz = normals[g, 0], normals[g, 1], normals[g, 2]
            above = max(nx * mx + ny * my + nz * mz - threshold, 0.0)
            weight = above * above
            weights += weight
            sx += weight * mx
            sy += weight * my
            sz += weight * mz
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        if length <= VANISHED * weights:
            # A face without a normal finds none: a product of zero is below any threshold.
            result[f, 0] = nx
            result[f, 1] = ny
            result[f, 2] = nz
        else:
            result[f, 0] = sx / length
            result[f, 1] = sy / length
            result[f, 2] = sz / length


def threshold_averages(
    normals: Floats,
    ring_start: Ints,
    ring: Ints,
    threshold: float,
    passes: int,
    on_pass: Callable[[], object],
) -> Floats:
    """Unit normals (m, 3) after ``passes`` passes, each from the normals that the one before left.

    n'_i is the normalised sum of max(0, n_i . n_j - threshold)^2 n_j over face i itself and its
    neighbours.  Zero normals stay zero and do not count.

    Parameters
    ----------
    normals : (m, 3) unit normals, zeros for faces without; not changed.
    ring_start, ring : rows of neighbouring faces.
    threshold : 0 <= threshold < 1, a cosine.
    on_pass : called after every pass; what it raises ends the run.
    """
    for _ in range(passes):
        result = np.empty_like(normals)
        over_ranges(_averaged, len(normals), normals, threshold, ring_start, ring, result)
        normals = result
        on_pass()
    return normals
