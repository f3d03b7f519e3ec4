"""The site of docs/: its generated pages, its first page, and the checker of its links."""

from __future__ import annotations

import re
from pathlib import Path

import click
import pytest

import msal_cli as msal
from msal_cli.cli.main import program
from tests.scripts import load_script

pytestmark = pytest.mark.ci

DOCS = Path(__file__).resolve().parents[1] / "docs"
API = load_script("docs/make_api_page.py")
COMMANDS = load_script("docs/make_command_page.py")
CHECKER = load_script("docs/check_site.py")


@pytest.mark.parametrize("maker", [API, COMMANDS], ids=["api", "commands"])
def test_the_committed_page_is_current(maker):
    assert maker.PAGE.read_text("utf-8") == maker.page(), "run python docs/refresh.py"


def test_every_option_is_in_the_lists_of_its_command():
    sections = re.split(r"^## msal ", COMMANDS.page(), flags=re.MULTILINE)[1:]
    by_name = {text.split("\n")[0]: text for text in sections}
    context = click.Context(program)
    assert list(by_name) == program.list_commands(context)
    for name, text in by_name.items():
        command = program.get_command(context, name)
        options = [one for one in command.params if isinstance(one, click.Option)]
        for option in options:
            words = (*option.opts, *option.secondary_opts)
            assert option.hidden or any(f"`{word}" in text for word in words), (name, words)


def test_every_name_of_the_api_has_its_place():
    named = set(re.findall(r"^### `(\w+)`|^\| `([A-Z]\w*)` \|", API.page(), re.M))
    assert {one or other for one, other in named} >= set(msal.__all__) - {"__version__"}


def test_texts_of_help_become_markdown():
    assert COMMANDS.inline("with --in-place: a_b '*.ply', `a|b`") == (
        r"with `--in-place`: a\_b '\*.ply', `a|b`"
    )


def test_arguments_are_listed_once():
    def function():
        """What.

        Parameters
        ----------
        a : one
            two.
        b, c : three
        """

    seen = set()
    assert "- `a`: one two.\n- `b`, `c`: three\n" in API.describe(function, seen)
    assert "- `" not in API.describe(function, seen)


def test_the_first_page_leads_to_all_pages_in_few_groups():
    text = (DOCS / "index.md").read_text("utf-8")
    linked = {
        (DOCS / name).resolve() for name in re.findall(r"^- \[.*?\]\((\S+?\.md)\)", text, re.M)
    }
    assert linked == {*DOCS.glob("*.md"), *DOCS.glob("*/README.md")} - {DOCS / "index.md"}
    assert len(re.findall(r"^## ", text, re.M)) <= 7


def test_the_checker_finds_what_is_wrong(tmp_path):
    head = "<title>{}</title>"
    (tmp_path / "good.html").write_text(
        head.format("Good")
        + '<h1 id="top">x</h1><a href="#top"></a><a href="other.html#here"></a>'
        + '<a href="https://example.com/x"></a><img src="a.png" alt="A">'
    )
    (tmp_path / "other.html").write_text(head.format("Other") + '<p id="here">')
    (tmp_path / "a.png").write_bytes(b"")
    assert CHECKER.problems(tmp_path) == ([], {"example.com": 1})
    (tmp_path / "other.html").write_text(
        head.format("Good")
        + '<a href="gone.html"></a><a href="good.html#gone"></a><a href="../up"></a>'
        + '<img src="a.png"><script src="https://example.com/s.js"></script>'
    )
    found = "\n".join(CHECKER.problems(tmp_path)[0])
    for part in (
        "good.html: other.html#here has no such anchor",
        "other.html: gone.html leads nowhere",
        "other.html: good.html#gone has no such anchor",
        "other.html: ../up leads nowhere",
        "other.html: a.png has no alt text",
        "other.html: loads https://example.com/s.js from another host",
        "the title 'Good' is empty or that of another page",
    ):
        assert part in found
    assert CHECKER.problems(tmp_path / "none")[0]
