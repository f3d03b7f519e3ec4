"""Records become plain data and come back, as do names; errors survive pickling."""

import json
import os
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

import msal_cli
from msal_cli import errors
from msal_cli.job import records
from msal_cli.job.display_names import (
    columns,
    escape_for_display,
    portable,
    restore_name,
    shorten_name,
)
from msal_cli.job.records import as_data, from_data
from tests.report.made import failed, gated


def test_a_record_survives_json():
    record = gated(warnings=("one", "two"), error=failed().error)
    assert from_data(records.MeshRecord, json.loads(json.dumps(as_data(record)))) == record
    # Unknown fields of later versions are dropped.
    assert from_data(records.MeshRecord, as_data(record) | {"from_the_future": 1}) == record
    info = records.InfoRecord(
        "a.ply", bounds=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), polygon_sizes={"3": 7}
    )
    assert from_data(records.InfoRecord, json.loads(json.dumps(as_data(info)))) == info


PUBLIC = [getattr(msal_cli, name) for name in msal_cli.__all__]
ERRORS = [one for one in PUBLIC if isinstance(one, type) and issubclass(one, errors.MsalError)]


@pytest.mark.parametrize("kind", ERRORS)
def test_errors_survive_pickling_and_stand_in_the_tree(kind):
    error = kind("what", where="vertex 3", hint="do this", path="a.ply", code="E_OTHER")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind
    assert vars(again) == vars(error)
    assert str(again) == "what"
    assert kind.__name__ in errors.__doc__
    assert kind("what").code.startswith("E_")


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
    [("扫描 é.ply", "扫描 é.ply"), ("a\nb\r\t", "a\\nb\\r\\t"), ("\x1b[31mred", "\\x1b[31mred")]
    + [("a\udcff", "a\\xff"), ("gpj\u202eexe", "gpj\\u202eexe")]
    + [("\U000e0041", "\\U000e0041")],
)
def test_what_people_see(text, said):
    assert escape_for_display(text) == said


@given(ANY_TEXT, st.integers(3, 30))
def test_shortened_fits_and_keeps_the_end(text, width):
    short = shorten_name(text, width)
    assert columns(short) <= width
    assert text.endswith(short.removeprefix("...")) or short == text
    if columns(text) <= width:
        assert short == text
