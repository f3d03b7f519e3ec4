"""Values of options."""

from __future__ import annotations

import click
import pytest

from msal_cli import methods
from msal_cli.cli import words
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
