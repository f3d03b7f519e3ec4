"""Values of options, and options that contradict or need each other."""

from __future__ import annotations

import click
import pytest

from msal_cli import methods
from msal_cli.cli import options
from msal_cli.errors import UsageError

SIZE = {"500M": 500 * 10**6, "500mb": 500 * 10**6, "2G": 2 * 10**9, "1.5GiB": 3 << 29}
DURATION = {"90": 90.0, "90s": 90.0, "1.5m": 90.0, "2h": 7200.0, ".5 h": 1800.0, "none": None}
VALUES = {
    options.parse_jobs: {"auto": None, "1": 1, "4096": 4096},
    options.parse_duration: DURATION,
    options.parse_size: {**SIZE, "64 MiB": 64 << 20, "none": None},
    options.parse_percentage: {"2%": 0.02, "0.5 %": 0.005},
    options.parse_list: {"a, b": ("a", "b")},
    options.parse_direction: {
        "-Y": (0.0, -1.0, 0.0),
        "+x": (1.0, 0.0, 0.0),
        "0,-1,0.5": (0.0, -1.0, 0.5),
    },
    options.number(0.0, 9.0, "e"): {"2": 2.0, "2e": 2.0, "-0": 0.0},
}
REFUSED = {
    options.parse_jobs: ("0", "-1", "4097", "1.5", "", "Auto", "²", "9" * 5000),
    options.parse_duration: ("", "x", "-1", "0", "0s", "1e9", "5 parsecs", "inf", "nan", "٣"),
    options.parse_size: ("", "500", "0M", "-2G", "2GG", "1e3M", "0.0000001K", "M"),
    options.parse_percentage: ("", "2", "-1%", "x%", "٣%"),
    options.parse_direction: ("w", "1,2", "nan,0,1", "0,0,0", "inf,0,0", "1e200,0,0"),
    options.number(-2.0, 2.0): ("", "x", "2.5", "-3", "nan", "inf"),
    options.number(): ("nan", "inf", "-inf"),
}


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [(parse, *pair) for parse, values in VALUES.items() for pair in values.items()],
)
def test_values(parse, text, value):
    assert parse(text) == value
    assert str(parse(text)) == str(value)


@pytest.mark.parametrize(
    ("parse", "text"), [(parse, text) for parse, texts in REFUSED.items() for text in texts]
)
def test_values_that_are_refused(parse, text):
    with pytest.raises(click.BadParameter) as caught:
        parse(text)
    assert repr(text) in caught.value.message


def test_the_methods_found_without_importing_them_are_the_methods():
    assert options.list_methods() == methods.names()
    assert options.complete_method(None, None, "ms") == ["msal"]


@pytest.mark.parametrize("text", ["0", "-1", "two", "1.5"])
def test_a_number_of_threads_that_is_none_is_refused(text, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", text)
    with pytest.raises(UsageError, match="MSAL_THREADS"):
        options.check_threads_variable()
    monkeypatch.setenv("MSAL_THREADS", "3")
    options.check_threads_variable()


@pytest.mark.parametrize("text", ["K", "=1", "K=", " = ", ""])
def test_no_assignment(text):
    with pytest.raises(UsageError, match="is not NAME=VALUE"):
        options.parse_assignment(text)


def test_the_shortcuts_are_parameters_of_methods():
    words = {spec.name for name in methods.names() for spec in methods.find(name).parameters}
    assert set(options.SHORTCUTS) <= words
