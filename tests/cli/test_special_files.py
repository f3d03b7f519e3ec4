"""Pipes, links, devices and private files; what logs, reports and pictures must not replace."""

from __future__ import annotations

import os

import pytest

from msal_cli.cli import report_files
from tests.cli.scans import closed_scan, folder_of, msal, open_scan
from tests.files import tree
from tests.time_limit import time_limit

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and links of POSIX")


@pytest.fixture(autouse=True)
def promptly():
    """A test that waits for another process fails."""
    with time_limit(60.0):
        yield


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The current folder, with a scan and pipes."""
    monkeypatch.chdir(tmp_path)
    folder_of(tmp_path, scan=closed_scan())
    for name in ("pipe.ply", "pipe.json", "pipe.jsonl", "pipe.csv"):
        os.mkfifo(name)
    return tmp_path


@pytest.mark.parametrize("name", [".msal-manifest.jsonl", ".msal-lock", "a hole"])
def test_a_pipe_or_a_hole_in_the_place_of_what_msal_keeps(place, name):
    folder_of(place / "in", a=closed_scan(), b=closed_scan(1))
    (place / "out").mkdir()
    if name == "a hole":
        with (place / "out/.msal-manifest.jsonl").open("wb") as file:
            file.truncate(1 << 40)
    else:
        os.mkfifo(place / "out" / name)
    made = msal("denoise", "in", "-o", "out", "-j", "1")
    assert made.exit_code == 1
    words = "a line has more than 16,777,216 bytes" if name == "a hole" else "regular file"
    assert words in made.stderr
    if name != "a hole":
        assert sorted(os.listdir("out")) == [name]
    if name == ".msal-manifest.jsonl":
        assert msal("report", "out").exit_code == 1


@pytest.fixture
def scan(tmp_path):
    path = folder_of(tmp_path, scan=closed_scan()) / "scan.ply"
    path.chmod(0o600)
    return path


@pytest.fixture(autouse=True)
def umask():
    before = os.umask(0o022)
    yield
    os.umask(before)


def mode_of(path):
    return path.stat().st_mode & 0o777


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("out.ply", ("denoise", "SCAN", "--method", "al", "-o", "OUT")),
        ("out.ply", ("noise", "SCAN", "-o", "OUT")),
        ("out.ply", ("compare", "SCAN", "SCAN", "--heatmap", "OUT")),
        ("out.html", ("view", "SCAN", "-o", "OUT")),
        ("out.png", ("view", "SCAN", "--size", "48", "-o", "OUT")),
        ("out.png", ("sweep", "SCAN", "--columns", "K=1", "--size", "48", "-o", "OUT")),
    ],
)
def test_outputs_are_as_private_as_the_mesh(scan, tmp_path, name, words):
    out = tmp_path / name
    made = msal(*({"SCAN": scan, "OUT": out}.get(word, word) for word in words))
    assert made.exit_code == 0, made.stderr
    assert mode_of(out) == 0o600


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


def test_a_report_does_not_replace_the_log_of_its_run(project):
    made = msal(*DENOISE, "--report", "a.csv", "--log-file", "a.csv")
    assert (made.exit_code, "would replace 'a.csv'" in made.stderr) == (2, True)


def test_what_msal_made_is_replaced(project):
    reports = [f"r.{one}" for one in ("json", "jsonl", "csv", "md", "xml", "html")]
    words = [word for name in reports for word in ("--report", name)]
    for _ in range(2):
        assert msal(*DENOISE, *words, "--log-file", "run.log").exit_code == 0
        for pair in (("a.ply", "--heatmap", "h.ply"), ("a.ply",)):
            assert msal("compare", "in/a.ply", f"in/{pair[0]}", *pair[1:]).exit_code == 0
        assert msal("view", "in/a.ply", "-o", "p.png", "-q", "--size", "48").exit_code == 0
    assert msal("noise", "in/a.ply", "-o", "b.ply", "--force").exit_code == 0
    (project / "notes.csv").write_text("precious")
    made = msal(*DENOISE, "--report", "notes.csv")
    assert (made.exit_code, "none of its kind" in made.stderr) == (2, True)


def test_a_log_goes_to_devices_and_waits_for_no_pipe(project):
    with report_files.open_log("/dev/null") as stream:
        stream.write("nothing")
    with pytest.raises(OSError, match="No such device"):
        report_files.open_log("pipe.csv")


FOUND = [
    ("output = 'b.ply'", ("in/a.ply",), "is there already"),
    ("report = 'out/notes.md'", ("in/a.ply", "-o", "out"), "none of its kind"),
    ("output = '.'\nreport = 'mesh.json'", ("in/a.ply",), "none of its kind"),
]


@pytest.mark.parametrize(("text", "words", "message"), FOUND)
def test_a_found_file_writes_nothing_outside_nor_over_others(project, text, words, message):
    (project / "out").mkdir()
    (project / "out/notes.md").write_text("precious")
    (project / "msal.toml").write_text(f"[denoise]\nmethod = 'al'\n{text}\n")
    before = tree(project, has_own=True)
    made = msal("denoise", *words)
    assert (made.exit_code, message in made.stderr) == (2, True), made.stderr
    assert tree(project, has_own=True) == before


@pytest.mark.parametrize("words", [("view", "in/a.ply"), ("sweep", "in/a.ply")])
def test_a_found_file_names_no_picture(project, words):
    (project / "msal.toml").write_text(f"[{words[0]}]\noutput = 'new.png'\n")
    made = msal(*words)
    assert (made.exit_code, "--config" in made.stderr) == (2, True)
