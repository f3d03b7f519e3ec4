"""Values of options."""

from __future__ import annotations

import click
import pytest

from msal_cli import methods
from msal_cli.cli import option_types as words
from msal_cli.errors import UsageError


def test_the_methods_found_without_importing_them_are_the_methods():
    assert words.method_names() == methods.names()
    assert words.completed_method(None, None, "ms") == ["msal"]


@pytest.mark.parametrize(("text", "number"), [("auto", None), ("1", 1), ("4096", 4096)])
def test_jobs(text, number):
    assert words.jobs(None, None, text) == number


@pytest.mark.parametrize("text", ["0", "-1", "4097", "1.5", "", "Auto", "²", "9" * 5000])
def test_no_jobs(text):
    with pytest.raises(click.BadParameter, match="neither auto nor a whole number"):
        words.jobs(None, None, text)


def test_formats_in_any_spelling():
    def known():
        return (".ply", "obj")

    assert words.settled_format(None, None, "--to") is None
    assert words.settled_format("PLY", known, "--to") == "ply"
    assert words.settled_format(".Obj", known, "--to") == "obj"
    with pytest.raises(UsageError, match="--to plx: there is no such format") as caught:
        words.settled_format("plx", known, "--to")
    assert caught.value.hint == "did you mean ply?"
    with pytest.raises(UsageError) as caught:
        words.settled_format("zzz", known, "--to")
    assert caught.value.hint == "known are: ply, obj"


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("90", 90.0), ("90s", 90.0), ("1.5m", 90.0), ("2h", 7200.0), (".5 h", 1800.0), ("none", None)],
)
def test_durations(text, seconds):
    assert words.duration(None, None, text) == seconds


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("500M", 500 * 10**6),
        ("500mb", 500 * 10**6),
        ("2G", 2 * 10**9),
        ("1.5GiB", 3 << 29),
        ("64 MiB", 64 << 20),
        ("none", None),
    ],
)
def test_sizes(text, count):
    assert words.size(None, None, text) == count


@pytest.mark.parametrize("text", ["", "x", "-1", "0", "0s", "1e9", "5 parsecs", "inf", "nan", "٣"])
def test_no_duration(text):
    with pytest.raises(click.BadParameter, match="is not a time"):
        words.duration(None, None, text)


@pytest.mark.parametrize("text", ["", "500", "0M", "-2G", "2GG", "1e3M", "0.0000001K", "M"])
def test_no_size(text):
    with pytest.raises(click.BadParameter, match="is not a size"):
        words.size(None, None, text)


@pytest.mark.parametrize("text", ["", "-1", "1.0", "x", "²"])
def test_no_count(text):
    with pytest.raises(click.BadParameter, match="is not a whole number from 1 up"):
        words.count_from(1)(None, None, text)
    assert words.count_from(0)(None, None, "0") == 0


def test_a_count_of_too_many_digits_is_named_as_one():
    with pytest.raises(click.BadParameter, match="has more than 15 digits"):
        words.count_from(1)(None, None, "9" * 16)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("w", "neither an axis"),
        ("1,2", "neither an axis"),
        ("nan,0,1", "neither an axis"),
        ("0,0,0", "no length"),
        ("inf,0,0", "no length"),
        ("1e200,0,0", "no length"),
    ],
)
def test_no_direction(text, named):
    with pytest.raises(click.BadParameter, match=named):
        words.direction(None, None, text)


def test_an_axis_may_have_a_sign():
    assert words.direction(None, None, "-Y") == (0.0, -1.0, 0.0)
    assert words.direction(None, None, "+x") == (1.0, 0.0, 0.0)
    assert words.direction(None, None, "0,-1,0.5") == (0.0, -1.0, 0.5)


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5"])
def test_a_number_of_threads_that_is_none_is_refused(text, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", text)
    with pytest.raises(UsageError, match="MSAL_THREADS"):
        words.check_threads_variable()
    monkeypatch.setenv("MSAL_THREADS", "3")
    words.check_threads_variable()
