"""The pages of docs/methods are those that the methods make."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from msal_cli import methods

SCRIPT = Path(__file__).resolve().parents[1] / "docs" / "make_method_pages.py"


def loaded() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_method_pages", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MAKER = loaded()


def test_the_committed_pages_are_current() -> None:
    made, committed = MAKER.pages(), MAKER.committed()
    assert sorted(committed) == sorted(made), "run python docs/make_method_pages.py"
    for name, text in made.items():
        assert committed[name] == text, f"{name}: run python docs/make_method_pages.py"


def test_there_is_a_page_and_a_row_for_every_method() -> None:
    made = MAKER.pages()
    assert set(made) == {"README.md", *(f"{name}.md" for name in methods.names())}
    rows = re.findall(r"^\| \[`(\w+)`\]\((\w+)\.md\) \| .+ \| .+ \|$", made["README.md"], re.M)
    assert rows == [(name, name) for name in methods.names()]


@pytest.mark.parametrize("name", methods.names())
def test_a_page_tells_everything(name: str) -> None:
    text, method = MAKER.pages()[f"{name}.md"], methods.find(name)
    assert f"--method {name}\n" in text
    assert MAKER.inline(method.summary) in text
    assert text.rstrip().endswith(MAKER.inline(method.source))
    table = text.partition("## Parameters")[2].partition("## Source")[0]
    rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in table.splitlines() if line[:3] == "| `"]
    assert [re.findall(r"`(.+?)`", row[0])[0] for row in rows] == [
        spec.name for spec in method.parameters
    ]
    for row, spec in zip(rows, method.parameters, strict=True):
        assert len(row) == 5
        assert row[1].strip() == f"`{spec.default}`"
        assert MAKER.inline(spec.help) in row[3]
        assert row[4].strip() == MAKER.inline(spec.more)
    indented = re.findall(r"^\n((?: {4}.*\n)+)$", method.description, re.MULTILINE)
    formulas = [line.strip() for block in indented for line in block.splitlines()]
    blocks = "\n".join(re.findall(r"^```(?:sh)?\n(.*?)^```$", text, re.MULTILINE | re.DOTALL))
    assert all(formula in blocks for formula in formulas)


def test_markdown_is_escaped_outside_code() -> None:
    assert (
        MAKER.inline("mean|h| of p* and\n<b>, x_i <- y") == r"mean\|h\| of p\* and \<b>, x_i <- y"
    )
    assert MAKER.inline("``a|b*`` or ``al``") == "`a|b*` or `al`"


def test_names_of_other_methods_are_links() -> None:
    assert MAKER.inline("``al`` beats ``hc``, not ``hcx``", "al") == (
        "`al` beats [`hc`](hc.md), not `hcx`"
    )


def test_indented_blocks_are_formulas_and_dashes_are_lists() -> None:
    text = "First\nline:\n\n    a * b\n      c\n\n- one\n  more\n- two\n\n1.  up\n    to\n2. 3.4 x"
    assert list(MAKER.prose(text, "al")) == [
        "First line:\n",
        "```\na * b\n  c\n```\n",
        "- one more\n- two\n",
        "1. up to\n2. 3.4 x\n",
    ]
