"""Reports: refused before any work, written whole."""

from __future__ import annotations

import json
import os

import pytest

from msal_cli.cli import report_files as reports
from msal_cli.errors import OutputError, UsageError
from msal_cli.view.illustrations import EMPTY
from tests.report.made import RUN, written


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("r.txt", "unknown report format"),
        ("r", "unknown report format"),
        ("-", "needs the name of a file"),
        ("folder.json", "is a folder"),
        ("mesh.json", "would replace"),
        ("./mesh.json", "would replace"),
        ("file/below.json", "cannot be written to the folder"),
    ],
)
def test_what_is_refused(tmp_path, monkeypatch, name, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.json").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(UsageError, match=words):
        reports.check([name], ["mesh.json", "other.ply"])


def test_columns_without_a_table_are_refused(tmp_path):
    with pytest.raises(UsageError, match="there is no report"):
        reports.check([str(tmp_path / "r.json")], [], "all")


def test_a_report_given_twice_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="given twice"):
        reports.check(["a.json", str(tmp_path / "a.json")], [])


def test_a_folder_that_is_not_writable_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(UsageError, match="cannot be written to the folder"):
        reports.check([str(tmp_path / "a.json")], [])


def test_reports_are_written_with_their_folder(tmp_path):
    names = [str(tmp_path / "new" / f"r{suffix}") for suffix in (".json", ".JSONL", ".csv")]
    reports.check(names, [])
    assert not (tmp_path / "new").exists()
    reports.write(names, RUN, [written()])
    assert json.loads((tmp_path / "new" / "r.json").read_bytes())["totals"]["files"] == 1
    assert len((tmp_path / "new" / "r.JSONL").read_bytes().splitlines()) == 1
    assert (tmp_path / "new" / "r.csv").read_bytes().startswith(b"input,")
    assert len(list((tmp_path / "new").iterdir())) == 3


def test_one_that_cannot_be_written_does_not_keep_back_the_others(tmp_path):
    (tmp_path / "file").write_text("")
    good = tmp_path / "good.json"
    with pytest.raises(OutputError, match="cannot be made"):
        reports.write([str(tmp_path / "file" / "a.json"), str(good)], RUN, [written()])
    assert good.exists()


def test_the_summary_of_a_step_has_no_suffix_and_is_added_to(tmp_path, monkeypatch):
    summary = tmp_path / "step_summary_1"
    summary.write_text("# earlier\n")
    with pytest.raises(UsageError, match="unknown report format"):
        reports.check([str(summary)], [])
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    reports.check([str(summary)], [])
    reports.write([str(summary), str(tmp_path / "r.md")], RUN, [written()])
    assert summary.read_text() == "# earlier\n\n" + (tmp_path / "r.md").read_text()


def test_a_summary_does_not_grow_beyond_what_github_takes(tmp_path, monkeypatch):
    summary = tmp_path / "step_summary_1"
    summary.write_text("x" * 995_000)
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    reports.write([str(summary)], RUN, [written(f"{at}.ply") for at in range(500)])
    assert summary.stat().st_size <= 1_000_001


def test_a_summary_that_cannot_be_written_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(tmp_path / "no" / "summary"))
    with pytest.raises(OutputError, match="summary"):
        reports.write([str(tmp_path / "no" / "summary")], RUN, [written()])


def test_who_waits_for_the_end_gets_a_page_without_pictures(tmp_path, monkeypatch):
    from msal_cli.report import gallery

    asked = []
    build = lambda *_, **options: asked.append(options) or EMPTY  # noqa: E731
    monkeypatch.setattr(gallery, "build_gallery", build)
    reports.write([str(tmp_path / "a.html")], RUN, [written()], without_pictures=True)
    assert asked == []
    reports.write([str(tmp_path / "b.html")], RUN, [written()], backup=".raw")
    assert asked[0]["backup"] == ".raw"
    pages = [(tmp_path / name).read_bytes() for name in ("a.html", "b.html")]
    assert pages[0] == pages[1] and b"scan.ply" in pages[0]


def test_pages_are_written_last(tmp_path, monkeypatch):
    from msal_cli.report import gallery

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(gallery, "build_gallery", interrupted)
    names = [str(tmp_path / "a.html"), str(tmp_path / "a.csv")]
    with pytest.raises(KeyboardInterrupt):
        reports.write(names, RUN, [written()])
    assert [one.name for one in tmp_path.iterdir()] == ["a.csv"]
