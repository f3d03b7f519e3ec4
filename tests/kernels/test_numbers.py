"""Eight bytes at a time, and numbers written with a fixed number of decimals, against Python."""

from __future__ import annotations

import numpy as np
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
