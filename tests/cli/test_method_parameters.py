"""--set and its shortcuts."""

from __future__ import annotations

import pytest

from msal_cli import methods
from msal_cli.cli.method_parameters import parse_assignment, resolve
from msal_cli.errors import UsageError

MSAL = methods.find("msal")


def test_everything_is_settled_and_what_is_given_counts():
    values = resolve(MSAL, [parse_assignment("K=0.25"), ("-n 7", "iterations", "7")])
    assert values["K"] == 0.25
    assert values["iterations"] == 7
    assert set(values) == {spec.name for spec in MSAL.parameters}


def test_symbols_are_names_too():
    assert resolve(MSAL, [parse_assignment("n=9")])["iterations"] == 9


@pytest.mark.parametrize("text", ["K", "=1", "K=", " = ", ""])
def test_no_assignment(text):
    with pytest.raises(UsageError, match="is not NAME=VALUE"):
        parse_assignment(text)


def test_the_same_value_twice_is_no_contradiction():
    assert resolve(MSAL, [parse_assignment("K=0.5"), ("-K .50", "K", ".50")])["K"] == 0.5


@pytest.mark.parametrize("second", [parse_assignment("iterations=5"), parse_assignment("n = 5")])
def test_two_values_for_one_parameter(second):
    with pytest.raises(UsageError, match=r"-n 4 and --set \S+.* give iterations two different"):
        resolve(MSAL, [("-n 4", "iterations", "4"), second])


@pytest.mark.parametrize("given", ["K=2", "K=nan", "iterations=1.5", "iterations=-1", "normals=x"])
def test_values_that_are_not_allowed(given):
    with pytest.raises(UsageError, match="is not allowed"):
        resolve(MSAL, [parse_assignment(given)])


def test_unknown_parameters_get_a_suggestion():
    with pytest.raises(UsageError, match="no parameter 'iteratons'") as caught:
        resolve(MSAL, [parse_assignment("iteratons=3")])
    assert "iterations" in caught.value.hint


def test_a_shortcut_that_a_method_lacks_names_the_methods_that_have_it():
    with pytest.raises(UsageError, match="-K 1 does not go with hc, which has no para") as caught:
        resolve(methods.find("hc"), [("-K 1", "K", "1")])
    assert "msal" in caught.value.hint
    with pytest.raises(UsageError, match="--schedule plain does not go with hc") as caught:
        resolve(methods.find("hc"), [("--schedule plain", "schedule", "plain")])
    assert {"al,", "msal,", "umbrella"} <= set(caught.value.hint.split())
    assert not {"hc", "taubin"} & set(caught.value.hint.replace(",", "").split())


def test_values_are_held_against_one_another_only_together():
    # lambda = 0.1 does not go with mu = -1, but each goes with something.
    taubin = methods.find("taubin")
    with pytest.raises(UsageError, match=r"lambda = 0\.1 and mu = -1 amplify") as caught:
        resolve(taubin, [parse_assignment("lambda=0.1"), parse_assignment("mu=-1")])
    assert "-0.106" in caught.value.hint
    values = resolve(taubin, [parse_assignment("mu=-0.106"), parse_assignment("lambda=0.1")])
    assert (values["shrink"], values["inflate"]) == (0.1, -0.106)
