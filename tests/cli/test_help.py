"""Help in groups, what shells complete, and what the methods say of themselves."""

from __future__ import annotations

import json
import shutil
import subprocess

import click
import pytest

from msal_cli import methods
from msal_cli.cli.command import Command, first_clause
from msal_cli.cli.main import COMMANDS, program
from tests.cli.scans import msal


def find_command(name: str) -> tuple[Command, click.Context]:
    command = program.get_command(click.Context(program), name)
    assert isinstance(command, Command)
    parent = click.Context(program, info_name="msal", help_option_names=["-h", "--help"])
    return command, click.Context(command, parent, info_name=name)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_in_exactly_one_group(name):
    command, context = find_command(name)
    grouped = [one for _, options in command.grouped_options(context) for one in options]
    shown = [
        one
        for one in command.get_params(context)
        if isinstance(one, click.Option) and not one.hidden
    ]
    assert sorted(one.opts for one in grouped) == sorted(one.opts for one in shown)
    titles = [title for title, _ in command.grouped_options(context)]
    assert len(set(titles)) == len(titles)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_short_help_fits_a_screen(name, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    shown = msal(name, "--help").stdout
    assert len(shown.splitlines()) <= 56, shown
    assert max(map(len, shown.partition("Examples:")[0].splitlines())) <= 80


@pytest.mark.parametrize(
    ("text", "short"),
    [
        ("File or folder; a folder gets a tree. More.", "File or folder."),
        ("Sweeps.  [default: 4]", "Sweeps.  [default: 4]"),
        ("Of mm, m, in, ... Then lengths. More.", "Of mm, m, in, ... Then lengths."),
        ("Noise of 0.3 and more. And.", "Noise of 0.3 and more."),
        ("One.  [default: " + "long " * 9 + "]", "One."),
    ],
)
def test_the_first_clause(text, short):
    assert first_clause(text) == short


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script(shell):
    made = msal("completion", shell)
    assert made.exit_code == 0
    assert f"_MSAL_COMPLETE={shell}_complete" in made.stdout
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=made.stdout, text=True, check=True)


@pytest.mark.parametrize(
    ("words", "answers"),
    [
        (["msal", ""], {"plain,denoise", "plain,info", "plain,methods", "plain,completion"}),
        (["msal", "de"], {"plain,denoise"}),
        (["msal", "methods", "ms"], {"plain,msal"}),
        (["msal", "denoise", "--method", ""], {"plain,al", "plain,msal"}),
        (["msal", "denoise", "--enc"], {"plain,--encoding"}),
        (["msal", "denoise", "--encoding", "a"], {"plain,ascii"}),
        (["msal", "denoise", "-o", "x"], {"file,x"}),
        (["msal", "denoise", "sc"], {"file,sc"}),
    ],
)
def test_what_bash_is_answered(words, answers, monkeypatch):
    monkeypatch.setenv("_MSAL_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", " ".join(words))
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    assert answers <= set(msal().stdout.splitlines())


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
