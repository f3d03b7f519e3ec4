"""In GitHub Actions failures are marked in the log, elsewhere they are not."""

from __future__ import annotations

import pytest

from msal_cli.cli import report_files
from tests.cli.scans import BAD_SCAN, msal
from tests.report.made import failed, written


@pytest.fixture
def in_actions(tmp_path, monkeypatch):
    (tmp_path / "scans").mkdir()
    monkeypatch.chdir(tmp_path / "scans")
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path))


def test_failures_are_marked_where_the_repository_knows_them(in_actions, capsys):
    report_files.annotate([written(), failed("bad.ply")])
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith("::error file=scans/bad.ply,title=msal%3A failed::bad.ply: ")
    assert told.err.count("\n") == 1


def test_a_run_marks_its_failures_once(in_actions, tmp_path):
    (tmp_path / "scans" / "bad.ply").write_bytes(BAD_SCAN)
    made = msal("denoise", "bad.ply", "-o", tmp_path / "out.ply", "-q")
    assert made.stderr.count("\n::error file=scans/bad.ply,") == 1


@pytest.mark.parametrize("value", ["", "false"])
def test_elsewhere_nothing_is_said(in_actions, monkeypatch, capsys, value):
    monkeypatch.setenv("GITHUB_ACTIONS", value)
    report_files.annotate([failed()])
    assert capsys.readouterr().err == ""


def test_outside_of_the_repository_names_stay_as_they_are(
    in_actions, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path / "elsewhere"))
    report_files.annotate([failed("bad.ply")])
    assert "::error file=bad.ply," in capsys.readouterr().err
