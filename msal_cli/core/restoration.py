"""What smoothing has taken from a surface, and which part of it is more than noise.

The residual t of a filter, how far it moved each vertex along its normal, is the noise that it
removed, turned round, and the shape that it lost.  Noise is as strong everywhere and at every
scale as white noise is; lost shape is strong in places, and smooth.  So the residual is cut into
bands, from fine to coarse, and of each band every vertex gets back a share by how far its power
around there is beyond what noise alone would give: a Wiener filter, with the powers of the place.
The powers of the lost shape are those of a first guess, which is made in the same way.
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

PLACE, SECOND_PLACE = 6, 3
"""Passes by which a power is averaged around a vertex, for the first look and for the second."""

CAUTION, SECOND_CAUTION = 1.4, 0.4
"""Multiples of the noise's power that gains are reckoned with; chosen on noisy meshes whose true
shape is known.  The first look has to tell shape from the scatter of averaged noise."""


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
def _first_look(start, stop, levels, powers, noise, guess):  # type: ignore[no-untyped-def]
    bands = len(noise)
    for i in range(start, stop):
        total = 0.0
        for band in range(bands):
            value = levels[band, i]
            if band + 1 < bands:
                value -= levels[band + 1, i]
            around = powers[i, band]
            if around > noise[band]:
                total += (1.0 - noise[band] / around) * value
        guess[i] = total


@compiled
def _second_look(start, stop, levels, powers, noise, returned, share):  # type: ignore[no-untyped-def]
    bands = len(noise)
    for i in range(start, stop):
        total = given = power = 0.0
        for band in range(bands):
            value = levels[band, i]
            if band + 1 < bands:
                value -= levels[band + 1, i]
            around = powers[i, band]
            gain = around / (around + noise[band]) if around > 0.0 else 0.0
            power += value * value
            given += gain * value * value
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
    share : (n,) from 0 to 1, the share of the residual's power at each vertex that this is.
    """

    returned: Floats
    share: Floats


def restoration(
    residual: Floats, ring_start: Ints, ring: Ints, noise: float, caution: float = 1.0
) -> Restoration:
    """The part of ``residual`` (n,) that is more than noise.

    With S the mean over a vertex and its one-ring, bands are S^b t - S^(b + 1) t, and S^4 t.  With
    P = S^6 of a band's squares, c its ``NOISE_SHARES`` and s the noise, the first look takes

        max(0, 1 - 1.4 caution c s^2 / P) of the band,

    and the sum r over the bands is near the shape that was lost.  The second look knows its power:
    with Q = S^3 of the squares of that band of r, it takes

        Q / (Q + 0.4 caution c s^2) of the band of t.

    Parameters
    ----------
    ring_start, ring : the one-rings.
    noise : standard deviation of the noise, in the unit of the residual.
    caution : greater gives back less.
    """
    n, bands = len(residual), len(NOISE_SHARES)
    levels = np.empty((bands, n))
    powers, averages = np.empty((n, bands)), np.empty((n, bands))

    def averaged(passes: int) -> None:
        nonlocal powers, averages
        for _ in range(passes):
            over_ranges(_averaged, n, ring_start, ring, powers, averages)
            powers, averages = averages, powers

    def alone(caution: float) -> Floats:
        return caution * noise * noise * np.array(NOISE_SHARES)

    def cut(values: Floats, lower: list[Floats]) -> None:
        for band, low in enumerate(lower):
            over_ranges(_band, n, ring_start, ring, values, low, powers, band)
            values = low
        over_ranges(_rest, n, values, powers, bands - 1)

    levels[0] = residual
    cut(levels[0], list(levels[1:]))
    averaged(PLACE)
    guess, share = np.empty(n), np.empty(n)
    over_ranges(_first_look, n, levels, powers, alone(CAUTION * caution), guess)
    # Of the guess only powers are asked for: two arrays for its levels are enough.
    spare = np.empty(n)
    cut(guess, [(share, spare)[band % 2] for band in range(bands - 1)])
    averaged(SECOND_PLACE)
    returned = guess
    over_ranges(_second_look, n, levels, powers, alone(SECOND_CAUTION * caution), returned, share)
    return Restoration(returned, share)
