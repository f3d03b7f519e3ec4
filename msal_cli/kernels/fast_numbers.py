"""Plain decimal numbers, eight digits at a time: the ones that nearly all text meshes consist of.

*Plain* is a sign or none, digits with a point or without, no exponent, and digits that make a
whole number up to 2**53, so that one division rounds correctly (Clinger 1990).  What is not plain
is left to ``digits``, which reads and prints everything and takes longer, also to compile.

Eight bytes are taken as one 64-bit word, the first byte lowest; unsigned places spare the test for
negative ones, and the eight loads or stores become one.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled

MOST_SCALED = 2.0**52
"""``put_plain`` prints numbers that are smaller than this after a shift by their decimals."""

MOST_DECIMALS = 16
"""Decimals that ``put_plain`` can print."""

_TENS = np.array([10**n for n in range(17)], dtype=np.int64)
_FLOAT_TENS = np.array([float(10**n) for n in range(23)])

# As constants, not as calls in a kernel: each call takes numba a millisecond.
_ONE, _TWO, _THREE, _FOUR, _FIVE, _SIX, _SEVEN = (np.uint64(count) for count in range(1, 8))
_BITS_8, _BITS_16, _BITS_24, _BITS_32, _BITS_40, _BITS_48, _BITS_56 = (
    np.uint64(8 * count) for count in range(1, 8)
)


@compiled
def eight(buf, at):  # type: ignore[no-untyped-def]
    """The eight bytes at ``at`` as a word; zeros stand for those beyond the end."""
    u = np.uint64(at)
    if at + 8 <= len(buf):
        return (
            np.uint64(buf[u])
            | np.uint64(buf[u + _ONE]) << _BITS_8
            | np.uint64(buf[u + _TWO]) << _BITS_16
            | np.uint64(buf[u + _THREE]) << _BITS_24
            | np.uint64(buf[u + _FOUR]) << _BITS_32
            | np.uint64(buf[u + _FIVE]) << _BITS_40
            | np.uint64(buf[u + _SIX]) << _BITS_48
            | np.uint64(buf[u + _SEVEN]) << _BITS_56
        )
    word = np.uint64(0)
    for k in range(at, len(buf)):
        word |= np.uint64(buf[k]) << np.uint64(8 * (k - at))
    return word


@compiled
def put_eight(out, at, word):  # type: ignore[no-untyped-def]
    """Write a word to the eight bytes at ``at``, which must be there."""
    u = np.uint64(at)
    out[u] = np.uint8(word)
    out[u + _ONE] = np.uint8(word >> _BITS_8)
    out[u + _TWO] = np.uint8(word >> _BITS_16)
    out[u + _THREE] = np.uint8(word >> _BITS_24)
    out[u + _FOUR] = np.uint8(word >> _BITS_32)
    out[u + _FIVE] = np.uint8(word >> _BITS_40)
    out[u + _SIX] = np.uint8(word >> _BITS_48)
    out[u + _SEVEN] = np.uint8(word >> _BITS_56)


@compiled
def n_before(found):  # type: ignore[no-untyped-def]
    """How many bytes lie before the first marked one; ``found`` has the top bits of marked bytes.

    Eight where none is marked.
    """
    # The lowest bit set, less one: all bits below it, of which each byte's lowest is counted.
    below = (found - np.uint64(1)) & ~found
    ones = np.uint64(0x0101010101010101)
    # The marked byte itself has its seven lower bits below.
    return np.int64((((below >> np.uint64(7)) & ones) * ones) >> np.uint64(56))


@compiled
def n_digits(word):  # type: ignore[no-untyped-def]
    """How many of the eight bytes are digits before the first that is none."""
    high = np.uint64(0x8080808080808080)
    # A carry from byte to byte comes from one that is no digit, and so harms only later ones.
    over = word + np.uint64(0x4646464646464646)
    under = word - np.uint64(0x3030303030303030)
    return n_before((over | under) & high)


@compiled
def whole_number(word, count):  # type: ignore[no-untyped-def]
    """The number that the first ``count`` (1 to 8) bytes, all of them digits, stand for."""
    # The first digit is the lowest byte; zeros are put before it.
    word = (word - np.uint64(0x3030303030303030)) << np.uint64(64 - 8 * count)
    word = word * np.uint64(10) + (word >> np.uint64(8))
    pairs = np.uint64(0x000000FF000000FF)
    first = (word & pairs) * np.uint64(0x000F424000000064)
    second = ((word >> np.uint64(16)) & pairs) * np.uint64(0x0000271000000001)
    return np.int64((first + second) >> np.uint64(32))


@compiled
def read_plain(buf, at):  # type: ignore[no-untyped-def]
    """The plain number at ``at``: value, end, decimals; the end is -1 where there is none.

    What stands behind it is for the caller to judge.
    """
    negative = at < len(buf) and buf[np.uint64(at)] == 45
    at += negative
    first = at
    mantissa = np.int64(0)
    # One by one, because there are few: the processor guesses how many, and goes on meanwhile.
    while at < len(buf) and at - first <= 9:
        digit = np.int64(buf[np.uint64(at)]) - 48
        if digit < 0 or digit > 9:
            break
        mantissa = mantissa * 10 + digit
        at += 1
    n = at - first
    decimals = np.int64(0)
    is_more = n > 9
    if at < len(buf) and buf[np.uint64(at)] == 46:
        at += 1
        word = eight(buf, at)
        decimals = n_digits(word)
        if decimals > 0:
            mantissa = mantissa * _TENS[decimals] + whole_number(word, decimals)
        if decimals == 8:
            word = eight(buf, at + 8)
            count = n_digits(word)
            if count > 0:
                mantissa = mantissa * _TENS[count] + whole_number(word, count)
            decimals += count
            is_more |= count == 8
        at += decimals
        n += decimals
    if n == 0 or n > 18 or is_more or mantissa > 1 << 53:
        return 0.0, -1, 0
    value = np.float64(mantissa) / _FLOAT_TENS[decimals]
    return -value if negative else value, at, decimals


@compiled
def _eight_digits(number):  # type: ignore[no-untyped-def]
    """The word of the eight digits of a number below 10**8 (int64)."""
    high = number // 10_000
    word = np.uint64(high) | np.uint64(number - high * 10_000) << np.uint64(32)
    hundreds = ((word * np.uint64(5243)) >> np.uint64(19)) & np.uint64(0x0000007F0000007F)
    word = hundreds | (word - hundreds * np.uint64(100)) << np.uint64(16)
    tens = ((word * np.uint64(103)) >> np.uint64(10)) & np.uint64(0x000F000F000F000F)
    word = tens | (word - tens * np.uint64(10)) << np.uint64(8)
    return word + np.uint64(0x3030303030303030)


@compiled
def _rounded(value, power):  # type: ignore[no-untyped-def]
    """The whole number nearest to value * power, a half to the even one; both are positive.

    The product is below 2**52 and ``power`` a power of ten that is a float64.
    """
    scaled = value * power
    whole = np.int64(scaled)
    beyond = scaled - np.float64(whole) - 0.5
    if abs(beyond) <= scaled * 2.0**-52:
        # The product's own rounding may hide on which side of the half it lies: what it left
        # away, after Dekker (1971), is exact.
        spread = 134217729.0 * value
        value_high = spread - (spread - value)
        value_low = value - value_high
        spread = 134217729.0 * power
        power_high = spread - (spread - power)
        power_low = power - power_high
        rest = ((value_high * power_high - scaled) + value_high * power_low) + (
            value_low * power_high
        )
        beyond += rest + value_low * power_low
        if beyond == 0.0:
            return whole + (whole & 1)
    return whole + 1 if beyond > 0.0 else whole


@compiled
def put_plain(value, decimals, out, at):  # type: ignore[no-untyped-def]
    """Write ``value`` with ``decimals`` (0 to 16) digits behind the point; returns the end.

    abs(value) * 10**decimals must be below 2**52, and seven bytes behind the end be there to be
    written over.  Correctly rounded from the double, ties to the even digit; a result of zero has
    no sign.
    """
    size = abs(value)
    number = _rounded(size, _FLOAT_TENS[decimals])
    out[np.uint64(at)] = 45
    at += np.int64((value < 0.0) & (number > 0))
    whole = np.int64(size)
    fraction = number - whole * _TENS[decimals]
    if fraction >= _TENS[decimals]:
        whole += 1
        fraction -= _TENS[decimals]
    if whole < 10:
        out[np.uint64(at)] = np.uint8(48 + whole)
        at += 1
    else:
        if whole >= 100_000_000:
            high = whole // 100_000_000
            whole -= high * 100_000_000
            # Sixteen digits at most, so that the upper ones are eight at most.
            count = 1
            while count < 8 and high >= _TENS[count]:
                count += 1
            put_eight(out, at, _eight_digits(high * _TENS[8 - count]))
            at += count
            count = 8
        else:
            count = 2
            while count < 8 and whole >= _TENS[count]:
                count += 1
        put_eight(out, at, _eight_digits(whole * _TENS[8 - count]))
        at += count
    if decimals == 0:
        return at
    out[np.uint64(at)] = 46
    at += 1
    if decimals > 8:
        high = fraction // _TENS[decimals - 8]
        put_eight(out, at, _eight_digits(high))
        at += 8
        decimals -= 8
        fraction -= high * _TENS[decimals]
    put_eight(out, at, _eight_digits(fraction * _TENS[8 - decimals]))
    return at + decimals
