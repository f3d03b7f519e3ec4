"""Eight bytes at a time, and numbers written with a fixed number of decimals, against Python."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.kernels import numbers
from msal_cli.kernels.text import as_bytes


@given(st.binary(max_size=20), st.integers(0, 20))
@settings(deadline=None)
def test_eight_bytes_are_one_word_and_beyond_the_end_are_zeros(data: bytes, at: int) -> None:
    wanted = int.from_bytes(data[at : at + 8], "little")
    assert int(numbers.load_eight(as_bytes(data), at)) == wanted


@given(st.integers(0, 2**64 - 1))
@settings(deadline=None)
def test_a_word_is_put_and_found_again(word: int) -> None:
    out = np.full(10, 7, dtype=np.uint8)
    numbers.store_eight(out, 1, np.uint64(word))
    assert int(numbers.load_eight(as_bytes(out), 1)) == word
    assert (out[0], out[9]) == (7, 7)


@given(st.lists(st.sampled_from(b"0189/:-. \x00\x7f\x80\xb0\xff"), min_size=8, max_size=8))
@settings(deadline=None)
def test_digits_are_counted_up_to_the_first_other_byte(letters: list[int]) -> None:
    word = np.uint64(int.from_bytes(bytes(letters), "little"))
    wanted = next((k for k, c in enumerate(letters) if not 48 <= c <= 57), 8)
    assert numbers.count_digits(word) == wanted


@given(st.integers(0, 10**8 - 1), st.integers(1, 8))
@settings(deadline=None)
def test_whole_numbers(number: int, count: int) -> None:
    text = b"%08d" % number
    word = np.uint64(int.from_bytes(text[8 - count :] + b"/x: 9.-\xff"[: 8 - count], "little"))
    assert numbers.parse_digits(word, count) == number % 10**count


def printed(value: float, decimals: int) -> bytes:
    out = np.full(60, 42, dtype=np.uint8)
    end = numbers.write_fixed(value, decimals, out, 1)
    assert out[0] == 42
    assert (out[end + 8 :] == 42).all()
    return out[1:end].tobytes()


def exact(value: float, decimals: int) -> bytes:
    text = b"%.*f" % (decimals, value)
    return text.lstrip(b"-") if float(text) == 0.0 else text


@given(st.floats(-9e18, 9e18), st.integers(-12, 0), st.integers(0, numbers.MOST_DECIMALS))
@settings(deadline=None)
def test_what_is_printed_is_correctly_rounded(value: float, power: int, decimals: int) -> None:
    value *= 10.0**power
    assert printed(value, decimals) == exact(value, decimals)


@given(st.integers(-(10**7), 10**7), st.integers(0, 9), st.integers(-3, 3))
@settings(deadline=None)
def test_halves_and_their_neighbours_are_correctly_rounded(
    number: int, decimals: int, steps: int
) -> None:
    value = (number + 0.5) / 10**decimals
    for _ in range(abs(steps)):
        value = float(np.nextafter(value, steps * np.inf))
    assert printed(value, decimals) == exact(value, decimals)


@pytest.mark.parametrize(
    ("value", "decimals", "text"),
    [
        (0.5, 0, b"0"),
        (1.5, 0, b"2"),
        (0.125, 2, b"0.12"),
        (0.375, 2, b"0.38"),
        (-0.0, 3, b"0.000"),
        (-0.0004, 3, b"0.000"),
        (-0.0005, 3, b"-0.001"),
        (9.9996, 3, b"10.000"),
        (99999999.9, 0, b"100000000"),
        (1234567890123.5, 1, b"1234567890123.5"),
        (5e-324, 16, b"0.0000000000000000"),
    ],
)
def test_printed_by_hand(value: float, decimals: int, text: bytes) -> None:
    assert printed(value, decimals) == text
