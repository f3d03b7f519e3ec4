"""Exact conversion between decimal digits and doubles.

Text is read and written eight bytes at a time, as a 64-bit word whose lowest byte is the first:
unsigned offsets need no test for negative ones, and the eight loads or stores become one.

Nothing is approximate.  A number is read by the first of three methods that is sure of the last
bit: mantissa and power of ten both exact in float64 (Clinger 1990), the 128-bit product of the
mantissa with a truncated power of ten whose error is bounded (Lemire 2021), Python's ``float``.  A
number is written, as fixed-point text or as the shortest text that reads back, from all digits of
its product with a power of ten, whose rounding error is known (Dekker 1971).
"""

import math

import numpy as np
from numpy.typing import NDArray

from msal_cli.kernels.library import compiled

# Constants, so that the compiler recognizes eight neighbours and makes one load.
_ONE, _TWO, _THREE, _FOUR, _FIVE, _SIX, _SEVEN = (np.uint64(count) for count in range(1, 8))
_BITS_8, _BITS_16, _BITS_24, _BITS_32, _BITS_40, _BITS_48, _BITS_56 = (
    np.uint64(8 * count) for count in range(1, 8)
)


@compiled
def load_eight(buf, at):
    """The eight bytes at ``at`` as a word; bytes beyond the end are zeros."""
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
def store_eight(out, at, word):
    """Write a word to the eight bytes at ``at``; bytes beyond the end are dropped."""
    first = np.uint64(at)
    if at + 8 <= len(out):
        # The compiler makes one store of a constant number of bytes.
        for k in range(8):
            out[first + np.uint64(k)] = np.uint8(word >> np.uint64(8 * k))
    else:
        for k in range(len(out) - at):
            out[first + np.uint64(k)] = np.uint8(word >> np.uint64(8 * k))


@compiled
def count_before(marks):
    """The number of bytes before the first marked one; ``marks`` has the top bits of marked bytes.

    Eight if none is marked.
    """
    # The lowest set bit minus one sets all bits below it, of which the lowest of each byte is
    # counted.
    below = (marks - np.uint64(1)) & ~marks
    ones = np.uint64(0x0101010101010101)
    # The marked byte itself has its seven lower bits below.
    return np.int64((((below >> np.uint64(7)) & ones) * ones) >> np.uint64(56))


@compiled
def count_digits(word):
    """The number of digits among the eight bytes before the first other byte."""
    high = np.uint64(0x8080808080808080)
    # A carry between bytes starts at one that is no digit, so it affects only later ones.
    over = word + np.uint64(0x4646464646464646)
    under = word - np.uint64(0x3030303030303030)
    return count_before((over | under) & high)


@compiled
def parse_digits(word, count):
    """The number whose decimal digits are the first ``count`` (1 to 8) bytes."""
    # The first digit is the lowest byte; zeros are inserted before it.
    word = (word - np.uint64(0x3030303030303030)) << np.uint64(64 - 8 * count)
    word = word * np.uint64(10) + (word >> np.uint64(8))
    pairs = np.uint64(0x000000FF000000FF)
    first = (word & pairs) * np.uint64(0x000F424000000064)
    second = ((word >> np.uint64(16)) & pairs) * np.uint64(0x0000271000000001)
    return np.int64((first + second) >> np.uint64(32))


@compiled
def format_digits(number):
    """The word of the eight decimal digits of an int64 below 10**8."""
    high = number // 10_000
    word = np.uint64(high) | np.uint64(number - high * 10_000) << np.uint64(32)
    hundreds = ((word * np.uint64(5243)) >> np.uint64(19)) & np.uint64(0x0000007F0000007F)
    word = hundreds | (word - hundreds * np.uint64(100)) << np.uint64(16)
    tens = ((word * np.uint64(103)) >> np.uint64(10)) & np.uint64(0x000F000F000F000F)
    word = tens | (word - tens * np.uint64(10)) << np.uint64(8)
    return word + np.uint64(0x3030303030303030)


_NAN, _INF, _INFINITY = (
    np.uint64(int.from_bytes(word, "little")) for word in (b"nan", b"inf", b"infinity")
)

EXACT, NOT_A_NUMBER, UNDECIDED = 0, 1, 2
"""Status of a token: its value is exact; it is not a number; ``float`` must decide."""


def _truncated_powers(lowest: int, highest: int) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """The truncated leading 128 bits of 10**q for ``lowest <= q <= highest``.

    Returns (k, 2) the high and low words, and (k,) the exponent e such that ``high:low * 2**e <=
    10**q < (high:low + 1) * 2**e``.
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
"""Largest absolute exponent of the table of powers of ten; ``float`` reads the others."""

_POWER_WORDS, _POWER_EXPONENTS = _truncated_powers(-_REACH, _REACH)
FLOAT_POWERS = np.array([float(f"1e{q}") for q in range(23)])
POWERS = np.array([10**q for q in range(19)], dtype=np.int64)


@compiled
def _product(a, b):
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
def _bit_length(word):
    """Bits of a uint64 that is not zero."""
    length = 1
    for step in (32, 16, 8, 4, 2, 1):
        if word >> np.uint64(step) != np.uint64(0):
            word >>= np.uint64(step)
            length += step
    return length


@compiled
def times_power(word, exponent):
    """The leading 128 bits of word * 10**exponent, at most two units too small.

    Returns high, low and e with value = high:low * 2**e; the top bit or the one below it is set.
    The table is truncated by less than one unit of its low word, which the word, below 2**64,
    carries into the third word of the product; the third word is truncated too.
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
def scale_exactly(mantissa, exponent):
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
    # The true product is less than two units above: only there can the half be crossed.
    if (rest == half and low == np.uint64(0)) or (
        rest == half - np.uint64(1) and low >= np.uint64(0xFFFFFFFFFFFFFFFE)
    ):
        return 0.0, UNDECIDED
    rounded = kept_bits + (kept & np.uint64(1))
    return math.ldexp(np.float64(np.int64(rounded)), int(power + 64 + cut + 1)), EXACT


@compiled
def _read_word(buf, at, stop):
    """nan, nan(...), inf or infinity, in any case: value, status and end."""
    word = load_eight(buf, at) | np.uint64(0x2020202020202020)
    three = word & np.uint64(0xFFFFFF) if stop - at >= 3 else np.uint64(0)
    if three == _INF:
        return np.inf, EXACT, at + (8 if word == _INFINITY and stop - at >= 8 else 3)
    if three != _NAN:
        return 0.0, NOT_A_NUMBER, at
    at += 3
    if at < stop and buf[at] == 40:
        closing = at + 1
        while closing < stop and buf[closing] > 41:
            closing += 1
        if closing < stop and buf[closing] == 41:
            at = closing + 1
    return np.nan, EXACT, at


@compiled
def read_plain(buf, at):
    """``read_number`` for the numbers in nearly all files: value, end, decimals.

    Digits with or without a point and a minus sign, which make an integer up to 2**53, so that one
    division rounds correctly.  The end is -1 for other numbers.
    """
    negative = at < len(buf) and buf[np.uint64(at)] == 45
    at += negative
    first = at
    mantissa = np.int64(0)
    # One by one, because they are few, and the processor predicts how many.
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
def _read_any(buf, start, stop):
    """``read_number`` for all numbers.

    The first 19 significant digits are a lower bound of a longer number, the next number of 19
    digits an upper one: if both are read as the same double, so is every number between.
    """
    at = start
    negative = False
    if at < stop and (buf[at] == 45 or buf[at] == 43):
        negative = buf[at] == 45
        at += 1
    first, point = at, np.int64(-1)
    mantissa = np.uint64(0)
    dropped = np.int64(0)
    while at < stop:
        c = buf[at]
        if 48 <= c <= 57:
            if mantissa < np.uint64(10**18):
                mantissa = mantissa * np.uint64(10) + np.uint64(c - 48)
            else:
                dropped += 1
        elif c == 46 and point < 0:
            point = at
        else:
            break
        at += 1
    if at - first == (point >= 0):
        if point >= 0:
            return 0.0, NOT_A_NUMBER, at, 0
        value, status, at = _read_word(buf, at, stop)
        return -value if negative else value, status, at, 0
    decimals = at - point - 1 if point >= 0 else np.int64(0)
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
    value, status = scale_exactly(mantissa, dropped - decimals)
    if dropped > 0 and status == EXACT:
        above, status = scale_exactly(mantissa + np.uint64(1), dropped - decimals)
        if above != value:
            status = UNDECIDED
    return -value if negative else value, status, at, max(decimals, 0)


@compiled
def read_number(buf, start, stop):
    """The number that begins at ``start``: value, status, end, decimals.

    ``end`` is the first byte that does not belong to it; the caller decides whether a token may end
    there.  ``decimals`` are the digits after the point, adjusted by the exponent.
    """
    value, end, decimals = read_plain(buf, start)
    # A letter may be an exponent or the beginning of a word.
    if 0 <= end <= stop and (end == stop or buf[np.uint64(end)] < 65):
        return value, EXACT, end, decimals
    return _read_any(buf, start, stop)


MAX_DECIMALS = 17
"""Largest number of decimals of fixed-point text."""

SHORTEST, SHORTEST_SINGLE = 18, 19
"""Instead of a number of decimals: the shortest text that reads back as the same float64 or
float32."""

FIXED_BELOW = 2.0**63
"""Fixed-point text is used for smaller magnitudes only."""

MAX_SHORTEST_WIDTH = 26
"""Bytes that are enough for any ``repr`` of a float: ``-1.2345678901234567e-308`` has 24."""


@compiled
def _write_eight(number, count, out, at):
    """``_write_digits`` for up to eight digits."""
    store_eight(out, at, format_digits(number * POWERS[8 - count]))
    return at + count


@compiled
def _write_digits(number, count, out, at):
    """Write an int64 with exactly ``count`` digits (up to 24); returns the end.

    Up to seven bytes after the end may be overwritten.
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
def _n_digits(number):
    """Decimal digits of an int64 from zero up, one for zero."""
    n = 1
    while n < 19 and number >= POWERS[n]:
        n += 1
    return n


@compiled
def _scaled_fraction(fraction, decimals, is_odd):
    """The integer nearest to fraction * 10**decimals, ties to even.

    0 <= fraction < 1; ``is_odd`` is 1 if an even result would make the number odd.
    """
    power = FLOAT_POWERS[decimals]
    scaled = fraction * power
    number = np.int64(scaled)
    beyond = scaled - np.float64(number) - 0.5
    if abs(beyond) > scaled * 2.0**-52:
        return number + (beyond > 0.0)
    # The rounding of the product may hide on which side of the half it is: its error (Dekker 1971)
    # is exact.
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
def _parts(value):
    """Integer mantissa (uint64) and exponent e of a finite |value| = mantissa * 2**e."""
    bits = np.float64(value).view(np.uint64)
    biased = np.int64((bits >> np.uint64(52)) & np.uint64(0x7FF))
    mantissa = bits & np.uint64((1 << 52) - 1)
    if biased == 0:
        return mantissa, -1074
    return mantissa | np.uint64(1 << 52), biased - 1075


@compiled
def write_fixed(value, decimals, out, at):
    """Write ``value`` with ``decimals`` (at most 17) digits after the point; returns the end.

    Correctly rounded from the double, ties to the even digit; a result of zero has no sign.  Up to
    seven bytes after the end may be overwritten.  Returns -1, with nothing written, for magnitudes
    of 2**63 and more and for NaN.
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
    # The usual sizes separately, because the compiler inlines short code.
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
def _rounded_to(value, n_digits, exponent):
    """Nearest integer (up to a tie) to value * 10**(n_digits - 1 - exponent), value > 0."""
    mantissa, power = _parts(value)
    high, _, shift = times_power(mantissa, n_digits - 1 - exponent)
    # The result has 17 digits at most, so it is in the upper word.
    right = np.uint64(-(shift + power) - 64 - 1)
    doubled = high >> right
    return (doubled + np.uint64(1)) >> np.uint64(1)


@compiled
def _reads_back(mantissa, exponent, value, single):
    """Whether mantissa * 10**exponent is read as ``value``: 1, 0, or -1 if unsure."""
    back, status = scale_exactly(mantissa, exponent)
    if status != EXACT:
        return -1
    if not single:
        return 1 if back == value else 0
    # In or near the middle of two float32 readers differ; one digit more is unambiguous.
    below = np.float64(np.float32(back * (1.0 - 2.0**-52)))
    above = np.float64(np.float32(back * (1.0 + 2.0**-52)))
    return 1 if below == value and above == value else 0


@compiled
def write_shortest(value, single, out, at):
    """Write the shortest decimal that is read back as ``value``; returns the end.

    If 15 digits (float32: 6) read back, they are the shortest without their trailing zeros, because
    each decimal of so few digits survives the conversion.  Returns -1, with nothing written, if
    ``repr`` must decide.
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
    # If the logarithm is unsure, too low: that is detected by one digit too many.
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
            # The doubles above are twice as far apart as those below: the other side may read back.
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
def write_number(value, decimals, out, at):
    """Write ``value`` with that many decimals, SHORTEST or SHORTEST_SINGLE; returns the end.

    -1, with nothing written, if Python must do it.  Seven bytes after the end may be overwritten.
    """
    if decimals == SHORTEST or decimals == SHORTEST_SINGLE:
        return write_shortest(value, decimals == SHORTEST_SINGLE, out, at)
    return write_fixed(value, decimals, out, at)
