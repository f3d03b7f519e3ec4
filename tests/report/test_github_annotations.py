"""Annotations: one command a line, at most ten, and nothing in them that is another's command."""

from __future__ import annotations

import re

import pytest

from msal_cli.job.records import Failure
from msal_cli.report import github_annotations as as_annotations
from tests.report.made import HOSTILE_NAMES, failed, gated, written

COMMAND = re.compile(r"::error ((?:file=([^:,\r\n]*),)?title=([^:,\r\n]*))::([^\r\n]*)")


def read(line):
    """The file and the message of a command, as the runner reads them."""
    found = COMMAND.fullmatch(line)
    assert found, line
    return unescaped(found[2]), unescaped(found[4])


def unescaped(text):
    for code, one in (("%0D", "\r"), ("%0A", "\n"), ("%3A", ":"), ("%2C", ","), ("%25", "%")):
        text = text.replace(code, one) if text is not None else None
    return text


def test_a_failure_is_told_with_place_and_hint():
    (line,) = as_annotations.commands([written(), failed("x/bad.ply")])
    assert line == (
        "::error file=x/bad.ply,title=msal%3A failed::x/bad.ply: vertex 17: position is not finite "
        "(E_NONFINITE)%0Ahint: repair it"
    )


def test_no_more_than_github_shows():
    assert len(as_annotations.commands([failed(f"{at}.ply") for at in range(50)])) == 10


def test_names_begin_at_the_root_of_the_repository():
    (line,) = as_annotations.commands([failed("a.ply")], "scans/left")
    assert read(line)[0] == "scans/left/a.ply"
    (line,) = as_annotations.commands([failed("/scans/a.ply")], "scans/left")
    assert read(line)[0] == "/scans/a.ply"


@pytest.mark.parametrize("name", ["-", "s3://bucket/a.ply"])
def test_what_is_no_file_has_no_place(name):
    (line,) = as_annotations.commands([failed(name)])
    assert COMMAND.fullmatch(line)[2] is None


@pytest.mark.parametrize("name", [*HOSTILE_NAMES, "\udcff.ply", "100%.ply", "%25,:.ply"])
def test_names_stay_data(name):
    record = failed(name, error=Failure("E_X", name, name, name))
    (line,) = as_annotations.commands([record])
    file, message = read(line)
    assert "\x1b" not in line and "\u202e" not in line and line.isprintable()
    if name.isprintable() and not name.lstrip().startswith("::") and "##" not in name:
        assert file == name
        assert message == f"{name}: {name}: {name} (E_X)\nhint: {name}"


def test_failures_come_before_gates():
    lines = as_annotations.commands([written("a"), gated("b"), failed("c")])
    assert [read(line)[0] for line in lines] == ["c", "b"]
    assert read(lines[1])[1] == "b:\nabs(volume_change) > 1% (volume_change is -2.1%)"
