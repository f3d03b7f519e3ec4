"""Pipes, links and devices under the names of meshes, reports, manifests and materials."""

from __future__ import annotations

import os

import pytest

from tests.cli.scans import closed_scan, folder_of, msal
from tests.time_limit import time_limit

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes and links of POSIX")

OBJ = b"mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"


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


@pytest.mark.parametrize(
    "words",
    [
        "info pipe.ply",
        "view pipe.ply -o a.png",
        "view scan.ply pipe.ply -o a.png",
        "sweep pipe.ply -o a.png",
        "compare pipe.ply scan.ply",
        "compare scan.ply pipe.ply",
        "compare scan.ply scan.ply --baseline pipe.json",
        "noise pipe.ply -o a.ply",
        "denoise pipe.ply -o a.ply",
        "denoise pipe.ply -o -",
        "denoise scan.ply -o a.ply --reference pipe.ply",
        "denoise scan.ply -o pipe.ply",
        "report pipe.json",
        "report pipe.jsonl",
    ],
)
def test_a_pipe_is_refused_at_once(place, words):
    made = msal(*words.split())
    assert made.exit_code in (1, 2), made.stderr
    assert "file" in made.stderr and "Traceback" not in made.stderr
    assert "internal" not in made.stderr


def test_a_report_into_a_pipe_is_refused(place):
    made = msal("denoise", "scan.ply", "-o", "a.ply", "--report", "pipe.csv")
    assert made.exit_code == 2
    assert "device or a pipe" in made.stderr


@pytest.mark.parametrize("name", [".msal-manifest.jsonl", ".msal-lock"])
def test_a_pipe_in_the_place_of_what_msal_keeps(place, name):
    folder_of(place / "in", a=closed_scan(), b=closed_scan(1))
    (place / "out").mkdir()
    os.mkfifo(place / "out" / name)
    made = msal("denoise", "in", "-o", "out", "-j", "1")
    assert made.exit_code == 1
    assert "regular file" in made.stderr
    assert sorted(os.listdir("out")) == [name]
    if name != ".msal-lock":
        assert msal("report", "out").exit_code == 1


def test_a_manifest_with_a_hole_is_refused_at_once(place):
    folder_of(place / "in", a=closed_scan(), b=closed_scan(1))
    (place / "out").mkdir()
    with (place / "out/.msal-manifest.jsonl").open("wb") as file:
        file.truncate(1 << 40)
    made = msal("denoise", "in", "-o", "out", "-j", "1")
    assert made.exit_code == 1
    assert "a line has more than 16,777,216 bytes" in made.stderr


@pytest.mark.parametrize("kind", ["pipe", "device", "outside", "folder outside"])
def test_materials_that_are_no_files_of_the_folder(place, kind):
    (place / "in").mkdir()
    (place / "in/a.obj").write_bytes(OBJ.replace(b"m.mtl", b"t/m.mtl"))
    (place / "secret").mkdir()
    (place / "secret/m.mtl").write_bytes(b"the key is 1234\nmap_Kd key.png\n")
    material = place / "in/t/m.mtl"
    if kind == "folder outside":
        (place / "in/t").symlink_to(place / "secret")
    else:
        (place / "in/t").mkdir()
        if kind == "pipe":
            os.mkfifo(material)
        else:
            material.symlink_to("/dev/zero" if kind == "device" else place / "secret/m.mtl")
    made = msal("denoise", "in/a.obj", "-o", "out/a.obj", "-v")
    assert made.exit_code == 0, made.stderr
    reason = "leads out of" if "outside" in kind else "is not a regular file"
    assert f"t/m.mtl {reason}" in made.stderr
    # Not even the names that stand in it.
    assert "key.png" not in made.stderr
    assert [path.name for path in (place / "out").rglob("*") if path.is_file()] == ["a.obj"]


def test_a_linked_material_of_the_folder_is_copied(place):
    (place / "in/shared").mkdir(parents=True)
    (place / "in/a.obj").write_bytes(OBJ)
    (place / "in/shared/real.mtl").write_bytes(b"newmtl a\n")
    (place / "in/m.mtl").symlink_to("shared/real.mtl")
    assert msal("denoise", "in/a.obj", "-o", "out/a.obj").exit_code == 0
    assert (place / "out/m.mtl").read_bytes() == b"newmtl a\n"
    assert not (place / "out/m.mtl").is_symlink()


def test_links_to_meshes(place):
    """A link to a file is the file; one to nothing, or to itself, is a failed row."""
    (place / "in").mkdir()
    (place / "in/good.ply").symlink_to(place / "scan.ply")
    (place / "in/dangling.ply").symlink_to("nothing.ply")
    (place / "in/loop.ply").symlink_to("loop.ply")
    (place / "in/pipe.ply").symlink_to(place / "pipe.ply")
    made = msal("denoise", "in", "-o", "out", "-j", "1")
    assert made.exit_code == 3
    assert "dangling.ply" in made.stderr and "loop.ply" in made.stderr
    assert not (place / "out/good.ply").is_symlink()
    assert sorted(path.name for path in (place / "out").glob("*.ply")) == ["good.ply"]


def test_a_backup_that_is_a_link_is_never_put_in_place(place):
    """A hostile manifest says that a run was killed while it replaced the scan."""
    from msal_cli.batch.manifest import NAME
    from msal_cli.batch.manifest_lines import encode_line, intent_line

    folder_of(place / "in", scan=closed_scan())
    secret = place / "secret"
    secret.write_bytes(b"the key is 1234")
    (place / "in/scan.ply.orig").symlink_to(secret)
    line = intent_line("scan.ply", str(secret)) | {"at": 1}
    (place / "in" / NAME).write_bytes(encode_line(line))
    made = msal("denoise", "in", "--in-place", "-j", "1")
    assert made.exit_code == 2
    assert "backup" in made.stderr
    assert (place / "in/scan.ply").read_bytes() == closed_scan()
