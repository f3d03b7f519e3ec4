"""What smoothing has taken from a surface, and which part of it is more than noise.

The residual t of a filter, how far it moved each vertex along its normal, is the noise that it
removed, turned round, and the shape that it lost.  Noise is as strong everywhere and at every
scale as white noise is; lost shape is strong in places, and smooth.  So the residual is cut into
bands, from fine to coarse, and of each band every vertex gets back the share that its power around
there has beyond what noise alone would give (a Wiener filter, with the powers of the place).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.parallel import over_ranges
from msal_cli.dataclass import dataclass

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

NOISE_SHARES = (
    0.8571428571428571,
    0.0349854227405248,
    0.0049469183758468,
    0.0016309322732910,
    0.0381402584408378,
)
"""Variance of unit white noise in each band, the last with all that is coarser.

On the lattice of valence 6: with s the weights, 1/7 each, of the mean over a vertex and its ring,
it is the sum of squares of s^b - s^(b + 1), as convolutions; of s^4 for the last band.
"""

PLACE = 6
"""Passes by which a power is averaged around a vertex: about five rings."""


@compiled
def _band(start, stop, ring_start, ring, values, low, powers, band):  # type: ignore[no-untyped-def]
    """The next coarser values, and the squares of what is between, into column ``band``."""
    for i in range(start, stop):
        total = values[i]
        for at in range(ring_start[i], ring_start[i + 1]):
            total += values[ring[at]]
        low[i] = total / (ring_start[i + 1] - ring_start[i] + 1)
        powers[i, band] = (values[i] - low[i]) ** 2


@compiled
def _rest(start, stop, values, powers, band):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        powers[i, band] = values[i] ** 2


@compiled
def _averaged(start, stop, ring_start, ring, powers, averages):  # type: ignore[no-untyped-def]
    bands = powers.shape[1]
    for i in range(start, stop):
        for band in range(bands):
            averages[i, band] = powers[i, band]
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            for band in range(bands):
                averages[i, band] += powers[k, band]
        weight = 1.0 / (ring_start[i + 1] - ring_start[i] + 1)
        for band in range(bands):
            averages[i, band] *= weight


@compiled
def _given_back(start, stop, levels, powers, noise, returned, share):  # type: ignore[no-untyped-def]
    bands = len(noise)
    for i in range(start, stop):
        total = given = power = 0.0
        for band in range(bands):
            value = levels[band, i]
            if band + 1 < bands:
                value -= levels[band + 1, i]
            around = powers[i, band]
            power += around
            if around > noise[band]:
                gain = 1.0 - noise[band] / around
                given += gain * around
                total += gain * value
        # What did not move has nothing to get back, though its neighbours may have.
        returned[i] = total if levels[0, i] != 0.0 else 0.0
        share[i] = given / power if power > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class Restoration:
    """What a residual holds beside noise.

    Attributes
    ----------
    returned : (n,) the part of the residual that is to be taken back, its unit; 0 where it is 0.
    share : (n,) from 0 to 1, the share of the residual's power around each vertex that this is.
    """

    returned: Floats
    share: Floats


def restoration(
    residual: Floats, ring_start: Ints, ring: Ints, noise: float, caution: float
) -> Restoration:
    """The part of ``residual`` (n,) that is more than noise.

    With S the mean over a vertex and its one-ring, bands are S^b t - S^(b + 1) t, and S^4 t.  With
    P the sixth such mean of a band's squares and c its ``NOISE_SHARES``, a vertex gets back

        max(0, 1 - caution c noise^2 / P) of the band.

    Parameters
    ----------
    ring_start, ring : the one-rings.
    noise : standard deviation of the noise, in the unit of the residual.
    caution : greater gives back less.
    """
    n, bands = len(residual), len(NOISE_SHARES)
    levels = np.empty((bands, n))
    levels[0] = residual
    powers, averages = np.empty((n, bands)), np.empty((n, bands))
    for band in range(bands - 1):
        over_ranges(_band, n, ring_start, ring, levels[band], levels[band + 1], powers, band)
    over_ranges(_rest, n, levels[-1], powers, bands - 1)
    for _ in range(PLACE):
        over_ranges(_averaged, n, ring_start, ring, powers, averages)
        powers, averages = averages, powers
    del averages
    alone = caution * noise * noise * np.array(NOISE_SHARES)
    returned, share = np.empty(n), np.empty(n)
    over_ranges(_given_back, n, levels, powers, alone, returned, share)
    return Restoration(returned, share)
