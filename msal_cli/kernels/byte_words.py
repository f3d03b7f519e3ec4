"""Eight bytes of a text at a time, as one 64-bit word whose lowest byte is the first.

Unsigned offsets spare the test for negative ones, and the eight loads or stores become one.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled

# As constants, so that the compiler sees eight neighbours and makes one load or store of them.
_ONE, _TWO, _THREE, _FOUR, _FIVE, _SIX, _SEVEN = (np.uint64(count) for count in range(1, 8))
_BITS_8, _BITS_16, _BITS_24, _BITS_32, _BITS_40, _BITS_48, _BITS_56 = (
    np.uint64(8 * count) for count in range(1, 8)
)


@compiled
def load_eight(buf, at):  # type: ignore[no-untyped-def]
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
def store_eight(out, at, word):  # type: ignore[no-untyped-def]
    """Write a word to the eight bytes at ``at``; bytes beyond the end are left away."""
    u = np.uint64(at)
    if at + 8 <= len(out):
        out[u] = np.uint8(word)
        out[u + _ONE] = np.uint8(word >> _BITS_8)
        out[u + _TWO] = np.uint8(word >> _BITS_16)
        out[u + _THREE] = np.uint8(word >> _BITS_24)
        out[u + _FOUR] = np.uint8(word >> _BITS_32)
        out[u + _FIVE] = np.uint8(word >> _BITS_40)
        out[u + _SIX] = np.uint8(word >> _BITS_48)
        out[u + _SEVEN] = np.uint8(word >> _BITS_56)
    else:
        for k in range(at, len(out)):
            out[k] = np.uint8(word >> np.uint64(8 * (k - at)))


@compiled
def count_before(marks):  # type: ignore[no-untyped-def]
    """How many bytes lie before the first marked one; ``marks`` has the top bits of marked bytes.

    Eight where none is marked.
    """
    # The lowest bit set, less one: all bits below it, of which each byte's lowest is counted.
    below = (marks - np.uint64(1)) & ~marks
    ones = np.uint64(0x0101010101010101)
    # The marked byte itself has its seven lower bits below.
    return np.int64((((below >> np.uint64(7)) & ones) * ones) >> np.uint64(56))


@compiled
def count_digits(word):  # type: ignore[no-untyped-def]
    """How many of the eight bytes are digits before the first that is none."""
    high = np.uint64(0x8080808080808080)
    # A carry from byte to byte comes from one that is no digit, and so harms only later ones.
    over = word + np.uint64(0x4646464646464646)
    under = word - np.uint64(0x3030303030303030)
    return count_before((over | under) & high)


@compiled
def parse_digits(word, count):  # type: ignore[no-untyped-def]
    """The number whose decimal digits are the first ``count`` (1 to 8) bytes."""
    # The first digit is the lowest byte; zeros are put before it.
    word = (word - np.uint64(0x3030303030303030)) << np.uint64(64 - 8 * count)
    word = word * np.uint64(10) + (word >> np.uint64(8))
    pairs = np.uint64(0x000000FF000000FF)
    first = (word & pairs) * np.uint64(0x000F424000000064)
    second = ((word >> np.uint64(16)) & pairs) * np.uint64(0x0000271000000001)
    return np.int64((first + second) >> np.uint64(32))


@compiled
def format_digits(number):  # type: ignore[no-untyped-def]
    """The word of the eight decimal digits of an int64 below 10**8."""
    high = number // 10_000
    word = np.uint64(high) | np.uint64(number - high * 10_000) << np.uint64(32)
    hundreds = ((word * np.uint64(5243)) >> np.uint64(19)) & np.uint64(0x0000007F0000007F)
    word = hundreds | (word - hundreds * np.uint64(100)) << np.uint64(16)
    tens = ((word * np.uint64(103)) >> np.uint64(10)) & np.uint64(0x000F000F000F000F)
    word = tens | (word - tens * np.uint64(10)) << np.uint64(8)
    return word + np.uint64(0x3030303030303030)
