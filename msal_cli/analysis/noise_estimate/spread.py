"""How noise is spread: over the rings of a vertex, over regions, and in single spikes.

White noise leaves the same variance to fits over any number of rings.  Noise that was averaged
over closed one-rings leaves little to fits over few of them, and more to wider ones; ``LEFT`` says
how much.  What the surface itself leaves grows with the width too, but differs from place to
place, where noise has a floor: ``SHARPNESS``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.fits import (
    FOUR,
    ONE,
    SIX,
    THREE,
    TWO,
    Survey,
    WhiteEstimate,
    chi_square_quantile,
    quantile,
    ring_offsets,
    split_regions,
)
from msal_cli.arrays import Floats, Longs

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

LEFT = np.array(
    [
        [1.0, 1.0, 1.0, 1.0, 1.0],
        [0.2857, 0.3110, 0.3471, 0.5021, 0.7007],
        [0.0841, 0.0957, 0.1111, 0.2421, 0.4846],
        [0.0418, 0.0437, 0.0487, 0.1359, 0.3547],
        [0.0263, 0.0245, 0.0255, 0.0829, 0.2661],
    ]
)
"""Variance that the fits of the survey leave over, by the degrees of freedom, of noise with
variance 1 averaged 0 to 4 times over closed one-rings of a regular triangle grid (r, fit)."""

FREEDOMS = np.array(
    [
        [4.0, 13.0, 27.0, 51.0, 117.0],
        [4.0, 10.3, 16.9, 22.0, 39.4],
        [3.6, 6.2, 9.2, 11.8, 20.2],
        [3.2, 4.9, 7.1, 9.3, 15.3],
        [3.1, 4.5, 6.4, 8.3, 12.9],
    ]
)
"""Degrees of freedom of chi square with the same mean and variance (r, fit)."""

FLOOR, FLAT = 0.05, 0.2
"""Shares of the places at whose variances the level by scale is read."""

SEEN = 0.35
"""Share of the places without creases and texture that ``FLAT`` of all is, as a rule."""

WEIGHTS = np.array([0.0, 1.0, 1.0, 1.0, 0.7])
"""How much the fits count.  The one-ring's takes up most of the noise itself, and does not."""

ABOVE = np.array([0.6, 0.6, 0.5, 0.25, 0.08])
"""Weight of variance above the expected one, by fit; variance below it has 1.  The surface explains
more variance, and nothing explains less."""

MAX_ABOVE = 0.5
"""Greatest square that such an excess counts for."""

FINE = np.array([0.97, 0.79, 0.40, 0.27, 0.20])
FINE_WEIGHT, MAX_FINE = 0.1, 0.03
"""The level for white noise over that by the fit over two rings, by the number of averages,
measured on noise of 0.2 on 12 shapes; the weight of its error, and the most that it counts for."""

WHITE_FINE = 0.88
"""The same ratio, above which neighbours share nothing."""

MIN_RISE = 1.2
"""How much more of shared noise a fit over four rings leaves than one over two, at least."""

PER_RING = 0.02
"""How much less misfit one ring more has to bring, since the surface looks like more rings."""

DOUBT = 0.006
"""Difference of misfits by which the weight of a number of rings in the level falls to a third."""

SHARP = np.array([0.0, 0.58, 0.68, 0.705, 0.38])
"""Least ratios of standard deviations at ``FLOOR`` and ``FLAT``, by fit, of noise of any kind;
texture and shape are below one of them."""


LOUD_LEVEL = 0.12
SHARP_LOUD = np.array([0.0, 0.58, 0.68, 0.665, 0.38])
"""The same for levels from so many mean edges on, which fine texture seldom has."""

PATTERN = np.array([1.0, 1.0, 1.0, 0.92, 0.945])
"""Sharpness, by fit, that shape which repeats reaches and shared noise does not."""

RELIEF_SHARP, RELIEF_GROWTH = 0.8, 1.22
"""Sharpness of fits over six rings, and growth from four rings to six, compared with that of noise,
from which there is relief everywhere."""

SMOOTH_GROWTH = 0.97
"""Ratio of what degree 3 over three rings leaves to what degree 2 over two does, below which that
is smooth relief; shared noise has 1 to 1.16."""


@dataclass(frozen=True)
class Colour:
    """Over how many rings noise is shared.

    Attributes
    ----------
    rings : 0 to 4.
    level : standard deviation, mean edges.
    misfit : what is left unexplained, as a mean error of logarithms of standard deviations.
    margin : by how much other numbers of rings are worse.
    sharpness : (5,), by fit.
    is_floor : whether what wide fits leave over is as even as only noise is, and no pattern.
    is_relief : whether a smooth relief that is the same everywhere would leave that, too.
    is_pattern : whether it is more even than shared noise is: shape that repeats.
    """

    rings: int
    level: float
    misfit: float
    margin: float
    sharpness: Floats
    is_floor: bool
    is_relief: bool
    is_pattern: bool


def find_colour(
    survey: Survey, scale: Floats | None = None, fine: float | None = None
) -> Colour | None:
    """The colour of the noise, where it is alike everywhere but for ``scale`` (c,), by which the
    variances are divided; None where too little is known.  ``fine`` is the level for white noise,
    mean edges, where that is of all places."""
    floors = np.array([survey.quantile(fit, FLOOR, scale) for fit in range(5)])
    flats = np.array([survey.quantile(fit, FLAT, scale) for fit in range(5)])
    has = np.isfinite(flats) & (flats > 1e-12)
    if has.sum() < 3:
        return None
    flats, floors = np.where(has, flats, 1.0), np.where(has, np.maximum(floors, 0.0), 1.0)
    sharpness = np.where(has, np.sqrt(floors / flats), 0.0)
    expected = LEFT * chi_square_quantile(FREEDOMS, SEEN)
    levels = np.log(flats)[None] - np.log(expected)
    weights = np.where(has, WEIGHTS, 0.0)
    # Log variance of the noise on a grid about what each number of rings says.
    steps = np.linspace(-1.5, 1.0, 126)
    middle = (levels * weights).sum(axis=1) / weights.sum()
    tried = middle[:, None] + steps[None]
    errors = levels[:, :, None] - tried[:, None, :]
    squares = errors * errors
    above = ABOVE[None, :, None] * np.minimum(squares, MAX_ABOVE)
    costs = np.where(errors > 0.0, above, squares)
    totals = (weights[None, :, None] * costs).sum(axis=1) / weights.sum()
    misfits = 0.5 * np.sqrt(totals.min(axis=1))
    by_scale = np.sqrt(flats / chi_square_quantile(FREEDOMS[0], FLAT))
    if fine is not None and has[TWO]:
        ratio = max(fine / float(by_scale[TWO]), 0.1)
        totals += np.minimum(FINE_WEIGHT * np.log(ratio / FINE) ** 2, MAX_FINE)[:, None]
        if ratio > WHITE_FINE:
            totals[1:] += 1.0
    if not (has[TWO] and has[FOUR] and by_scale[FOUR] > MIN_RISE * by_scale[TWO]):
        totals[1:] += 1.0
    best = totals.argmin(axis=1)
    least = 0.5 * np.sqrt(totals[np.arange(len(best)), best])
    chosen = least + PER_RING * np.arange(len(best))
    rings = int(chosen.argmin())
    others = np.delete(chosen, rings)
    likely = np.exp((chosen[rings] - chosen) / DOUBT)
    logarithm = 0.5 * float(likely @ tried[np.arange(len(best)), best] / likely.sum())
    level = math.exp(logarithm)
    is_pattern = rings > 0 and bool((sharpness > PATTERN).any())
    least_sharpness = SHARP_LOUD if level > LOUD_LEVEL else SHARP
    # Whether fits leave more than such noise would.  Creases add to wide fits too, but not
    # everywhere.
    growth = float(by_scale[SIX] / by_scale[FOUR])
    growth /= math.sqrt(LEFT[rings, SIX] / LEFT[rings, FOUR])
    is_wide = sharpness[SIX] > RELIEF_SHARP and growth > RELIEF_GROWTH
    is_relief = bool(is_wide or by_scale[THREE] < SMOOTH_GROWTH * by_scale[TWO])
    return Colour(
        rings=rings,
        level=level,
        misfit=float(misfits[rings]),
        margin=float(others.min() - chosen[rings]),
        sharpness=sharpness,
        is_floor=bool((sharpness >= least_sharpness).all()) and not is_pattern,
        is_relief=is_relief,
        is_pattern=is_pattern,
    )


# Levels by region, where the noise is not the same everywhere

MAX_REGIONS, MIN_PLACES = 16, 20
"""Regions of the survey, and the places that each has on average."""

SHARES = (0.1, 0.3, 0.4, 0.5)
"""Shares of the places of a region at which variances are read: the first and the last for
``PURE``, the second for the region's level, the third for its part in the level of the mesh."""

PURE = 0.3
"""Least ratio of the variances of a tenth and of half of the places in a region that is in one part
of the mesh only."""

LOUD_SHARE = 0.16
"""Regions with less than this share of the greatest variance are quiet."""

UNEVEN, MIN_LOUD = 2.5, 0.05
"""Least ratio of the most to the least noisy region, and least level of the former, mean edges."""


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
    count = min(MAX_REGIONS, int(has.sum()) // MIN_PLACES)
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
        if count < MIN_PLACES // 2:
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
    if highest < MIN_LOUD or highest < UNEVEN * lowest:
        return None
    middle = float(np.median(lows[known]))
    lows, means = np.where(known, lows, middle), np.where(known, means, middle)
    scale = np.where(is_pure & (lows > LOUD_SHARE * highest**2), lows, 0.0)[labels]
    return Differences(middles, labels, lows, means, is_pure, scale)


def weigh_differences(differences: Differences) -> float:
    """Mean variance over the mesh, squared mean edge lengths."""
    counts = np.bincount(differences.labels, minlength=len(differences.middles))
    return float(counts @ differences.means / counts.sum())


# Spikes: impulses along the normals, and outliers in any direction


MIN_OUTLIERS = 0.004
"""Share of the vertices from which they are outliers."""

OUTLYING, TIMES_USUAL, USUAL = 0.9, 3.5, 0.7
"""Least distance of an outlier from the middle of its ring: in mean edge lengths, and as a multiple
of the distance that the share ``USUAL`` of the vertices does not exceed."""


def outlying_share(mesh: Mesh, white: WhiteEstimate, survey: Survey) -> tuple[float, float]:
    """Share of the vertices that lie far off their neighbours, and the median of their ways within
    the surface, mean edges; 0 and 0 for too few."""
    fewest = MIN_OUTLIERS * len(white.places)
    far = white.places[white.far]
    if len(far) <= fewest:
        return 0.0, 0.0
    lengths = np.sqrt((survey.offsets * survey.offsets).sum(axis=1))
    least = max(OUTLYING, TIMES_USUAL * quantile(lengths, USUAL))
    offsets = ring_offsets(mesh, far)[0] / white.edge
    squares = (offsets * offsets).sum(axis=1)
    is_out = squares > least * least
    if is_out.sum() <= fewest:
        return 0.0, 0.0
    along = (offsets * mesh.vertex_normals("uniform", 1)[far]).sum(axis=1)
    within = np.sqrt(np.maximum(squares - along * along, 0.0))
    # Among many outliers some are not detected, but they are as far off.
    share = max(float((lengths > least).mean()), float(is_out.sum()) / len(white.places))
    return share, float(np.median(within[is_out]))
