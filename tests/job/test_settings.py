"""Settings from what the command and the Python API are given."""

import pytest

from msal_cli import methods
from msal_cli.errors import UsageError
from msal_cli.job.settings import Settings, parse, resolve_parameters

MSAL, HC = map(methods.find, ("msal", "hc"))


def parsed(as_options=False, parameters=(), **given):
    return parse({**given, "parameters": parameters}, as_options=as_options)


def test_what_is_chosen_among():
    assert parsed() == parsed(method="adaptive") == Settings("adaptive")
    assert parsed(assume="noise").parameters == {"assume": "noise"}
    assert parsed(method=None, max_move=None, lock=()) == Settings("adaptive")
    assert parsed(strength=0) == Settings("adaptive")
    assert parsed(strength=1, keep="texture").parameters == {"strength": 1, "keep": "texture"}
    assert parsed(keep="shape").method == parsed(method="auto", assume="noise").method == "auto"
    wishes = {"keep": "edges", "strength": -1.5}
    expected = Settings("auto", wishes | {"assume": None})
    assert parsed(**wishes) == parsed(method="auto", **wishes) == expected
    settings = parsed(parameters=[("K", "K", 0.25)])
    assert (settings.method, settings.parameters["K"]) == ("msal", 0.25)


def test_values_become_those_of_settings():
    settings = parsed(
        max_move="1mm",
        lock="boundary",
        min_noise="auto",
        unit="cm",
        to=".PLY",
        intersections=True,
        fields=["sigma"],
    )
    assert settings == Settings(
        "adaptive",
        max_move="0.1",
        lock=("boundary",),
        min_noise="auto",
        to="ply",
        checks=("self-intersections",),
        fields=("sigma",),
        unit="cm",
    )


@pytest.mark.parametrize(
    ("given", "argument", "option"),
    [
        ({"keep": "looks"}, "keep = 'looks'", "--keep = 'looks'"),
        ({"max_move": 0}, "max_move 0.0: this is no length", "--max-move 0.0: this is no length"),
        ({"lock": ["a"]}, "lock a: this is neither", "--lock a: this is neither"),
        ({"to": "plz"}, "to plz: there is no such", "--to plz: there is no such"),
        ({"format": "x"}, "format x: there is no such", "--format x: there is no such"),
        ({"encoding": "zip"}, "encoding = 'zip'", "--encoding = 'zip'"),
        (
            {"method": "umbrella", "weights": "w"},
            "weights: a pull to the scanned positions is needed, and umbrella has none as it is",
            "--weights: a pull",
        ),
        ({"method": "hc", "weights": "w"}, "weights: a pull", "--weights: a pull"),
    ],
)
def test_messages_name_the_argument_or_the_option(given, argument, option):
    for as_options, words in ((False, argument), (True, option)):
        with pytest.raises(UsageError) as caught:
            parsed(as_options, **given)
        assert caught.value.message.startswith(words)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"method": "msal", "keep": "edges"}, "keep: this is for the automatic choice"),
        ({"assume": "noise", "parameters": [("K", "K", 1)]}, "K: 'adaptive' chooses"),
        ({"method": "auto", "parameters": [("K", "K", 1)]}, "K: 'auto' chooses"),
        ({"method": "adaptive", "parameters": [("K", "K", 1)]}, "K: 'adaptive' chooses"),
    ],
)
def test_a_choice_goes_with_neither_method_nor_parameters(given, words):
    with pytest.raises(UsageError, match=words):
        parsed(**given)


def given(*texts):
    """Assignments of ``--set``, or of an option that is written with its value."""
    return [
        (text, "iterations", text[3:])
        if text.startswith("-n ")
        else (f"--set {text}", *text.split("="))
        for text in texts
    ]


@pytest.mark.parametrize(
    ("method", "assignments", "words", "hint"),
    [
        (MSAL, given("-n 4", "n=5"), "-n 4 and --set n=5 give iterations two different", "once"),
        *((MSAL, given(f"K={k}"), "is not allowed", "0 < K <= 1") for k in ("0", "2", "nan", "x")),
        *((MSAL, given(f"n={n}"), f"= {n} is not allowed", "whole number") for n in ("1.5", "-1")),
        (MSAL, given("normals=angle"), "normals = angle is not allowed", "uniform | area"),
        (MSAL, given("iteratons=3"), "no parameter 'iteratons'", "iterations"),
        (HC, [("-K 1", "K", "1")], "hc has no parameter 'K'", "it has"),
    ],
)
def test_parameters_that_are_refused(method, assignments, words, hint):
    with pytest.raises(UsageError) as caught:
        resolve_parameters(method, assignments)
    assert words in caught.value.message
    assert hint in caught.value.hint
