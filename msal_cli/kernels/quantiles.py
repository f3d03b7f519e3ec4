"""Medians, quantiles of numbers and of distributions, distinct numbers and clusters of them.

These avoid masked arrays, whose import numpy's own functions need.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats

PER_MEDIAN = 1.4826
"""Standard deviation of a normal distribution per median absolute deviation."""


def median(values: Floats) -> float:
    """The median of at least one number, none of them NaN; the mean of the middle two."""
    middle = len(values) // 2
    parts = np.partition(values, middle)
    # Partitioning by two ranks takes six times as long.
    below = parts[middle] if len(values) % 2 else parts[:middle].max()
    return float(below + parts[middle]) / 2.0


def find_distinct(values: NDArray[Any]) -> NDArray[Any]:
    """The distinct non-negative integers in ``values`` (n,), ascending."""
    ordered = np.sort(values)
    return ordered[np.diff(ordered, prepend=-1) > 0]


def quantiles(values: Floats, shares: Sequence[float]) -> Floats:
    """The quantiles ``shares`` (s,) of values (n,), interpolated like those of
    ``numpy.quantile``."""
    ordered = np.sort(values)
    places = np.asarray(shares) * (len(ordered) - 1)
    low = places.astype(np.int64)
    high = np.minimum(low + 1, len(ordered) - 1)
    result: Floats = ordered[low] + (ordered[high] - ordered[low]) * (places - low)
    return result


def quantile_above_zero(values: Floats, share: float) -> float:
    """The quantile ``share`` of values above zero, without interpolation; 0.0 if there are none.

    ``values`` (n,) are not below zero and not NaN; 0 < ``share`` <= 1, where 1 gives the largest.
    """
    above = int(np.count_nonzero(values))
    if not above:
        return 0.0
    rank = len(values) - above + math.ceil(share * above) - 1
    return float(np.partition(values, rank)[rank])


MAX_ROUNDS = 100
"""Largest number of iterations; a dozen is usual."""


def clusters(values: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """The cluster number of each of ``values`` (n,), n >= 1: 0 for the smallest values.

    Lloyd's iteration from evenly spaced quantiles.  Values are sorted first, so that the result
    does not depend on their order; equal values share a cluster, and a cluster may be empty.
    """
    order = np.sort(values)
    sums = np.concatenate([[0.0], np.cumsum(order)])
    seeds = (2 * np.arange(count) + 1) * len(order) // (2 * count)
    centres = order[seeds]
    bounds = 0.5 * (centres[1:] + centres[:-1])
    for _ in range(MAX_ROUNDS):
        cuts = np.concatenate([[0], np.searchsorted(order, bounds, side="right"), [len(order)]])
        sizes = np.diff(cuts)
        means = np.diff(sums[cuts]) / np.maximum(sizes, 1)
        centres = np.where(sizes > 0, means, centres)
        previous, bounds = bounds, 0.5 * (centres[1:] + centres[:-1])
        if np.array_equal(previous, bounds):
            break
    return np.searchsorted(bounds, values, side="left")


def student(freedoms: Floats) -> Floats:
    """The 99.5 % quantile of Student's distribution for at least five degrees of freedom, within 1
    %; in absolute value it is exceeded in one of 100 cases."""
    # Abramowitz and Stegun 26.7.5, with the normal quantile of 0.995.
    z = 2.5758293
    first = (z**3 + z) / 4.0
    second = (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0
    third = (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0
    bounds: Floats = z + first / freedoms + second / freedoms**2 + third / freedoms**3
    return bounds
