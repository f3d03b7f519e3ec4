"""Over how many rings neighbours share their noise: its level by scale.

White noise leaves the same variance to fits over any number of rings.  Noise that was averaged
over closed one-rings leaves little to fits over few of them, and more to wider ones; ``LEFT`` says
how much.  What the surface itself leaves grows with the width too, but differs from place to
place, where noise has a floor: ``SHARPNESS``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from msal_cli.analysis.noise_estimate.quantiles import chi_square_quantile
from msal_cli.analysis.noise_estimate.survey import FOUR, SIX, THREE, TWO, Survey
from msal_cli.arrays import Floats

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
"""What variance above the expected counts for, which the surface may have left, in comparison to
one below, which nothing explains."""

MOST_ABOVE = 0.5
"""Square of the most that the surface counts for, where it leaves more than all noise does."""

FINE = np.array([0.97, 0.79, 0.40, 0.27, 0.20])
FINE_WEIGHT, MOST_FINE = 0.1, 0.03
"""The level for white noise, which rests on one-rings too, over that of the fit over two rings, by
the number of averages; and how much it counts, by error and
at most.  Measured on noise of 0.2 on 12 shapes."""

WHITE_FINE = 0.88
"""Ratio of the same above which neighbours share nothing."""

LEAST_RISE = 1.2
"""How much more of shared noise a fit over four rings leaves than one over two, at least."""

PER_RING = 0.02
"""By how much a ring more has to explain the levels better: in doubt the fewer, for what the
surface leaves looks like more rings."""

DOUBT = 0.006
"""Difference of misfits at which another number of rings counts for a third in the level."""

SHARP = np.array([0.0, 0.58, 0.68, 0.705, 0.38])
"""Ratios of standard deviations at ``FLOOR`` and ``FLAT`` that noise shows, shared or not, by fit;
texture and shape show less in one of them."""


LOUD = 0.12
SHARP_LOUD = np.array([0.0, 0.58, 0.68, 0.665, 0.38])
"""The same for levels from so many mean edges on, which fine texture seldom has."""

PATTERN = np.array([1.0, 1.0, 1.0, 0.92, 0.945])
"""Sharpness that shared noise does not reach, and shape that repeats does."""

RELIEF_SHARP, RELIEF_GROWTH = 0.8, 1.22
"""Sharpness of fits over six rings, and what they leave over those over four, compared with noise,
from which a relief is everywhere."""

SMOOTH_GROWTH = 0.97
"""What degree 3 over three rings leaves over degree 2 over two, below which it is smooth relief:
shared noise leaves 1 to 1.16 times as much."""


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
    is_floor : whether what wide fits leave over is the same everywhere, as only noise is.
    is_relief : whether a smooth relief that is the same everywhere would leave that, too.
    by_scale : (5,) standard deviation that each fit leaves over, mean edges, taken for white.
    """

    rings: int
    level: float
    misfit: float
    margin: float
    sharpness: Floats
    is_floor: bool
    is_relief: bool
    by_scale: Floats


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
    above = ABOVE[None, :, None] * np.minimum(squares, MOST_ABOVE)
    costs = np.where(errors > 0.0, above, squares)
    totals = (weights[None, :, None] * costs).sum(axis=1) / weights.sum()
    misfits = 0.5 * np.sqrt(totals.min(axis=1))
    by_scale = np.sqrt(flats / chi_square_quantile(FREEDOMS[0], FLAT))
    if fine is not None and has[TWO]:
        ratio = max(fine / float(by_scale[TWO]), 0.1)
        totals += np.minimum(FINE_WEIGHT * np.log(ratio / FINE) ** 2, MOST_FINE)[:, None]
        if ratio > WHITE_FINE:
            totals[1:] += 1.0
    if not (has[TWO] and has[FOUR] and by_scale[FOUR] > LEAST_RISE * by_scale[TWO]):
        totals[1:] += 1.0
    best = totals.argmin(axis=1)
    least = 0.5 * np.sqrt(totals[np.arange(len(best)), best])
    chosen = least + PER_RING * np.arange(len(best))
    rings = int(chosen.argmin())
    others = np.delete(chosen, rings)
    likely = np.exp((chosen[rings] - chosen) / DOUBT)
    logarithm = 0.5 * float(likely @ tried[np.arange(len(best)), best] / likely.sum())
    level = math.exp(logarithm)
    return Colour(
        rings=rings,
        level=level,
        misfit=float(misfits[rings]),
        margin=float(others.min() - chosen[rings]),
        sharpness=sharpness,
        is_floor=_is_floor(sharpness, rings, level),
        is_relief=rings > 0 and _is_relief(by_scale, sharpness, rings),
        by_scale=by_scale,
    )


def _is_relief(by_scale: Floats, sharpness: Floats, rings: int) -> bool:
    """Whether fits leave more than noise that is shared over so many rings would.

    Creases add to wide fits too, but not everywhere.
    """
    expected = math.sqrt(LEFT[rings, SIX] / LEFT[rings, FOUR])
    growth = float(by_scale[SIX] / by_scale[FOUR]) / expected
    is_wide = sharpness[SIX] > RELIEF_SHARP and growth > RELIEF_GROWTH
    return bool(is_wide or by_scale[THREE] < SMOOTH_GROWTH * by_scale[TWO])


def _is_floor(sharpness: Floats, rings: int, level: float) -> bool:
    """Whether what wide fits leave over is as even as noise, and not as a pattern."""
    is_pattern = rings > 0 and bool((sharpness > PATTERN).any())
    return bool((sharpness >= (SHARP_LOUD if level > LOUD else SHARP)).all()) and not is_pattern
