"""The man pages are those that the options make, and roff has nothing to say against them."""

from __future__ import annotations

import re
import shutil
import subprocess
import tomllib

import click
import pytest

from msal_cli.cli import console
from msal_cli.cli.main import COMMANDS, program
from tests.scripts import ROOT, load_script

MAKER = load_script("docs/make_man_pages.py")
PAGES = MAKER.pages()


def test_the_committed_pages_are_current() -> None:
    committed = MAKER.committed()
    assert sorted(committed) == sorted(PAGES), "run python docs/make_man_pages.py"
    for name, text in PAGES.items():
        assert committed[name] == text, f"{name}: run python docs/make_man_pages.py"


def test_there_is_a_page_for_every_command_and_a_wheel_installs_them() -> None:
    assert set(PAGES) == {"msal.1", *(f"msal-{name}.1" for name in COMMANDS)}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    wheel = project["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert wheel["shared-data"] == {"docs/man": "share/man/man1"}
    assert {path.suffix for path in (ROOT / "docs/man").iterdir()} == {".1"}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_page_has_every_option_and_every_group(name: str) -> None:
    text = plain(PAGES[f"msal-{name}.1"])
    command = program.get_command(click.Context(program), name)
    assert command is not None
    for option in command.params:
        if isinstance(option, click.Option) and not option.hidden:
            assert " ".join(str(option.help).split()) in text
            assert all(re.search(rf"(?m)^.*{re.escape(one)}(?![\w-])", text) for one in option.opts)
    sections = re.findall(r"^\.SH (.+)$", text, re.M)
    assert sections[:4] == ["NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS"]
    assert sections[-1] == "SEE ALSO"
    assert ".SS Messages and help\n" in text


def test_the_statuses_are_those_of_the_program() -> None:
    part = plain(PAGES["msal.1"]).partition(".SH EXIT STATUS")[2].partition("\n.SH")[0]
    listed = {int(one) for one in re.findall(r"^(\d+)$", part, re.M)}
    known = {v for k, v in vars(console).items() if k.isupper() and isinstance(v, int)}
    assert listed == known - {console.INTERRUPTED}
    assert "128 + n" in part


def plain(page: str) -> str:
    """A page without fonts and escapes."""
    text = re.sub(r"\\f[BIR]", "", page)
    for escaped, one in ((r"\-", "-"), (r"\(aq", "'"), (r"\(ga", "`"), (r"\(ha", "^"), (r"\&", "")):
        text = text.replace(escaped, one)
    return text.replace(r"\(ti", "~").replace(r"\e", "\\")


@pytest.mark.parametrize("name", PAGES)
def test_lines_are_requests_or_text(name: str) -> None:
    known = (".TH", ".SH", ".SS", ".TP", ".PP", ".B", ".BR", ".nf", ".fi")
    for line in PAGES[name].splitlines():
        assert not line.startswith(".") or line.split()[0] in known, line
        assert line.strip() and not line.startswith("'")


def test_a_text_is_no_request() -> None:
    assert MAKER.escape(".SH x") == r"\&.SH x"
    assert MAKER.escape("'tis a-b\\n") == r"\(aqtis a\-b\en"


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_roff_has_no_warnings() -> None:
    for name, text in PAGES.items():
        words = ["groff", "-ww", "-man", "-Tutf8"]
        made = subprocess.run(words, input=text, capture_output=True, text=True, check=True)
        assert made.stderr == "", name
        assert "msal" in made.stdout
