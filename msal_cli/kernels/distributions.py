"""Quantiles of distributions that fits are judged by, as close as judging needs."""

from __future__ import annotations

import functools

import numpy as np

from msal_cli.arrays import Floats

MOST_FREEDOMS = 40

_NORMAL = {0.2: -0.8416212, 0.5: 0.0}
_FEW_FREEDOMS = {
    0.2: (0.0641848, 0.4462871, 1.0051740, 1.6487766),
    0.5: (0.4549364, 1.3862944, 2.3659739, 3.3566940),
}
"""Quantiles of the normal distribution, and of chi square with 1 to 4 degrees of freedom."""


@functools.cache
def chi_square(share: float) -> Floats:
    """Quantiles of chi square over its degrees of freedom, by those, from 0 (which has none) to
    ``MOST_FREEDOMS``; ``share`` is 0.2 or 0.5.  Right within 0.6 %."""
    freedoms = np.arange(1.0, MOST_FREEDOMS + 1.0)
    # Wilson and Hilferty 1931, which does for five and more.
    scale = 2.0 / (9.0 * freedoms)
    ratios = (1.0 - scale + _NORMAL[share] * np.sqrt(scale)) ** 3
    ratios[:4] = np.array(_FEW_FREEDOMS[share]) / freedoms[:4]
    return np.concatenate([[np.nan], ratios])


def student(freedoms: Floats) -> Floats:
    """The ratio that Student's distribution exceeds, up or down, in one of 100 cases, for five
    degrees of freedom at least.  Right within 1 %."""
    # Abramowitz and Stegun 26.7.5, with the normal quantile of 0.995.
    z = 2.5758293
    first = (z**3 + z) / 4.0
    second = (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0
    third = (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0
    bounds: Floats = z + first / freedoms + second / freedoms**2 + third / freedoms**3
    return bounds
