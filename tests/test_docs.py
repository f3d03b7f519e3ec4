"""The pages say what the program does, and those that scripts make from the code are current."""

import dataclasses
import re
import shlex
import shutil
import subprocess
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from click.exceptions import Exit

from benchmarks import scanner_cases
from msal_cli.cli import command as commands
from msal_cli.cli.main import program
from msal_cli.job import records
from msal_cli.job.records import InfoRecord, Run
from msal_cli.report.facts import Totals
from tests.cli.scans import msal
from tests.files import ROOT, load_script

refresh = load_script("docs/refresh.py")
README = ROOT / "README.md"
PAGES = (README, ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md")))
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
OPTION = re.compile(r"(?<![\w-])(--[a-z][a-z-]*|-[a-zA-Z])(?![\w-])")
PLACEHOLDERS = {"INPUT...": "in.ply", "SHELL": "bash", "[NAME]": "al", "NAME": "al"}


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def shell_lines(text: str) -> Iterator[str]:
    """Lines of the shell blocks and inline code that calls msal, comments cut off."""
    for language, body in FENCE.findall(text):
        if language == "sh":
            yield from body.replace("\\\n", " ").splitlines()
    prose = FENCE.sub("", text)
    yield from re.findall(r"`((?:python -m msal_cli|msal) [^`]+)`", prose)


def msal_commands(text: str) -> Iterator[list[str]]:
    """The arguments of every call of msal in a page."""
    for line in shell_lines(text):
        lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>")
        lexer.whitespace_split = True
        call: list[str] | None = None
        skip = False
        for word in (*lexer, ";"):
            if set(word) <= set("|&;"):
                if call is not None:
                    yield [PLACEHOLDERS.get(word, word) for word in call]
                call = None
            elif set(word) <= set("<>"):
                skip = True
            elif skip:
                skip = False
            elif call is not None:
                call.append(word)
            elif word == "msal" or word.endswith(("/msal", "msal_cli")):
                call = []


PROSE = [call for p in PAGES for call in msal_commands(FENCE.sub("", p.read_text("utf-8")))]
COMMANDS = [(name_of(p), call) for p in PAGES for call in msal_commands(p.read_text("utf-8"))]


def all_commands() -> dict[str, click.Command]:
    context = click.Context(program)
    found = {name: program.get_command(context, name) for name in program.list_commands(context)}
    return {name: command for name, command in found.items() if command is not None}


def options_of(command: click.Command) -> set[str]:
    with click.Context(command, help_option_names=["-h", "--help"]) as context:
        given = [
            option for option in command.get_params(context) if isinstance(option, click.Option)
        ]
    return {word for option in given for word in (*option.opts, *option.secondary_opts)}


def all_options() -> set[str]:
    return set().union(options_of(program), *map(options_of, all_commands().values()))


@pytest.mark.parametrize(("page", "call"), COMMANDS, ids=lambda v: v if isinstance(v, str) else "")
def test_every_documented_command_parses(
    page: str, call: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The files of --config are not here.
    monkeypatch.setattr(commands, "read_config", lambda path, *given, **named: {})
    if call and not call[0].startswith("-"):
        assert call[0] in all_commands(), f"{page}: msal {shlex.join(call)}"
        command, words = all_commands()[call[0]], call[1:]
    else:
        command, words = program, call
    parent = click.Context(program, info_name="msal", **program.context_settings)
    try:
        command.make_context(call[0] if call else "msal", list(words), parent=parent)
    except Exit as ending:
        assert ending.exit_code == 0
    except click.MissingParameter:
        # Running text may speak of `msal info --json`; what stands in a block can be pasted.
        assert call in PROSE, f"{page}: msal {shlex.join(call)} lacks an argument"
    except click.UsageError as error:
        pytest.fail(f"{page}: msal {shlex.join(call)}: {error.format_message()}")


def test_the_page_of_commands_documents_every_option() -> None:
    text = FENCE.sub("", (ROOT / "docs/commands.md").read_text("utf-8"))
    explained = {word for span in re.findall(r"`([^`\n]+)`", text) for word in OPTION.findall(span)}
    assert all_options() - explained - {"--version"} == set()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_documented_option_exists(page: Path) -> None:
    prose = FENCE.sub("", page.read_text("utf-8"))
    code = [span for span in re.findall(r"`([^`\n]+)`", prose) if span.startswith(("-", "msal "))]
    named = {word for span in code for word in OPTION.findall(span)}
    assert named - all_options() == set()


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page: Path) -> None:
    text = FENCE.sub("", page.read_text("utf-8"))
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), f"{name_of(page)} links to {target}"
        if anchor:
            assert anchor in anchors(there), f"{name_of(page)} links to {target}"
        if there.suffix == ".png":
            assert there.stat().st_size < 300_000, target


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as code hosts make them."""
    headings = re.findall(r"^#+ +(.+)$", FENCE.sub("", page.read_text("utf-8")), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.strip().replace(" ", "-") for heading in plain}


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_outputs_are_real_and_msal_is_installed_from_where_it_is(
    page: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(refresh, "printed", lambda words: msal(*shlex.split(words)).stdout)
    text = page.read_text("utf-8")
    assert refresh.refreshed(text) == text, "run python docs/refresh.py"
    # Nor from an index under another name, by another installer, or without quotes.
    asked = re.findall(r"(?:pip|uv|pipx|conda) install ([^\n`&]*)", text)
    installs = [words for words in asked if "msal" in words and not words.startswith("./")]
    assert all(refresh.source() in words for words in installs), installs


def fields(kind: type[Any], prefix: str = "") -> set[str]:
    """Names of a record's fields; those of an inner record follow with a dot."""
    names = set()
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        names.add(prefix + field.name)
        for inner in typing.get_args(hints[field.name]):
            if dataclasses.is_dataclass(inner) and not prefix and kind is records.MeshRecord:
                names |= fields(typing.cast("type[Any]", inner), f"{field.name}.")
    return names


def test_report_page_has_every_field_and_no_other() -> None:
    text = (ROOT / "docs/report.md").read_text("utf-8")
    sections = re.split(r"^#+ ", text, flags=re.MULTILINE)

    def assert_lists(expected: set[str], *titles: str) -> None:
        parts = [part for part in sections if part.partition("\n")[0] in titles]
        assert len(parts) == len(titles)
        items = re.findall(r"^- (`[^:]+`): ", "\n".join(parts), re.M)
        listed = {name for item in items for name in re.findall(r"`([^`]+)`", item)}
        assert listed <= expected
        assert expected <= {name for part in parts for name in re.findall(r"`([\w.]+)`", part)}

    kinds = {name.partition(".")[0] for name in fields(records.MeshRecord) if "." in name}
    inner = [f"`{kind}`" for kind in kinds]
    assert_lists(fields(records.MeshRecord), "The record", *inner)
    assert_lists(fields(InfoRecord), "`msal info --json`")
    assert_lists(fields(Totals), "`totals`")
    assert_lists(fields(Run) | {"schema", "totals", "records"}, "The run (JSON only)")


def test_every_error_code_is_documented() -> None:
    used = set()
    for path in (ROOT / "msal_cli").rglob("*.py"):
        used |= set(re.findall(r"\"(E_[A-Z_]+)\"", path.read_text("utf-8")))
    text = (ROOT / "docs/formats.md").read_text("utf-8")
    listed = set(re.findall(r"^- `(E_[A-Z_]+)`: ", text, re.MULTILINE))
    assert listed == used


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
        assert (DOCS / picture).stat().st_size < 150_000
    assert {path.name for path in (DOCS / "images/scanners").iterdir()} == {
        picture.rpartition("/")[2] for picture in pictures
    }


def test_the_page_of_accuracy_has_every_kind():
    table = "\n".join(rows_of("accuracy.md", "scanners"))
    kinds = re.findall(r"^\| ([^|]+) \(\d+\) \|", table, re.MULTILINE)
    assert kinds == [*scanner_cases.ADDED, *scanner_cases.SIMULATED, *scanner_cases.REAL]
