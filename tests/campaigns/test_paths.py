"""Hostile paths, by whole runs: no escape from the output folder, no overwrite, no crash."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path

import pytest

from msal_cli.batch.manifest import NAME as MANIFEST
from msal_cli.storage.atomic import temporary_name
from tests.campaigns.runs import IS_LINUX, contents
from tests.cli.scans import folder_of, msal, open_scan
from tests.report.made import HOSTILE_NAMES

pytestmark = [
    pytest.mark.skipif(not IS_LINUX, reason="names and links as Linux allows them"),
    pytest.mark.ci,
]

SCAN = open_scan()

NAMES = (
    "two\nlines.ply",
    "quo\"tes'.ply",
    "tab\t.ply",
    os.fsdecode(b"bytes \xff\xfe.ply"),
    "n" * 251 + ".ply",
    "é" * 125 + ".ply",
    "-x.ply",
    "--help.ply",
    "-",
    "Twin.ply",
    "twin.PLY",
    "dot..ply",
    "ends in a dot..ply.",
    "ends in a space .ply ",
    "\x1b[31mred\x1b[0m.ply",
    "\x07\x08\x7f\x9b.ply",
    "manifest.msal-1-2.ply",
    ".hidden.ply",
    "a.ply.tmp",
    "*.ply",
    "[a-z]?.ply",
    "%s%n{0}.ply",
    "$HOME.ply",
    "C:\\x.ply",
    "..ply",
    *HOSTILE_NAMES,
)


def tree(folder):
    """Every name below a folder, links not followed, with the bytes of the files."""
    found = {}
    for at, folders, names in os.walk(folder):
        for name in folders + names:
            path = Path(at, name)
            is_plain = path.is_file() and not path.is_symlink()
            found[str(path.relative_to(folder))] = path.read_bytes() if is_plain else None
    return found


@pytest.fixture
def outside(tmp_path):
    """What no run may touch."""
    folder_of(tmp_path / "outside", precious=SCAN, other=SCAN)
    before = tree(tmp_path / "outside")
    yield tmp_path / "outside"
    assert tree(tmp_path / "outside") == before


def statuses(*arguments):
    """Run msal; its exit status and the status of each input's record by the input's name."""
    made = msal("denoise", *arguments, "--method", "msal", "-j", "1", "--json")
    assert "Traceback" not in made.stderr and "nternal" not in made.stderr, made.stderr
    assert "\x1b" not in made.stderr + made.stdout
    records = json.loads(made.stdout)["records"] if made.stdout else []
    return made.exit_code, {Path(one["input"]).name: one["status"] for one in records}, made.stderr


def test_every_name_gets_its_output_and_no_other(tmp_path, outside):
    scans = tmp_path / "in"
    scans.mkdir()
    for name in NAMES:
        # A folder is searched for names with a mesh suffix only; the others are given by name.
        (scans / name).write_bytes(SCAN)
    taken = [name for name in NAMES if name.lower().endswith(".ply") and not name.startswith(".")]
    others = [name for name in NAMES if name not in taken]
    assert len(others) >= 5 and len(taken) >= 30
    status, told, said = statuses(scans, "-o", tmp_path / "out")
    assert (status, set(told.values())) == (0, {"written"}), said
    files = contents(tmp_path / "out")
    assert sorted(files) == sorted(taken)
    assert len(set(files.values())) == 1 and files[taken[0]] != SCAN
    assert statuses(scans, "-o", tmp_path / "out")[1].keys() == told.keys()
    # Named themselves they are taken whatever they are called.
    paths = [scans / name for name in others]
    status, told, said = statuses(*paths, "-o", tmp_path / "named", "--format", "ply")
    assert (status, len(told)) == (0, len(others)), said
    assert sorted(contents(tmp_path / "named")) == sorted(others)


def test_names_of_our_own_are_no_inputs_and_are_not_written_over(tmp_path):
    scans = folder_of(tmp_path / "in", a=SCAN)
    own = [temporary_name("a.ply"), MANIFEST, ".msal-lock"]
    for name in own:
        (scans / name).write_bytes(SCAN)
    assert statuses(scans, "-o", tmp_path / "out")[:2] == (0, {"a.ply": "written"})
    # Given by name, what would replace the manifest is refused before anything is written.
    for name in (MANIFEST, ".msal-lock"):
        status, _, said = statuses(scans / name, scans / "a.ply", "-o", tmp_path / "b")
        assert status == 2 and "msal's own" in said
        assert statuses(scans / name, "--in-place")[0] == 2
        assert not (tmp_path / "b").exists() and (scans / name).read_bytes() == SCAN


def test_manifest_and_lock_that_are_links_do_not_lead_out(tmp_path, outside):
    scans = folder_of(tmp_path / "in", a=SCAN, b=SCAN)
    for name in (MANIFEST, ".msal-lock"):
        output = tmp_path / f"out{name}"
        output.mkdir()
        (output / name).symlink_to(outside / "precious.ply")
        status, _, said = statuses(scans, "-o", output)
        assert status == 1 and name in said


def test_hard_links_in_place_are_as_many_files(tmp_path):
    scans = folder_of(tmp_path / "in", a=SCAN)
    os.link(scans / "a.ply", scans / "b.ply")
    assert statuses(scans, "--in-place")[:2] == (0, {"a.ply": "written", "b.ply": "written"})
    after = contents(scans)
    assert after["a.ply"] == after["b.ply"] != SCAN == after["a.ply.orig"] == after["b.ply.orig"]


def test_what_is_no_file(tmp_path, monkeypatch):
    scans = folder_of(tmp_path / "in", a=SCAN)
    folder_of(scans / "folder.ply", b=SCAN)
    os.mkfifo(scans / "fifo.ply")
    monkeypatch.chdir(scans)
    with socket.socket(socket.AF_UNIX) as one:
        one.bind("socket.ply")
    (scans / "zero.ply").symlink_to("/dev/zero")
    assert statuses(scans, "-o", tmp_path / "out")[:2] == (
        0,
        {"a.ply": "written", "b.ply": "written"},
    )
    assert sorted(contents(tmp_path / "out")) == ["a.ply", "folder.ply/b.ply"]
    for name in ("fifo.ply", "socket.ply", "zero.ply"):
        assert statuses(scans / name, "-o", tmp_path / "o.ply")[0] == 2
        assert msal("info", scans / name).exit_code == 2
    # The other way round: they are no outputs either.
    for target in (scans / "fifo.ply", scans / "socket.ply", "/dev/null"):
        assert statuses(scans / "a.ply", "-o", target)[0] in (1, 2)
    assert os.path.exists("/dev/null") and not os.path.isfile("/dev/null")


def test_a_path_too_long_for_the_system(tmp_path):
    scans = folder_of(tmp_path / "in", a=SCAN)
    folder_of(scans / Path(*["e" * 200] * 16), b=SCAN)
    status, told, said = statuses(scans, "-o", tmp_path / Path(*["o" * 200] * 4))
    assert (status, told) == (3, {"a.ply": "written", "b.ply": "failed"}), said
    assert "File name too long (E_WRITE)" in said
