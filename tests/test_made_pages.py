"""Pages and schemas that scripts make from the code, and the site."""

from __future__ import annotations

import re
import shutil
import subprocess

import pytest

from benchmarks import scanner_cases
from tests.files import ROOT, load_script

DOCS = ROOT / "docs"
API, COMMAND, MAN, METHOD, SCHEMA = (
    load_script(f"docs/make_{name}.py")
    for name in ("api_page", "command_page", "man_pages", "method_pages", "schemas")
)
CHECKER = load_script("docs/check_site.py")


def test_the_committed_pages_are_current(tmp_path):
    makers = [(maker.pages(), maker.committed()) for maker in (MAN, METHOD)]
    for maker in (API, COMMAND):
        makers.append(({"page": maker.page()}, {"page": maker.PAGE.read_text("utf-8")}))
    SCHEMA.main(tmp_path)
    schemas = (tmp_path.iterdir(), DOCS.glob("*.schema.json"))
    makers.append(
        tuple({path.name: path.read_text("utf-8") for path in paths} for paths in schemas)
    )
    for made, committed in makers:
        assert sorted(committed) == sorted(made), "run python docs/refresh.py"
        for name, text in made.items():
            assert committed[name] == text, f"{name}: run python docs/refresh.py"


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_roff_has_no_warnings():
    for name, text in MAN.pages().items():
        words = ["groff", "-ww", "-man", "-Tutf8"]
        made = subprocess.run(words, input=text, capture_output=True, text=True, check=True)
        assert made.stderr == "", name
        assert "msal" in made.stdout


def test_the_first_page_leads_to_all_pages_in_few_groups():
    text = (DOCS / "index.md").read_text("utf-8")
    linked = {
        (DOCS / name).resolve() for name in re.findall(r"^- \[.*?\]\((\S+?\.md)\)", text, re.M)
    }
    assert linked == {*DOCS.glob("*.md"), *DOCS.glob("*/README.md")} - {DOCS / "index.md"}
    assert len(re.findall(r"^## ", text, re.M)) <= 7


def test_the_checker_finds_what_is_wrong(tmp_path):
    (tmp_path / "good.html").write_text(
        '<title>Good</title><h1 id="top">x</h1><a href="#top"></a><a href="other.html#here"></a>'
        '<a href="https://example.com/x"></a><img src="a.png" alt="A">'
    )
    (tmp_path / "other.html").write_text('<title>Other</title><p id="here">')
    (tmp_path / "a.png").write_bytes(b"")
    assert CHECKER.problems(tmp_path) == ([], {"example.com": 1})
    (tmp_path / "other.html").write_text(
        '<title>Good</title><a href="gone.html"></a><a href="good.html#gone"></a>'
        '<a href="../up"></a><img src="a.png"><script src="https://example.com/s.js"></script>'
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


LARGEST_PICTURE = 150_000


def rows_of(page: str, name: str) -> list[str]:
    """The rows of a made table, without its head."""
    text = (DOCS / page).read_text("utf-8")
    place = re.search(rf"<!-- made: {name} -->\n(.*?)<!-- end -->", text, re.DOTALL)
    assert place is not None
    return place[1].splitlines()[2:]


def test_every_example_has_its_row_and_picture(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    from scanner_examples import EXAMPLES

    pictures = [f"images/scanners/{example.name}.png" for example in EXAMPLES]
    rows = rows_of("noise.md", "your scanner")
    for example, row, picture in zip(EXAMPLES, rows, pictures, strict=True):
        assert all(part in row for part in (example.scanner, example.noise, example.does, picture))
        assert (DOCS / picture).stat().st_size < LARGEST_PICTURE
    assert {path.name for path in (DOCS / "images/scanners").iterdir()} == {
        picture.rpartition("/")[2] for picture in pictures
    }


def test_the_page_of_accuracy_has_every_kind():
    table = "\n".join(rows_of("accuracy.md", "scanners"))
    kinds = re.findall(r"^\| ([^|]+) \(\d+\) \|", table, re.MULTILINE)
    assert kinds == [*scanner_cases.ADDED, *scanner_cases.SIMULATED, *scanner_cases.REAL]
