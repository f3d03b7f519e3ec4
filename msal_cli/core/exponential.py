"""The exponential of many numbers at once, by arithmetic that compilers turn into vectors.

The library's exponential is called once per number; written as loops over a block that stays in
the first-level cache it takes a third of the time, and gives the same bits on every machine.
"""

from __future__ import annotations

import numpy as np

from msal_cli.core.compiled import compiled

_PER_LN2 = 1.4426950408889634  # 1 / ln 2
# ln 2 in two parts (Cody and Waite): the first has few enough bits for exact products.
_LN2_HIGH = 6.93145751953125e-1
_LN2_LOW = 1.42860682030941723212e-6
# Added to a number it leaves the nearest integer in the lowest bits of the sum.
_ROUND = 6755399441055744.0  # 1.5 * 2^52

SMALLEST_ARGUMENT = -700.0
"""Arguments below are taken as this: exp(-700) is 1e-304, nothing beside a weight of 1."""


@compiled
def exponentials(values, scratch, scratch_bits, count):  # type: ignore[no-untyped-def]
    """Replace ``values[:count]``, none above zero, by their exponentials, within 1 ulp or so.

    ``scratch`` (>= count,) float64 and ``scratch_bits``, the same memory as int64, are overwritten.
    """
    bits = values.view(np.int64)
    for at in range(count):
        value = values[at] if values[at] > SMALLEST_ARGUMENT else SMALLEST_ARGUMENT
        values[at] = value
        scratch[at] = value * _PER_LN2 + _ROUND
    for at in range(count):
        power = scratch[at] - _ROUND
        r = (values[at] - power * _LN2_HIGH) - power * _LN2_LOW
        # Taylor series to r^12; |r| <= ln 2 / 2, so that the rest is below 2^-57.
        p = 1.0 / 479001600.0
        p = p * r + 1.0 / 39916800.0
        p = p * r + 1.0 / 3628800.0
        p = p * r + 1.0 / 362880.0
        p = p * r + 1.0 / 40320.0
        p = p * r + 1.0 / 5040.0
        p = p * r + 1.0 / 720.0
        p = p * r + 1.0 / 120.0
        p = p * r + 1.0 / 24.0
        p = p * r + 1.0 / 6.0
        p = p * r + 0.5
        p = p * r + 1.0
        values[at] = p * r + 1.0
    for at in range(count):
        bits[at] += scratch_bits[at] << 52
