"""Levels by region, where the noise is not the same everywhere."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.quantiles import chi_square_quantile
from msal_cli.analysis.noise_estimate.regions import split_regions
from msal_cli.analysis.noise_estimate.survey import ONE, TWO, Survey
from msal_cli.arrays import Floats, Longs

MOST_REGIONS, FEWEST_PLACES = 16, 20
"""Regions of the survey, and the places that each has on average."""

SHARES = (0.1, 0.3, 0.4, 0.5)
"""Shares of the places of a region: for the least and the middle for ``PURE``, and between them
for its level and for its share in the level of all."""

PURE = 0.3
"""Least ratio of the variances of a tenth and of half of the places in a region that is in one part
of the mesh only."""

LOUD = 0.16
"""Variance, over the most of all regions, of those whose noise is looked at."""

UNEVEN, LEAST_LOUD = 2.5, 0.05
"""Ratio of the most to the least noisy region, and mean edge lengths that the former has."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Variances by region that differ, squared mean edge lengths.

    Attributes
    ----------
    middles, labels : places (r,) that are middles, and the region of each place (c,).
    lows, means : (r,) for the level and for its share in the level of all.
    is_pure : (r,) whether a region is in one part of the mesh only.
    scale : (c,) variance of the region of each place; 0 where it is quiet, or between two parts.
    """

    middles: Longs
    labels: Longs
    lows: Floats
    means: Floats
    is_pure: NDArray[np.bool_]
    scale: Floats


def find_differences(survey: Survey) -> Differences | None:
    """Variances by region, if they differ by more than chance makes them."""
    has = np.isfinite(survey.variances[:, : TWO + 1]).all(axis=1)
    count = min(MOST_REGIONS, int(has.sum()) // FEWEST_PLACES)
    if count < 2:
        return None
    middles, labels = split_regions(survey.positions, count)
    # Nearly all places have as many degrees of freedom.
    freedoms = np.median(survey.freedoms[has, : TWO + 1], axis=0)
    factors = np.array([chi_square_quantile(freedoms, share) for share in SHARES[1:3]])
    lows, means = np.zeros(len(middles)), np.zeros(len(middles))
    is_pure, known = np.zeros(len(middles), dtype=bool), np.zeros(len(middles), dtype=bool)
    for region in range(len(middles)):
        among = has & (labels == region)
        count = int(among.sum())
        if count < FEWEST_PLACES // 2:
            continue
        ranks = (np.array(SHARES) * (count - 1)).astype(int)
        few, low, some, half = np.sort(survey.variances[among, TWO])[ranks]
        known[region], is_pure[region] = True, few > PURE * half
        _, plane_low, plane_some, _ = np.sort(survey.variances[among, ONE])[ranks]
        # Shape adds more to the wider fit, and the least of both would be too little on average.
        lows[region] = min(low / factors[0, 1], plane_low / factors[0, 0])
        means[region] = math.sqrt(some / factors[1, 1] * plane_some / factors[1, 0])
    if known.sum() < 2:
        return None
    lowest, highest = math.sqrt(lows[known].min()), math.sqrt(lows[known].max())
    if highest < LEAST_LOUD or highest < UNEVEN * lowest:
        return None
    middle = float(np.median(lows[known]))
    lows, means = np.where(known, lows, middle), np.where(known, means, middle)
    scale = np.where(is_pure & (lows > LOUD * highest**2), lows, 0.0)[labels]
    return Differences(middles, labels, lows, means, is_pure, scale)


def weigh_differences(differences: Differences) -> float:
    """Mean variance over the mesh, squared mean edge lengths."""
    counts = np.bincount(differences.labels, minlength=len(differences.middles))
    return float(counts @ differences.means / counts.sum())
