"""Help in groups: short by default, everything with ``--help-all``."""

from __future__ import annotations

import click
import pytest

from msal_cli.cli.command import Command, first_clause
from msal_cli.cli.main import COMMANDS, program
from tests.cli.scans import msal, process

BRIEF = ("methods", "completion")
"""Commands whose short help leaves nothing out."""


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
def test_the_short_help_fits_a_screen(name):
    shown = process(name, "--help", env={"COLUMNS": "80"}).stdout.decode()
    assert len(shown.splitlines()) <= 56, shown
    assert max(map(len, shown.partition("Examples:")[0].splitlines())) <= 80


def test_the_help_of_denoise_is_short_and_names_the_rest():
    short = process("denoise", "-h", env={"COLUMNS": "80"}).stdout.decode()
    assert len(short.splitlines()) <= 48
    assert "more options: msal denoise --help-all\n" in short
    for title in ("Input and output:", "What to do:", "Automatic choice:", "Limits on movement:"):
        assert f"\n{title}\n" in short
    assert "--scheduler" not in short and "--method" in short


@pytest.mark.parametrize("name", COMMANDS)
def test_help_all_shows_every_option_with_its_whole_text(name):
    command, context = find_command(name)
    shown = msal(name, "--help-all").stdout
    words = " ".join(shown.split())
    for parameter in command.get_params(context):
        if isinstance(parameter, click.Option) and not parameter.hidden:
            assert all(opt in words for opt in parameter.opts)
            assert " ".join(str(parameter.help).split()) in words
    assert ("--help-all" in words) == (name not in BRIEF)


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


def test_a_shell_is_told_the_first_clause_and_knows_every_option():
    made = process(
        env={
            "_MSAL_COMPLETE": "zsh_complete",
            "COMP_WORDS": "msal denoise --output",
            "COMP_CWORD": "2",
        }
    )
    assert made.stdout.decode() == "plain\n--output\nFile or folder to write.\n"
