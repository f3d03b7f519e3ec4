"""Decimal digits to doubles, exactly: kernels that read what ``digit_writing`` writes.

Nothing is approximate.  A number is read through the first of three ways that is sure of the last
bit: mantissa and power of ten both exact in float64 (Clinger 1990), the 128-bit product of the
mantissa with a truncated power of ten whose error is bounded (Lemire 2021), Python's ``float``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from msal_cli.kernels.byte_words import count_digits, load_eight, parse_digits
from msal_cli.kernels.compiled import compiled

EXACT, NOT_A_NUMBER, UNDECIDED = 0, 1, 2
"""What became of a token: its value is exact; it is no number; ``float`` must decide."""


def _truncated_powers(lowest: int, highest: int) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """The leading 128 bits, cut off, of 10**q for ``lowest <= q <= highest``.

    Returns (k, 2) the high and low words, and (k,) the exponent e such that
    ``high:low * 2**e <= 10**q < (high:low + 1) * 2**e``.
    """
    words = np.empty((highest - lowest + 1, 2), dtype=np.uint64)
    exponents = np.empty(highest - lowest + 1, dtype=np.int64)
    for row, q in enumerate(range(lowest, highest + 1)):
        numerator, denominator = (10**q, 1) if q >= 0 else (1, 10**-q)
        shift = 128 - numerator.bit_length() + denominator.bit_length()
        whole = (numerator << max(shift, 0)) // (denominator << max(-shift, 0))
        while whole.bit_length() > 128:
            whole >>= 1
            shift -= 1
        words[row] = whole >> 64, whole & (2**64 - 1)
        exponents[row] = -shift
    return words, exponents


_REACH = 80
"""Powers of ten up to this one, up and down, are in the table; ``float`` does the others."""

_POWER_WORDS, _POWER_EXPONENTS = _truncated_powers(-_REACH, _REACH)
FLOAT_POWERS = np.array([float(f"1e{q}") for q in range(23)])
POWERS = np.array([10**q for q in range(19)], dtype=np.int64)


@compiled
def _product(a, b):  # type: ignore[no-untyped-def]
    """High and low word of the product of two uint64."""
    low32 = np.uint64(0xFFFFFFFF)
    by32 = np.uint64(32)
    a0, a1 = a & low32, a >> by32
    b0, b1 = b & low32, b >> by32
    p00 = a0 * b0
    p01 = a0 * b1
    p10 = a1 * b0
    middle = (p00 >> by32) + (p01 & low32) + (p10 & low32)
    high = a1 * b1 + (p01 >> by32) + (p10 >> by32) + (middle >> by32)
    return high, (middle << by32) | (p00 & low32)


@compiled
def _bit_length(word):  # type: ignore[no-untyped-def]
    """Bits of a uint64 that is not zero."""
    length = 1
    for step in (32, 16, 8, 4, 2, 1):
        if word >> np.uint64(step) != np.uint64(0):
            word >>= np.uint64(step)
            length += step
    return length


@compiled
def times_power(word, exponent):  # type: ignore[no-untyped-def]
    """The leading 128 bits of word * 10**exponent, at most two units too small.

    Returns high, low and e with value = high:low * 2**e; the top bit or the one below it is set.
    The table is cut off by less than one unit of its low word, which the word, below 2**64, carries
    into the third word of the product; the third word itself is cut off: two units in all.
    """
    left = 64 - _bit_length(word)
    word <<= np.uint64(left)
    row = exponent + _REACH
    high, low = _product(word, _POWER_WORDS[row, 0])
    carried, _ = _product(word, _POWER_WORDS[row, 1])
    total = low + carried
    if total < low:
        high += np.uint64(1)
    return high, total, _POWER_EXPONENTS[row] + 64 - left


@compiled
def scale_exactly(mantissa, exponent):  # type: ignore[no-untyped-def]
    """mantissa * 10**exponent, correctly rounded, and EXACT or UNDECIDED; mantissa is uint64."""
    if mantissa == np.uint64(0):
        return 0.0, EXACT
    if mantissa <= np.uint64(1 << 53):
        value = np.float64(np.int64(mantissa))
        if exponent == 0:
            return value, EXACT
        if -22 <= exponent < 0:
            return value / FLOAT_POWERS[-exponent], EXACT
        if 0 < exponent <= 22:
            return value * FLOAT_POWERS[exponent], EXACT
    if exponent < -_REACH or exponent > _REACH:
        return 0.0, UNDECIDED
    high, low, power = times_power(mantissa, exponent)
    cut = 10 if high >> np.uint64(63) != np.uint64(0) else 9
    kept = high >> np.uint64(cut)
    kept_bits = high >> np.uint64(cut + 1)
    rest = high & np.uint64((1 << (cut + 1)) - 1)
    half = np.uint64(1 << cut)
    # The true product lies less than two units above: only there can the half be crossed.
    if (rest == half and low == np.uint64(0)) or (
        rest == half - np.uint64(1) and low >= np.uint64(0xFFFFFFFFFFFFFFFE)
    ):
        return 0.0, UNDECIDED
    rounded = kept_bits + (kept & np.uint64(1))
    return math.ldexp(np.float64(np.int64(rounded)), int(power + 64 + cut + 1)), EXACT


@compiled
def _letter(buf, at, stop):  # type: ignore[no-untyped-def]
    """The byte at ``at`` in lower case, 0 beyond the end."""
    if at >= stop:
        return 0
    c = np.int64(buf[at])
    if 65 <= c <= 90:
        c += 32
    return c


@compiled
def _word(buf, at, stop):  # type: ignore[no-untyped-def]
    """nan, nan(...), inf or infinity: value, status and end."""
    if _letter(buf, at, stop) == 110:
        if _letter(buf, at + 1, stop) != 97 or _letter(buf, at + 2, stop) != 110:
            return 0.0, NOT_A_NUMBER, at
        at += 3
        if at < stop and buf[at] == 40:
            closing = at + 1
            while closing < stop and buf[closing] > 41:
                closing += 1
            if closing < stop and buf[closing] == 41:
                at = closing + 1
        return np.nan, EXACT, at
    for k, c in enumerate((105, 110, 102, 105, 110, 105, 116, 121)):
        if _letter(buf, at + k, stop) != c:
            if k >= 3:
                return np.inf, EXACT, at + 3
            return 0.0, NOT_A_NUMBER, at
    return np.inf, EXACT, at + 8


@compiled
def _long(buf, start, stop, decimals):  # type: ignore[no-untyped-def]
    """Value and status of twenty digits and more, with a point among them, times 10**-decimals.

    The first 19 significant digits bound it from below, the next number of 19 from above: where
    both are read as the same double, so is everything between.
    """
    mantissa = np.uint64(0)
    n_digits = 0
    dropped = 0
    for k in range(start, stop):
        if buf[k] == 46:
            continue
        if n_digits == 19:
            dropped += 1
        else:
            mantissa = mantissa * np.uint64(10) + np.uint64(buf[k] - 48)
            n_digits += mantissa != np.uint64(0)
    exponent = dropped - decimals
    below, status = scale_exactly(mantissa, exponent)
    if dropped == 0 or status != EXACT:
        return below, status
    above, status = scale_exactly(mantissa + np.uint64(1), exponent)
    return below, EXACT if status == EXACT and below == above else UNDECIDED


@compiled
def read_plain(buf, at):  # type: ignore[no-untyped-def]
    """``read_number`` for the numbers that nearly all files consist of: value, end, decimals.

    Digits with a point or without and perhaps a minus, which make a whole number up to 2**53, so
    that one division rounds correctly.  The end is -1 for other numbers.
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
    n_digits = at - first
    is_more = n_digits > 9
    decimals = np.int64(0)
    if at < len(buf) and buf[np.uint64(at)] == 46:
        at += 1
        count = np.int64(8)
        while count == 8 and decimals < 16:
            word = load_eight(buf, at)
            count = count_digits(word)
            if count > 0:
                mantissa = mantissa * POWERS[count] + parse_digits(word, count)
            decimals += count
            at += count
        is_more |= decimals == 16
        n_digits += decimals
    if n_digits == 0 or n_digits > 18 or is_more or mantissa > 1 << 53:
        return 0.0, -1, 0
    value = np.float64(mantissa) / FLOAT_POWERS[decimals]
    return -value if negative else value, at, decimals


@compiled
def _read_any(buf, start, stop):  # type: ignore[no-untyped-def]
    """``read_number`` for every number."""
    at = start
    negative = False
    if at < stop and (buf[at] == 45 or buf[at] == 43):
        negative = buf[at] == 45
        at += 1
    first = at
    mantissa = np.uint64(0)
    while at < stop and 48 <= buf[at] <= 57:
        mantissa = mantissa * np.uint64(10) + np.uint64(buf[at] - 48)
        at += 1
    n_digits = at - first
    decimals = np.int64(0)
    if at < stop and buf[at] == 46:
        at += 1
        point = at
        while at < stop and 48 <= buf[at] <= 57:
            mantissa = mantissa * np.uint64(10) + np.uint64(buf[at] - 48)
            at += 1
        decimals = at - point
        n_digits += decimals
    if n_digits == 0:
        if at == first and at < stop and _letter(buf, at, stop) in (105, 110):
            value, status, at = _word(buf, at, stop)
            return -value if negative else value, status, at, 0
        return 0.0, NOT_A_NUMBER, at, 0
    last = at
    if at < stop and (buf[at] == 101 or buf[at] == 69):
        at += 1
        exponent_negative = False
        if at < stop and (buf[at] == 45 or buf[at] == 43):
            exponent_negative = buf[at] == 45
            at += 1
        exponent = np.int64(0)
        exponent_first = at
        while at < stop and 48 <= buf[at] <= 57:
            if exponent < 100_000:
                exponent = exponent * 10 + np.int64(buf[at] - 48)
            at += 1
        if at == exponent_first:
            return 0.0, NOT_A_NUMBER, at, 0
        decimals -= -exponent if exponent_negative else exponent
    if n_digits > 19:
        value, status = _long(buf, first, last, decimals)
    else:
        value, status = scale_exactly(mantissa, -decimals)
    return -value if negative else value, status, at, max(decimals, 0)


@compiled
def read_number(buf, start, stop):  # type: ignore[no-untyped-def]
    """The number that begins at ``start``: value, status, end, decimals.

    ``end`` is the first byte that does not belong to it; whether a token may end there is the
    caller's to say.  ``decimals`` are the digits behind the point, the exponent counted in.
    """
    value, end, decimals = read_plain(buf, start)
    # A letter may be an exponent or the beginning of a word.
    if 0 <= end <= stop and (end == stop or buf[np.uint64(end)] < 65):
        return value, EXACT, end, decimals
    return _read_any(buf, start, stop)
