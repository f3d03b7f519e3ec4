"""Pipes, holes, devices and private files; what msal made is replaced, and nothing else."""

import os

import pytest

from tests.cli.scans import closed_scan, folder_of, msal, open_scan
from tests.files import time_limit, tree, umask

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and links of POSIX")

DENOISE = ("denoise", "in/a.ply", "-o", "out", "--method", "al", "-q")


@pytest.fixture
def place(tmp_path, monkeypatch):
    """The current folder, with a private scan."""
    monkeypatch.chdir(tmp_path)
    (folder_of(tmp_path / "in", a=closed_scan()) / "a.ply").chmod(0o600)
    return tmp_path


@pytest.mark.parametrize("name", [".msal-manifest.jsonl", ".msal-lock", "a hole"])
def test_a_pipe_or_a_hole_in_the_place_of_what_msal_keeps(place, name):
    folder_of(place / "in", b=closed_scan(1))
    (place / "out").mkdir()
    if name == "a hole":
        with (place / "out/.msal-manifest.jsonl").open("wb") as file:
            file.truncate(1 << 40)
    else:
        os.mkfifo(place / "out" / name)
    with time_limit(60.0):
        made = msal("denoise", "in", "-o", "out", "-j", "1")
    assert made.exit_code == 1
    words = "a line has more than 16,777,216 bytes" if name == "a hole" else "regular file"
    assert words in made.stderr
    if name != "a hole":
        assert sorted(os.listdir("out")) == [name]
    if name == ".msal-manifest.jsonl":
        assert msal("report", "out").exit_code == 1


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("out.stl", "denoise in/a.ply --method al --fields curvature"),
        ("out.ply", "noise in/a.ply"),
        ("out.ply", "compare in/a.ply in/a.ply --heatmap out.ply"),
        ("out.html", "view in/a.ply"),
        ("out.html", "denoise in/a.ply -o out.ply --report out.html"),
        ("out.png", "view in/a.ply --size 48"),
        ("out.png", "sweep in/a.ply --columns K=1 --size 48"),
    ],
)
def test_outputs_are_as_private_as_the_mesh(place, name, words):
    output = () if "out.ply" in words else ("-o", name)
    with umask(0o022):
        made = msal(*words.split(), *output)
    assert made.exit_code == 0, made.stderr
    made = sorted(path for path in place.iterdir() if path.name.startswith("out."))
    assert name in [path.name for path in made]
    assert {path.stat().st_mode & 0o777 for path in made} == {0o600}


def test_what_msal_made_is_replaced(place):
    reports = [f"r.{one}" for one in ("json", "jsonl", "csv", "md", "xml", "html")]
    words = [word for name in reports for word in ("--report", name)]
    for _ in range(2):
        assert msal(*DENOISE, *words).exit_code == 0
        for pair in (("a.ply", "--heatmap", "h.ply"), ("a.ply",)):
            assert msal("compare", "in/a.ply", f"in/{pair[0]}", *pair[1:]).exit_code == 0
        assert msal("view", "in/a.ply", "-o", "p.png", "-q", "--size", "48").exit_code == 0
    (place / "b.ply").write_bytes(open_scan())
    assert msal("noise", "in/a.ply", "-o", "b.ply", "--force").exit_code == 0
    (place / "notes.csv").write_text("precious")
    made = msal(*DENOISE, "--report", "notes.csv")
    assert (made.exit_code, "none of its kind" in made.stderr) == (2, True)


FOUND = [
    ("output = 'b.ply'", ("in/a.ply",), "is there already"),
    ("report = 'out/notes.md'", ("in/a.ply", "-o", "out"), "none of its kind"),
    ("output = '.'\nreport = 'mesh.json'", ("in/a.ply",), "none of its kind"),
]


@pytest.mark.parametrize(("text", "words", "message"), FOUND)
def test_a_found_file_writes_nothing_outside_nor_over_others(place, text, words, message):
    (place / "out").mkdir()
    for name in ("b.ply", "mesh.json", "out/notes.md"):
        (place / name).write_text("precious")
    (place / "msal.toml").write_text(f"[denoise]\nmethod = 'al'\n{text}\n")
    before = tree(place, has_own=True)
    made = msal("denoise", *words)
    assert (made.exit_code, message in made.stderr) == (2, True), made.stderr
    assert tree(place, has_own=True) == before


@pytest.mark.parametrize("words", [("view", "in/a.ply"), ("sweep", "in/a.ply")])
def test_a_found_file_names_no_picture(place, words):
    (place / "msal.toml").write_text(f"[{words[0]}]\noutput = 'new.png'\n")
    made = msal(*words)
    assert (made.exit_code, "--config" in made.stderr) == (2, True)
