"""Every number in or out of a text file is the one that Python's own conversion gives."""

import math
import struct
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from msal_cli.kernels import text

finite = st.floats(allow_nan=False, allow_infinity=False)


def tokens(words: list[bytes], between: bytes = b" ") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A buffer of these words, and where each starts and stops."""
    sizes = np.array([len(word) for word in words], dtype=np.int64)
    starts = np.concatenate(([0], np.cumsum(sizes + len(between))[:-1])) if words else sizes
    buffer = np.frombuffer(between.join(words) + between, dtype=np.uint8)
    return buffer, starts.astype(np.int64), (starts + sizes).astype(np.int64)


def split(buffer: np.ndarray, stops: np.ndarray) -> list[str]:
    """The texts that lie one behind the other."""
    starts = [0, *stops.tolist()][:-1]
    return [buffer[a:b].tobytes().decode() for a, b in zip(starts, stops, strict=True)]


def same_bits(a: float, b: float) -> bool:
    return struct.pack("d", a) == struct.pack("d", b)


def value_of(word: bytes) -> float:
    values, bad = text.read_numbers(*tokens([word]))
    assert bad == -1, word
    return float(values[0])


# Reading


@given(st.from_regex(rb"[+-]?(\d{1,25}\.?\d{0,25}|\.\d{1,25})([eE][+-]?\d{1,3})?", fullmatch=True))
@example(b"9007199254740993")
@example(b"9007199254740993.0000000000")
@example(b"9007199254740992.9999")
@example(b"123456789012345678e-17")
@example(b"0.000000000000000000000000000001")
@example(b"-0")
@example(b"1e400")
@example(b"1e-400")
@example(b"2.2250738585072011e-308")
@example(b"1e99999999999999999999")
@example(b"00000000000000000000000000012.5")
def test_numbers_are_read_as_python_reads_them(word: bytes) -> None:
    assert same_bits(value_of(word), float(word))


@pytest.mark.parametrize("shift", range(-12, 12))
def test_the_middle_of_two_doubles_and_its_neighbours(shift: int) -> None:
    """The hardest tokens: exact ties, to all their digits, and a hair above and below."""
    for low in (2**53 + 1, 2**53 + 3, 2**54 - 1):
        tie = Fraction(low) * Fraction(2) ** shift
        digits = str(int(tie * 10**12))
        assert tie * 10**12 == int(digits)
        for word in (digits, f"{digits}1", f"{int(digits) - 1}9", f"{digits}000", f"{digits}001"):
            written = f"{word}e{len(digits) - len(word) - 12}"
            assert same_bits(value_of(written.encode()), float(written)), written
        short = digits.rstrip("0")
        written = f"{short}0e{len(digits) - len(short) - 13}"
        assert same_bits(value_of(written.encode()), float(written)), written


@pytest.mark.parametrize(
    ("word", "value"),
    [
        (b"nan", math.nan), (b"NaN", math.nan), (b"-nan", math.nan), (b"nan(0x8)", math.nan),
        (b"-nan(ind)", math.nan), (b"inf", math.inf), (b"INF", math.inf), (b"+Inf", math.inf),
        (b"-infinity", -math.inf), (b"Infinity", math.inf), (b".5", 0.5), (b"5.", 5.0),
        (b"+1", 1.0), (b"1E3", 1000.0), (b"1e+3", 1000.0), (b"-0.0", -0.0),
    ],
)  # fmt: skip
def test_words_and_short_forms(word: bytes, value: float) -> None:
    got = value_of(word)
    assert math.isnan(got) if math.isnan(value) else same_bits(got, value)


@pytest.mark.parametrize(
    "word",
    [
        b"", b"+", b"-", b".", b"e5", b".e5", b"1e", b"1e+", b"1.2.3", b"1,5", b"0x10", b"1_000",
        b"--1", b"+-1", b"1d5", b"n", b"na", b"nanx", b"nan(", b"in", b"infi", b"infinit",
        b"infinityy", b"1 2", b"1\x00", b"1f", b"\xd9\xa1", b"1.#INF", b"/",
    ],
)  # fmt: skip
def test_what_is_no_number(word: bytes) -> None:
    buffer = np.frombuffer(b"7 " + word + b" 8", dtype=np.uint8)
    starts = np.array([0, 2, len(buffer) - 1])
    stops = np.array([1, 2 + len(word), len(buffer)])
    assert text.read_numbers(buffer, starts, stops)[1] == 1


# Printing


def fixed(value: float, decimals: int) -> str:
    spelled = f"{value:.{decimals}f}"
    return spelled.lstrip("-") if float(spelled) == 0.0 else spelled


@given(st.lists(finite, max_size=6), st.integers(0, 17))
@example([0.5, 1.5, 2.5, -0.5, 0.125, 0.375, 1e-5, -1e-30, 5e-324], 0)
@example([0.125, 0.375, 0.005, 1.005, 2.675, 99.995, -99.995], 2)
@example([9007199254740993.0, 9.2e18, 0.1, 4650000.123456789], 17)
@example([2.0**63, -(2.0**64), 1e300, 3.0], 3)
def test_printed_is_correctly_rounded(values: list[float], decimals: int) -> None:
    got = split(*text.print_numbers(np.array(values), decimals))
    assert got == [fixed(v, decimals) if abs(v) < 2.0**63 else repr(v) for v in values]


def is_between_two_singles(word: str) -> bool:
    """Whether a number is the very middle of two float32, where readers may differ."""
    single = np.float32(word)
    with np.errstate(over="ignore"):
        neighbours = [np.nextafter(single, np.float32(way)) for way in (-np.inf, np.inf)]
    return any((float(single) + float(neighbour)) / 2 == float(word) for neighbour in neighbours)


def digits_that_any_reader_takes(single: np.float32) -> int:
    """How many digits tell a float32, where those of ``str`` are the middle of two of them.

    The middle may end in zeros, as 9.995e8 does: then it takes several digits more, not one.
    """
    for count in range(1, 10):
        word = f"{float(single):.{count - 1}e}"
        if np.float32(word) == single and not is_between_two_singles(word):
            return n_digits(word)
    raise AssertionError(f"nine digits do not tell {single!r}")


def digits_of_single(single: np.float32) -> int:
    """How many digits a float32 should be printed with."""
    if is_between_two_singles(str(single)):
        return digits_that_any_reader_takes(single)
    return n_digits(str(single))


def n_digits(word: str) -> int:
    return len(word.lower().split("e")[0].replace(".", "").strip("-").strip("0")) or 1


@given(st.lists(finite, max_size=6))
@example([0.1, 1 / 3, 5e-324, 1.7976931348623157e308, -0.0, 1e16, 123456789012345680.0, 1e-5])
@example([2.0**-44, 2.0**-24, 2.0**89, 9007199254740993.0, 100.0, 0.00012345678901234567])
def test_shortest_double(values: list[float]) -> None:
    for value, word in zip(
        values, split(*text.print_shortest(np.array(values), False)), strict=True
    ):
        assert same_bits(float(word), value)
        assert n_digits(word) == n_digits(repr(value)), (word, value)


@given(st.lists(st.floats(width=32, allow_nan=False, allow_infinity=False), max_size=6))
@example([16777216.0, 0.1, 2.0**-149, 1.1754943508222875e-38, 3.4028234663852886e38, 1e-5])
# The middle of two float32: right only for readers that take the even one.
@example([60345808.0, 999500032.0])
def test_shortest_single(values: list[float]) -> None:
    singles = np.array(values, dtype=np.float32)
    for value, word in zip(
        singles, split(*text.print_shortest(singles.astype(np.float64), True)), strict=True
    ):
        assert np.float32(word).tobytes() == value.tobytes()
        assert n_digits(word) == digits_of_single(value), (word, value)


# Tokens replaced inside a text
