"""Markdown that GitHub takes, in which names are text and the worst comes first; JUnit XML."""

import re
from xml.etree import ElementTree as Xml

import pytest
from hypothesis import given
from markdown_it import MarkdownIt

from msal_cli.job.records import Failure
from msal_cli.report import build_services
from tests.report.made import HOSTILE_NAMES, RECORDS, RUN, failed, gated, written

OURS = {"code", "/code", "details", "/details", "summary", "/summary"}


def text(records):
    return build_services.render_markdown(RUN, records).decode()


def tables(page):
    """The tables as rows of texts; fails for any markup that is not the report's own."""
    found, cells = [], None
    for token in MarkdownIt("gfm-like", {"linkify": False}).parse(page):
        if token.type == "html_block":
            tags = re.findall(r"<([^\s>]*)", token.content)
            assert set(tags) <= OURS, token.content
        if token.type == "table_open":
            found.append([])
        if token.type == "tr_open":
            found[-1].append([])
        if token.type == "inline":
            cells = "".join(map(plain, token.children))
            if token.level > 2 and found:
                found[-1][-1].append(cells)
    return found


def plain(token):
    assert token.type in ("text", "text_special", "html_inline", "strong_open", "strong_close"), (
        token
    )
    if token.type == "html_inline":
        assert token.content.strip("<>") in OURS, token.content
        return ""
    return token.content


@pytest.mark.parametrize("name", [*HOSTILE_NAMES, "www.x.y", "a@b.c", "a__b__c", "\\|", "~~a~~"])
def test_names_stay_text(name):
    record = failed(name, error=Failure("E_X", name, name, name))
    page = text([record, written(name, warnings=(name,))])
    broken, warnings, files = (t for t in tables(page) if t[0][0] == "file")
    assert {len(row) for row in broken} == {3}
    assert len(broken) == len(files) == len(warnings) == 2
    if name.isprintable() and not name.lstrip().startswith("::") and "##" not in name:
        assert broken[1] == [name, f"{name}: {name} (E_X)", name]
        assert files[1][0] == name


@given(RECORDS)
def test_any_records_make_a_page(records):
    page = text(records)
    done = [one for one in records if one.status not in ("failed", "planned")]
    rows = [table for table in tables(page) if table[0][0] == "file" and table[0][1] == "status"]
    assert sum(len(table) - 1 for table in rows) == len(done)


def test_the_room_is_kept_and_every_table_gets_some(monkeypatch):
    monkeypatch.setattr(build_services, "MAX_BYTES", 20_000)
    records = [failed(f"{at}.ply") for at in range(500)] + [written(f"{at}") for at in range(500)]
    page = text(records)
    assert len(page.encode()) <= 20_000
    assert "### Files: 500" in page and "more are not shown here" in page


# Annotations: one command a line, and nothing in them that is another's command

COMMAND = re.compile(r"::error ((?:file=([^:,\r\n]*),)?title=([^:,\r\n]*))::([^\r\n]*)")


def parse(line):
    """The file and the message of a command, as the runner reads them."""
    found = COMMAND.fullmatch(line)
    assert found, line
    return unescape(found[2]), unescape(found[4])


def unescape(text):
    codes = (("%0D", "\r"), ("%0A", "\n"), ("%3A", ":"), ("%2C", ","), ("%25", "%"))
    for code, character in codes:
        text = text.replace(code, character) if text is not None else None
    return text


def test_failures_come_before_gates_and_no_more_than_github_shows():
    lines = build_services.list_annotations([written("a"), gated("b"), failed("c")])
    assert [parse(line)[0] for line in lines] == ["c", "b"]
    assert len(build_services.list_annotations([failed(f"{at}.ply") for at in range(50)])) == 10


@pytest.mark.parametrize(
    ("name", "file"),
    [("a.ply", "scans/left/a.ply"), ("/x/a.ply", "/x/a.ply")]
    + [("-", None), ("s3://bucket/a.ply", None)],
)
def test_names_begin_at_the_root_of_the_repository(name, file):
    (line,) = build_services.list_annotations([failed(name)], "scans/left")
    assert parse(line)[0] == file


@pytest.mark.parametrize("name", [*HOSTILE_NAMES, "\udcff.ply", "100%.ply", "%25,:.ply"])
def test_names_in_annotations_stay_data(name):
    record = failed(name, error=Failure("E_X", name, name, name))
    (line,) = build_services.list_annotations([record])
    file, message = parse(line)
    assert "\x1b" not in line and "\u202e" not in line and line.isprintable()
    if name.isprintable() and not name.lstrip().startswith("::") and "##" not in name:
        assert file == name
        assert message == f"{name}: {name}: {name} (E_X)\nhint: {name}"


# JUnit


# What fits the schemas of Ant (JUnit.xsd) and of Jenkins (junit-10.xsd) alike: the attributes of
# each element, all of which are there, and the children in their order.
TOKEN, TEXT = r".+", r"[\s\S]*"
NUMBER, DECIMAL = r"\d+", r"\d+(\.\d+)?"
ATTRIBUTES = {
    "testsuites": {},
    "testsuite": {
        "id": NUMBER,
        "package": TOKEN,
        "name": TOKEN,
        "timestamp": r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d",
        "hostname": TOKEN,
        "tests": NUMBER,
        "failures": NUMBER,
        "errors": NUMBER,
        "skipped": NUMBER,
        "time": DECIMAL,
    },
    "properties": {},
    "property": {"name": TOKEN, "value": TEXT},
    "testcase": {"name": TOKEN, "classname": TOKEN, "time": DECIMAL},
    "error": {"type": TEXT, "message": TEXT},
    "failure": {"type": TEXT, "message": TEXT},
    "skipped": {},
    "system-out": {},
    "system-err": {},
}
CHILDREN = {
    "testsuites": "(testsuite )*",
    "testsuite": "properties (testcase )*system-out system-err ",
    "properties": "(property )*",
    "testcase": "(error |failure |skipped )?",
}


def parsed(records):
    root = Xml.fromstring(build_services.render_junit(RUN, records))
    for one in root.iter():
        assert set(one.attrib) == set(ATTRIBUTES[one.tag])
        for name, value in one.attrib.items():
            assert re.fullmatch(ATTRIBUTES[one.tag][name], value), (one.tag, name, value)
        inside = "".join(f"{child.tag} " for child in one)
        assert re.fullmatch(CHILDREN.get(one.tag, ""), inside), (one.tag, inside)
    for suite in root:
        cases = suite.findall("testcase")
        assert int(suite.get("tests")) == len(cases)
        for word, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            assert int(suite.get(word)) == sum(case.find(tag) is not None for case in cases)
    return root


@given(RECORDS)
def test_any_records_keep_to_the_schemas(records):
    root = parsed(records)
    assert len(root.findall(".//testcase")) == len(records)


@pytest.mark.parametrize(
    "name", [*HOSTILE_NAMES, "\x00\x0b\ufffe\uffff.ply", "\udcff.ply", " .ply"]
)
def test_names_stay_data(name):
    record = failed(name, error=Failure("E_X", name, name, name), warnings=(name,))
    (suite,) = parsed([record, written(name, warnings=(name,))])
    assert {one.tag for one in suite.iter()} <= set(ATTRIBUTES)
    assert len(suite.findall("testcase")) == 2
    if name.isprintable() and not name.lstrip().startswith("::") and "##" not in name:
        assert suite.find("testcase").get("name") == name
        assert name in suite.find("testcase/error").text
