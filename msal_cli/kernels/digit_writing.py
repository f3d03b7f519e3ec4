"""Doubles to decimal digits, exactly: fixed-point text and the shortest text that reads back.

A number is written with all digits of its product with a power of ten, whose rounding error is
known (Dekker 1971).
"""

from __future__ import annotations

import math

import numpy as np

from msal_cli.kernels.byte_words import format_digits, store_eight
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.digits import EXACT, FLOAT_POWERS, POWERS, scale_exactly, times_power

MOST_DECIMALS = 17
"""Decimals beyond which fixed-point text is not used."""

SHORTEST, SHORTEST_SINGLE = 18, 19
"""In place of a number of decimals: the shortest text that is read back as the same float64, or
float32."""

FIXED_BELOW = 2.0**63
"""Magnitude from which on fixed-point text is not used."""

WIDEST_SHORTEST = 26
"""Bytes that hold every ``repr`` of a float: ``-1.2345678901234567e-308`` has 24."""


@compiled
def _write_eight(number, count, out, at):  # type: ignore[no-untyped-def]
    """``_write_digits`` for up to eight digits."""
    store_eight(out, at, format_digits(number * POWERS[8 - count]))
    return at + count


@compiled
def _write_digits(number, count, out, at):  # type: ignore[no-untyped-def]
    """Write an int64 with exactly ``count`` digits (up to 24); returns the end.

    Up to seven bytes behind the end may be written over.
    """
    if count > 16:
        at = _write_eight(number // 10**16, count - 16, out, at)
        number %= 10**16
        count = np.int64(16)
    if count > 8:
        at = _write_eight(number // 10**8, count - 8, out, at)
        number %= 10**8
        count = np.int64(8)
    return _write_eight(number, count, out, at)


@compiled
def _n_digits(number):  # type: ignore[no-untyped-def]
    """Decimal digits of an int64 from zero up, one for zero."""
    n = 1
    while n < 19 and number >= POWERS[n]:
        n += 1
    return n


@compiled
def _scaled_fraction(fraction, decimals, is_odd):  # type: ignore[no-untyped-def]
    """The whole number nearest to fraction * 10**decimals, a half to the even one.

    0 <= fraction < 1; ``is_odd`` is 1 where an even result would make the number odd.
    """
    power = FLOAT_POWERS[decimals]
    scaled = fraction * power
    number = np.int64(scaled)
    beyond = scaled - np.float64(number) - 0.5
    if abs(beyond) > scaled * 2.0**-52:
        return number + (beyond > 0.0)
    # The product's own rounding may hide on which side of the half it lies: what it left away,
    # after Dekker (1971), is exact.
    spread = 134217729.0 * fraction
    fraction_high = spread - (spread - fraction)
    fraction_low = fraction - fraction_high
    spread = 134217729.0 * power
    power_high = spread - (spread - power)
    power_low = power - power_high
    error = (fraction_high * power_high - scaled) + fraction_high * power_low
    beyond += (error + fraction_low * power_high) + fraction_low * power_low
    number += np.int64(math.ceil(beyond))
    if beyond == math.ceil(beyond) and (number + is_odd) & 1:
        number += 1
    return number


@compiled
def _parts(value):  # type: ignore[no-untyped-def]
    """Integer mantissa (uint64) and exponent e of a finite |value| = mantissa * 2**e."""
    bits = np.float64(value).view(np.uint64)
    biased = np.int64((bits >> np.uint64(52)) & np.uint64(0x7FF))
    mantissa = bits & np.uint64((1 << 52) - 1)
    if biased == 0:
        return mantissa, -1074
    return mantissa | np.uint64(1 << 52), biased - 1075


@compiled
def write_fixed(value, decimals, out, at):  # type: ignore[no-untyped-def]
    """Write ``value`` with ``decimals`` (at most 17) digits behind the point; returns the end.

    Correctly rounded from the double, ties to the even digit; a result of zero has no sign.
    Up to seven bytes behind the end may be written over.  Returns -1, with nothing written, for
    magnitudes of 2**63 and more and for NaN.
    """
    size = abs(value)
    if not size < FIXED_BELOW:
        return -1
    whole = np.int64(size)
    is_odd = whole & 1 if decimals == 0 else np.int64(0)
    number = _scaled_fraction(size - np.float64(whole), decimals, is_odd)
    if number >= POWERS[decimals]:
        whole += 1
        number -= POWERS[decimals]
    out[np.uint64(at)] = 45
    at += np.int64((value < 0.0) & (whole + number > 0))
    # The usual sizes apart, because the compiler puts short code in place of a call.
    if whole < 10:
        out[np.uint64(at)] = np.uint8(48 + whole)
        at += 1
    else:
        at = _write_digits(whole, _n_digits(whole), out, at)
    if decimals > 0:
        out[np.uint64(at)] = 46
        if decimals <= 8:
            return _write_eight(number, decimals, out, at + 1)
        at = _write_digits(number, decimals, out, at + 1)
    return at


@compiled
def _rounded_to(value, n_digits, exponent):  # type: ignore[no-untyped-def]
    """Nearest integer (up to a tie) to value * 10**(n_digits - 1 - exponent), value > 0."""
    mantissa, power = _parts(value)
    high, _, shift = times_power(mantissa, n_digits - 1 - exponent)
    # The result has 17 digits at most, so that it lies in the upper word.
    right = np.uint64(-(shift + power) - 64 - 1)
    doubled = high >> right
    return (doubled + np.uint64(1)) >> np.uint64(1)


@compiled
def _reads_back(mantissa, exponent, value, single):  # type: ignore[no-untyped-def]
    """Whether mantissa * 10**exponent is read as ``value``: 1, 0, or -1 where it is unsure."""
    back, status = scale_exactly(mantissa, exponent)
    if status != EXACT:
        return -1
    if not single:
        return 1 if back == value else 0
    # In the middle of two float32, or beside it, readers differ: one digit more is clear.
    below = np.float64(np.float32(back * (1.0 - 2.0**-52)))
    above = np.float64(np.float32(back * (1.0 + 2.0**-52)))
    return 1 if below == value and above == value else 0


@compiled
def write_shortest(value, single, out, at):  # type: ignore[no-untyped-def]
    """Write the shortest decimal that is read back as ``value``; returns the end.

    15 digits (float32: 6) that read back are, without their last zeros, the shortest there is,
    because every decimal of so few digits survives the way through the type.  Returns -1, with
    nothing written, where ``repr`` must decide.
    """
    if value == 0.0:
        out[at] = 45
        at += np.int64(np.float64(value).view(np.uint64) != np.uint64(0))
        out[at] = 48
        return at + 1
    size = abs(value)
    # float32 numbers below 1.2e-38 have fewer digits than the rest.
    if not 1e-60 < size < 1e60 or (single and size < 1.2e-38):
        return -1
    # Low rather than high where the logarithm is unsure: too low shows, as one digit too many.
    lowest = math.floor(math.log10(size) - 1e-12)
    is_power_of_two = _parts(size)[0] == np.uint64(1 << 52)
    exponent = lowest
    mantissa = np.uint64(0)
    n_digits = 6 if single else 15
    most = 9 if single else 17
    reads = 0
    while n_digits <= most and reads == 0:
        exponent = lowest
        mantissa = _rounded_to(size, n_digits, exponent)
        if np.int64(mantissa) >= POWERS[n_digits]:
            exponent += 1
            mantissa = _rounded_to(size, n_digits, exponent)
        reads = _reads_back(mantissa, exponent - n_digits + 1, size, single)
        if reads == 0 and is_power_of_two:
            # The doubles above are twice as far apart as those below: the farther side may do.
            mantissa += np.uint64(1)
            reads = _reads_back(mantissa, exponent - n_digits + 1, size, single)
        n_digits += 1
    if reads != 1:
        return -1
    digits = np.int64(mantissa)
    n_digits = _n_digits(digits)
    while digits % 10 == 0:
        digits //= 10
        n_digits -= 1
    out[at] = 45
    at += np.int64(value < 0.0)
    has_exponent = not -4 <= exponent < 16
    n_before = 1 if has_exponent else max(exponent + 1, 0)
    n_behind = max(n_digits - n_before, 0)
    digits *= POWERS[n_before + n_behind - n_digits]
    whole = digits // POWERS[n_behind]
    at = _write_digits(whole, max(n_before, 1), out, at)
    if n_behind > 0:
        out[at] = 46
        digits -= whole * POWERS[n_behind]
        n_zeros = 0 if has_exponent else max(-exponent - 1, 0)
        at = _write_digits(digits, n_zeros + n_behind, out, at + 1)
    if has_exponent:
        out[at] = 101
        out[at + 1] = 45 if exponent < 0 else 43
        at = _write_digits(np.int64(abs(exponent)), 2, out, at + 2)
    return at


@compiled
def write_number(value, decimals, out, at):  # type: ignore[no-untyped-def]
    """Write ``value`` with that many decimals, SHORTEST or SHORTEST_SINGLE; returns the end.

    -1, with nothing written, where Python must do it.  Seven bytes behind the end may be changed.
    """
    if decimals == SHORTEST or decimals == SHORTEST_SINGLE:
        return write_shortest(value, decimals == SHORTEST_SINGLE, out, at)
    return write_fixed(value, decimals, out, at)
