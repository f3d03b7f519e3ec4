"""K-means of plain numbers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

MOST_ROUNDS = 100
"""Rounds after which the clusters are taken as they are; a dozen is usual."""


def clusters(values: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """Number of its cluster for each of ``values`` (n,), n >= 1: 0 has the least, ``count`` - 1
    the greatest.

    Lloyd's iteration from evenly spaced quantiles.  Values are sorted first, so that the result
    does not depend on their order; equal values share a cluster, and a cluster may be empty.
    """
    order = np.sort(values)
    sums = np.concatenate([[0.0], np.cumsum(order)])
    seeds = (2 * np.arange(count) + 1) * len(order) // (2 * count)
    centres = order[seeds]
    bounds = 0.5 * (centres[1:] + centres[:-1])
    for _ in range(MOST_ROUNDS):
        cuts = np.concatenate([[0], np.searchsorted(order, bounds, side="right"), [len(order)]])
        sizes = np.diff(cuts)
        means = np.diff(sums[cuts]) / np.maximum(sizes, 1)
        centres = np.where(sizes > 0, means, centres)
        previous, bounds = bounds, 0.5 * (centres[1:] + centres[:-1])
        if np.array_equal(previous, bounds):
            break
    return np.searchsorted(bounds, values, side="left")
