"""Face normals averaged with those that deviate less than a threshold (Sun et al. 2007)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.geometry import VANISHED
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO


@compiled
def _averaged(start, stop, n, threshold, ring_start, ring, result):
    """n normals, flat as the result; indices are unsigned, and not looked at for their sign."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = THREE * f
        nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
        weights = (1.0 - threshold) * (1.0 - threshold)
        sx, sy, sz = weights * nx, weights * ny, weights * nz
        for at in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
            g = THREE * ring[at]
            mx, my, mz = n[g], n[g + ONE], n[g + TWO]
            above = nx * mx + ny * my + nz * mz - threshold
            above = above if above > 0.0 else 0.0
            weight = above * above
            weights += weight
            sx += weight * mx
            sy += weight * my
            sz += weight * mz
        length = np.sqrt(sx * sx + sy * sy + sz * sz)
        if length > VANISHED * weights:
            # A face without a normal finds none: a product of zero is below any threshold.
            nx, ny, nz = sx / length, sy / length, sz / length
        result[own], result[own + ONE], result[own + TWO] = nx, ny, nz


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
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    given = spare = normals
    for _ in range(passes):
        # The input must stay as it is; from the third pass on, two arrays take turns.
        result = np.empty_like(normals) if spare is given else spare
        flat = normals.reshape(-1), threshold, *rows, result.reshape(-1)
        over_ranges(_averaged, len(normals), *flat)
        normals, spare = result, normals
        on_pass()
    return normals
