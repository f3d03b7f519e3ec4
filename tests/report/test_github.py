"""Annotations: one command a line, at most ten, and nothing in them that is another's command."""

from __future__ import annotations

import re

import pytest

from msal_cli.job.records import Failure
from msal_cli.report.github import list_annotations
from tests.report.made import HOSTILE_NAMES, failed, gated, written

COMMAND = re.compile(r"::error ((?:file=([^:,\r\n]*),)?title=([^:,\r\n]*))::([^\r\n]*)")


def read(line):
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
    lines = list_annotations([written("a"), gated("b"), failed("c")])
    assert [read(line)[0] for line in lines] == ["c", "b"]
    assert len(list_annotations([failed(f"{at}.ply") for at in range(50)])) == 10


@pytest.mark.parametrize(
    ("name", "file"),
    [("a.ply", "scans/left/a.ply"), ("/x/a.ply", "/x/a.ply")]
    + [("-", None), ("s3://bucket/a.ply", None)],
)
def test_names_begin_at_the_root_of_the_repository(name, file):
    (line,) = list_annotations([failed(name)], "scans/left")
    assert read(line)[0] == file


@pytest.mark.parametrize("name", [*HOSTILE_NAMES, "\udcff.ply", "100%.ply", "%25,:.ply"])
def test_names_stay_data(name):
    record = failed(name, error=Failure("E_X", name, name, name))
    (line,) = list_annotations([record])
    file, message = read(line)
    assert "\x1b" not in line and "\u202e" not in line and line.isprintable()
    if name.isprintable() and not name.lstrip().startswith("::") and "##" not in name:
        assert file == name
        assert message == f"{name}: {name}: {name} (E_X)\nhint: {name}"
