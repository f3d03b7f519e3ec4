"""Sums of numbers that are exact, and so depend neither on their order nor on how they are split.

A float64 is a whole number of 53 bits times a power of two.  For each power the whole numbers are
added as integers, in two halves so that 2^36 of them cannot overflow.  The sum of these is one
Python integer, and a mean is rounded once, at the end: it is the float64 nearest to the true one.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.kernels.compiled import compiled

POWERS = 2048
"""Powers of two that a float64 may have, by the bits of its exponent."""

BINS = 2 * POWERS
"""Integers of a sum: those of the upper halves, then those of the lower halves."""

_LOW_BITS = 26
_LEAST_POWER = -1075
"""The exponent of the whole numbers of power 0, where that of power 1 is one more."""


@compiled
def add_exactly(bits, count, bins):
    """Add the first ``count`` of numbers that are finite and not below zero to ``bins`` (BINS,).

    ``bits`` are the numbers seen as int64.
    """
    for at in range(count):
        power = np.uint64(bits[at]) >> np.uint64(52)
        whole = np.uint64(bits[at]) & np.uint64(0xFFFFFFFFFFFFF)
        # A number of power 0 has no hidden bit, and the exponent of power 1.
        whole = (whole | np.uint64(0x10000000000000)) if power else whole << np.uint64(1)
        bins[power] += np.int64(whole >> np.uint64(26))
        bins[power + np.uint64(2048)] += np.int64(whole & np.uint64(0x3FFFFFF))


def total_of(bins: Longs) -> int:
    """The sum that ``bins`` (..., BINS) hold, in units of 2^-1075."""
    total = 0
    sums = bins.reshape(-1, BINS).astype(object).sum(axis=0) if bins.ndim > 1 else bins
    for at in np.flatnonzero(sums):
        power, is_low = int(at) % POWERS, int(at) >= POWERS
        total += int(sums[at]) << (power + (0 if is_low else _LOW_BITS))
    return total


def mean_partial(bins: Longs, count: int) -> dict[str, Any]:
    """The part of a mean that ``bins`` (..., BINS) and their ``count`` of numbers are, for JSON.

    ``{"kind": "mean", "sum": whole number, "power": of two, "count": ...}``.
    """
    total = total_of(bins)
    spare = (total & -total).bit_length() - 1 if total else 0
    return {"kind": "mean", "sum": total >> spare, "power": spare, "count": count}


def combine_means(partials: Iterable[dict[str, Any]]) -> float:
    """The mean of the numbers of all parts, the nearest float64; 0.0 where there are none."""
    total = count = 0
    for one in partials:
        total += one["sum"] << one["power"]
        count += one["count"]
    # Python rounds a quotient of integers once, however large they are.
    return total / (count << -_LEAST_POWER) if count else 0.0
