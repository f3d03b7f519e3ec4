"""`msal methods`: everything that the methods say of themselves."""

from __future__ import annotations

import dataclasses
import json

import pytest

from msal_cli import methods
from tests.cli.scans import msal


def test_the_table_names_every_method():
    made = msal("methods")
    assert made.exit_code == 0
    for name in methods.names():
        assert f"{name} " in made.stdout
        assert methods.find(name).summary in made.stdout


@pytest.mark.parametrize("name", methods.names())
def test_a_page_tells_parameters_ranges_directions_and_source(name):
    method = methods.find(name)
    made = msal("methods", name)
    assert made.exit_code == 0
    assert made.stdout.startswith(f"{name}: {method.summary}")
    assert method.source[:20] in made.stdout
    for spec in method.parameters:
        assert f"  {spec.name} = {spec.default}" in made.stdout
        assert spec.help in made.stdout
        assert f"allowed: {spec.range_text}" in made.stdout
        assert not spec.more or f"more is {spec.more}" in made.stdout
        also = {"iterations": "-n", "mollify": "--mollify", "schedule": "--schedule"}.get(spec.name)
        assert not also or f"  {spec.name} = {spec.default}   (also {also}" in made.stdout


def test_json():
    made = msal("methods", "--json")
    data = json.loads(made.stdout)
    assert data["schema"] == "msal.methods/1"
    assert [one["name"] for one in data["methods"]] == list(methods.names())
    (one,) = json.loads(msal("methods", "msal", "--json").stdout)["methods"]
    factor = next(spec for spec in one["parameters"] if spec["name"] == "K")
    assert (factor["low"], factor["high"], factor["low_open"]) == (0.0, 1.0, True)
    assert (factor["kind"], factor["default"]) == ("float", 0.5)


def test_a_range_without_an_end_is_null_in_json(monkeypatch):
    spec = dataclasses.replace(methods.find("msal").parameters[0], high=float("inf"))
    monkeypatch.setattr(methods.Method, "parameters", [spec])
    (one,) = json.loads(msal("methods", "msal", "--json").stdout)["methods"]
    assert one["parameters"][0]["high"] is None


def test_an_unknown_method_gets_a_suggestion():
    made = msal("methods", "msl")
    assert (made.exit_code, made.stdout) == (2, "")
    assert made.stderr == "msal: error: there is no method 'msl'\nhint: did you mean msal?\n"
