"""Names: reversible for programs, harmless for people."""

from __future__ import annotations

import os

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.job.display_names import (
    columns,
    escape_for_display,
    portable,
    restore_name,
    shorten_name,
)

ANY_TEXT = st.text(st.characters() | st.characters(min_codepoint=0xD800, max_codepoint=0xDFFF))
TRICKY = st.lists(st.sampled_from(["\\", "u", "d", "c", "8", "0", "5", "f", "\udcff", "\ud800"]))


@given(ANY_TEXT | TRICKY.map("".join))
def test_portable_text_is_valid_and_comes_back(text):
    plain = portable(text)
    plain.encode("utf-8")
    assert restore_name(plain) == text


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        (os.fsdecode(b"a\xff.ply") if os.name == "posix" else "a\udcff.ply", "a\\udcff.ply"),
        ("\\udcff", "\\u005cudcff"),
        ("\\u005c", "\\u005cu005c"),
        ("\\\udcff", "\\\\udcff"),
    ],
)
def test_what_is_escaped(text, plain):
    assert portable(text) == plain


@given(ANY_TEXT)
def test_shown_text_holds_nothing_that_a_terminal_obeys(text):
    said = escape_for_display(text)
    said.encode("utf-8")
    assert not any(ord(one) < 32 or 0x7F <= ord(one) < 0xA0 for one in said)
    assert not set(said) & set("\u202a\u202e\u2066\u2069\u2028\u200f")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("扫描 é.ply", "扫描 é.ply"),
        ("a\nb\r\t", "a\\nb\\r\\t"),
        ("\x1b[31mred", "\\x1b[31mred"),
        ("a\udcff", "a\\xff"),
        ("gpj\u202eexe", "gpj\\u202eexe"),
        ("\U000e0041", "\\U000e0041"),
    ],
)
def test_what_people_see(text, said):
    assert escape_for_display(text) == said


@given(st.text(), st.integers(3, 30))
def test_shortened_fits_and_keeps_the_end(text, width):
    short = shorten_name(text, width)
    assert columns(short) <= width
    assert text.endswith(short.removeprefix("...")) or short == text
    if columns(text) <= width:
        assert short == text
