"""What logs, reports and pictures must not replace, and what a found msal.toml must not write."""

from __future__ import annotations

import os

import pytest

from msal_cli.cli import report_files
from msal_cli.errors import UsageError
from tests.cli.scans import closed_scan, msal, msal_on, open_scan

posix = pytest.mark.skipif(os.name != "posix", reason="links and pipes of POSIX")
DENOISE = ("denoise", "in/a.ply", "-o", "out", "--method", "al", "-q")


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A folder with a scan, and files that must stay as they are."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    (tmp_path / "in/a.ply").write_bytes(closed_scan())
    (tmp_path / "b.ply").write_bytes(open_scan())
    (tmp_path / "mesh.json").write_bytes(open_scan())
    (tmp_path / "mesh.png").write_bytes(open_scan())
    (tmp_path / "notes.txt").write_text("precious")
    if os.name == "posix":
        os.link("in/a.ply", "hard.log")
        os.link("in/a.ply", "hard.csv")
        os.symlink("in/a.ply", "soft.log")
        os.symlink("in/a.ply", "soft.csv")
        os.mkfifo("pipe.csv")
    return tmp_path


def contents(folder):
    return {
        path: path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "pipe.csv"
    }


@posix
@pytest.mark.parametrize(
    "words",
    [
        *((*DENOISE, "--log-file", name) for name in ("b.ply", "new.ply", "hard.log", "soft.log")),
        *((*DENOISE, "--log-file", name) for name in ("notes.txt", "mesh.json", ".msal-lock")),
        *((*DENOISE, "--report", name) for name in ("hard.csv", "soft.csv", "pipe.csv")),
        *((*DENOISE, "--report", name) for name in ("mesh.json", "out/.msal-manifest.jsonl")),
        (*DENOISE, "--report", "OUT/.MSAL-manifest.jsonl"),
        ("compare", "in/a.ply", "in/a.ply", "--heatmap", "b.ply"),
        ("compare", "in/a.ply", "in/a.ply", "--heatmap", "in/a.ply"),
        ("compare", "in/a.ply", "in/a.ply", "--heatmap", ".msal-x.ply"),
        ("view", "in/a.ply", "-o", "mesh.png"),
        ("sweep", "in/a.ply", "-o", "mesh.png"),
        ("noise", "in/a.ply", "-o", "b.ply"),
    ],
)
def test_what_would_be_replaced_is_refused_before_any_work(project, words):
    before = contents(project)
    made = msal(*words)
    assert made.exit_code == 2, made.stderr
    assert contents(project) == before


def test_a_report_does_not_replace_the_log_of_its_run(project):
    made = msal(*DENOISE, "--report", "a.csv", "--log-file", "a.csv")
    assert (made.exit_code, "would replace 'a.csv'" in made.stderr) == (2, True)


@pytest.mark.parametrize("command", ["denoise", "noise"])
def test_a_stream_replaces_no_file_of_msal(project, command):
    made = msal_on(closed_scan(), command, "-", "-o", ".msal-x.ply")
    assert (made.exit_code, "msal's own" in made.stderr) == (2, True)


def test_what_msal_made_is_replaced(project):
    reports = [f"r.{one}" for one in ("json", "jsonl", "csv", "md", "xml", "html")]
    words = [word for name in reports for word in ("--report", name)]
    for _ in range(2):
        assert msal(*DENOISE, *words, "--log-file", "run.log").exit_code == 0
        for pair in (("a.ply", "--heatmap", "h.ply"), ("a.ply",)):
            assert msal("compare", "in/a.ply", f"in/{pair[0]}", *pair[1:]).exit_code == 0
        assert msal("view", "in/a.ply", "-o", "p.png", "-q", "--size", "48").exit_code == 0
    assert msal("noise", "in/a.ply", "-o", "b.ply", "--force").exit_code == 0
    for name in reports:
        # Also where a msal.toml that was found names it.
        report_files.refuse_target(name, "the report", replaces=report_files.REPORT)
    for name in ("notes.txt", "mesh.json", "h.ply"):
        with pytest.raises(UsageError, match="none of its kind"):
            report_files.refuse_target(name, "the report", replaces=report_files.REPORT)


@posix
def test_a_log_goes_to_devices_and_waits_for_no_pipe(project):
    with report_files.open_log("/dev/null") as stream:
        stream.write("nothing")
    with pytest.raises(OSError, match="No such device"):
        report_files.open_log("pipe.csv")


FOUND = [
    ("output = 'b.ply'", ("in/a.ply",), "is there already"),
    ("output = 'out'\nreport = 'r.csv'", ("in/a.ply",), "outside the output folder"),
    ("report = 'r.csv'", ("in/a.ply", "-o", "out"), "outside the output folder"),
    ("report = 'r.csv'", ("in/a.ply", "--in-place"), "outside the output folder"),
    ("report = 'out/notes.md'", ("in/a.ply", "-o", "out"), "none of its kind"),
    ("output = '.'\nreport = 'mesh.json'", ("in/a.ply",), "none of its kind"),
]


@pytest.mark.parametrize(("text", "words", "message"), FOUND)
def test_a_found_file_writes_nothing_outside_nor_over_others(project, text, words, message):
    (project / "out").mkdir()
    (project / "out/notes.md").write_text("precious")
    (project / "msal.toml").write_text(f"[denoise]\nmethod = 'al'\n{text}\n")
    before = contents(project)
    made = msal("denoise", *words)
    assert (made.exit_code, message in made.stderr) == (2, True), made.stderr
    assert contents(project) == before


def test_a_found_file_stops_a_stream_from_replacing_a_file(project):
    (project / "msal.toml").write_text("[denoise]\noutput = 'b.ply'\n")
    made = msal_on(closed_scan(), "denoise", "-")
    assert (made.exit_code, "is there already" in made.stderr) == (2, True), made.stderr


def test_a_found_file_may_name_a_report_in_the_output_folder(project):
    (project / "msal.toml").write_text("[denoise]\nmethod = 'al'\nreport = 'out/r.html'\n")
    for _ in range(2):
        assert msal("denoise", "in/a.ply", "-o", "out/", "-q").exit_code == 0
    assert (project / "out/r.html").exists()


@pytest.mark.parametrize("words", [("view", "in/a.ply"), ("sweep", "in/a.ply")])
def test_a_found_file_names_no_picture(project, words):
    (project / "msal.toml").write_text(f"[{words[0]}]\noutput = 'new.png'\n")
    made = msal(*words)
    assert (made.exit_code, "--config" in made.stderr) == (2, True)
