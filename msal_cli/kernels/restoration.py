"""The part of what smoothing removed from a surface that exceeds the noise.

The residual t of a filter, the displacement of each vertex along its normal, is the negative of the
removed noise, plus lost shape.  White noise has the same power everywhere, and known shares of it
in bands of scale; lost shape is smooth and local.  So the residual is split into bands from fine to
coarse, and of each band each vertex gets a share back by how far the local power exceeds that of
noise: a Wiener filter with local powers.  The power of lost shape is that of a first guess, made
likewise.
"""

import itertools

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.library import compiled
from msal_cli.kernels.parallel import over_ranges

NOISE_SHARES = (
    0.8571428571428571,
    0.0349854227405248,
    0.0049469183758468,
    0.0016309322732910,
    0.0381402584408378,
)
"""Variance of unit white noise in each band; the last one has all coarser scales.

On the lattice of valence 6, with s the weights, 1/7 each, of the mean over a vertex and its ring,
it is the sum of squares of s^b - s^(b + 1), as convolutions; of s^4 for the last band.
"""

PLACE, SECOND_PLACE = 6, 3
"""Passes that average powers over one-rings, for the first guess and for the second."""

CAUTION, SECOND_CAUTION = 1.4, 0.4
"""Factors of the power of noise in the gains, chosen on noisy meshes with known true shape.  The
first guess has to separate shape from the scatter of averaged noise."""


@compiled
def _mean(start, stop, ring_start, ring, values, low):
    """The next coarser level: the mean over each vertex and its one-ring."""
    for i in range(start, stop):
        total = values[i]
        for at in range(ring_start[i], ring_start[i + 1]):
            total += values[np.uint64(ring[at])]
        low[i] = total / (ring_start[i + 1] - ring_start[i] + 1)


@compiled
def _load_five(powers, i):
    """The powers of a vertex; named numbers stay in registers."""
    return powers[i, 0], powers[i, 1], powers[i, 2], powers[i, 3], powers[i, 4]


@compiled
def _average(start, stop, ring_start, ring, powers, averages):
    """Means over closed one-rings of the five powers of each vertex, which are contiguous."""
    for i in range(start, stop):
        a, b, c, d, e = _load_five(powers, np.uint64(i))
        for at in range(ring_start[i], ring_start[i + 1]):
            p, q, r, s, t = _load_five(powers, np.uint64(ring[at]))
            a, b, c, d, e = a + p, b + q, c + r, d + s, e + t
        share = 1.0 / (ring_start[i + 1] - ring_start[i] + 1)
        averages[i, 0], averages[i, 1], averages[i, 2] = a * share, b * share, c * share
        averages[i, 3], averages[i, 4] = d * share, e * share


@compiled
def _first_look(start, stop, bands, powers, noise, guess):
    for i in range(start, stop):
        total = 0.0
        for band in range(len(noise)):
            around = powers[i, band]
            if around > noise[band]:
                total += (1.0 - noise[band] / around) * bands[band, i]
        guess[i] = total


@compiled
def _second_look(start, stop, residual, bands, powers, noise, returned, share):
    for i in range(start, stop):
        total = given = power = 0.0
        for band in range(len(noise)):
            value = bands[band, i]
            around = powers[i, band]
            gain = around / (around + noise[band]) if around > 0.0 else 0.0
            power += value * value
            given += gain * value * value
            total += gain * value
        # A vertex that did not move has nothing to restore, though its neighbours may have.
        returned[i] = total if residual[i] != 0.0 else 0.0
        share[i] = given / power if power > 0.0 else 0.0


def restoration(
    residual: Floats, ring_start: Ints, ring: Ints, noise: float, caution: float = 1.0
) -> tuple[Floats, Floats]:
    """The part of ``residual`` (n,) that exceeds the noise.

    With S the mean over a vertex and its one-ring, bands are S^b t - S^(b + 1) t, and S^4 t.  With
    P = S^6 of a band's squares, c its ``NOISE_SHARES`` and s the noise, the first guess is

        max(0, 1 - 1.4 caution c s^2 / P) of the band,

    whose sum r over the bands is close to the lost shape and has its power.  With Q = S^3 of the
    squares of that band of r, the result is

        Q / (Q + 0.4 caution c s^2) of the band of t.

    Parameters
    ----------
    ring_start, ring : the one-rings.
    noise : standard deviation of the noise, in the unit of the residual.
    caution : greater restores less.

    Returns
    -------
    returned : (n,), to be subtracted, in the unit of the residual; 0 where the residual is 0.
    share : (n,) from 0 to 1, its share of the residual's power at each vertex.
    """
    n, bands = len(residual), len(NOISE_SHARES)
    levels = np.empty((bands, n))
    powers, averages = np.empty((n, bands)), np.empty((n, bands))

    def average(passes: int) -> None:
        nonlocal powers, averages
        for _ in range(passes):
            over_ranges(_average, n, ring_start, ring, powers, averages)
            powers, averages = averages, powers

    def alone(caution: float) -> Floats:
        return caution * noise * noise * np.array(NOISE_SHARES)

    def cut(levels: Floats) -> None:
        """Compute bands (5, n) from the finest of the levels, and their powers."""
        for finer, coarser in itertools.pairwise(levels):
            over_ranges(_mean, n, ring_start, ring, finer, coarser)
        for finer, coarser in itertools.pairwise(levels):
            finer -= coarser
        np.square(levels.T, out=powers)

    levels[0] = residual
    cut(levels)
    average(PLACE)
    # The averages are not needed until the next pass, so the levels of the guess use their memory.
    guess = averages.reshape(bands, n)
    over_ranges(_first_look, n, levels, powers, alone(CAUTION * caution), guess[0])
    cut(guess)
    average(SECOND_PLACE)
    returned, share = np.empty(n), np.empty(n)
    results = returned, share
    noises = alone(SECOND_CAUTION * caution)
    over_ranges(_second_look, n, residual, levels, powers, noises, *results)
    return results
