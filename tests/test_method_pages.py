"""The pages of docs/methods are those that the methods make."""

from __future__ import annotations

import re

from msal_cli import methods
from tests.scripts import load_script

MAKER = load_script("docs/make_method_pages.py")


def test_the_committed_pages_are_current() -> None:
    made, committed = MAKER.pages(), MAKER.committed()
    assert sorted(committed) == sorted(made), "run python docs/make_method_pages.py"
    for name, text in made.items():
        assert committed[name] == text, f"{name}: run python docs/make_method_pages.py"


def test_there_is_a_page_and_a_row_for_every_method() -> None:
    made = MAKER.pages()
    assert set(made) == {"README.md", *(f"{name}.md" for name in methods.names())}
    rows = re.findall(r"^\| \[`(\w+)`\]\((\w+)\.md\) \| .+ \|$", made["README.md"], re.M)
    assert rows == [(name, name) for name in methods.names()]


def test_markdown_is_escaped_outside_code() -> None:
    assert (
        MAKER.inline("mean|h| of p* and\n<b>, x_i <- y") == r"mean\|h\| of p\* and \<b>, x_i <- y"
    )
    assert MAKER.inline("``a|b*`` or ``al``") == "`a|b*` or `al`"


def test_indented_blocks_are_formulas_and_dashes_are_lists() -> None:
    text = "First\nline:\n\n    a * b\n      c\n\n- one\n  more\n- two\n\n1.  up\n    to\n2. 3.4 x"
    assert list(MAKER.prose(text, "al")) == [
        "First line:\n",
        "```\na * b\n  c\n```\n",
        "- one more\n- two\n",
        "1. up to\n2. 3.4 x\n",
    ]
