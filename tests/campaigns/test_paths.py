"""Hostile paths, by whole runs: no escape from the output folder, no overwrite, no crash."""

from __future__ import annotations

import json
import os
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


def statuses(*arguments):
    """Run msal; its exit status and the status of each input's record by the input's name."""
    made = msal("denoise", *arguments, "--method", "msal", "-j", "1", "--json")
    assert "Traceback" not in made.stderr and "nternal" not in made.stderr, made.stderr
    assert "\x1b" not in made.stderr + made.stdout
    records = json.loads(made.stdout)["records"] if made.stdout else []
    return (
        made.exit_code,
        {Path(record["input"]).name: record["status"] for record in records},
        made.stderr,
    )


def test_every_name_gets_its_output_and_no_other(tmp_path):
    scans = tmp_path / "in"
    scans.mkdir()
    for name in NAMES:
        # A folder is searched for names with a mesh suffix only; the others are given by name.
        (scans / name).write_bytes(SCAN)
    listed = [name for name in NAMES if name.lower().endswith(".ply") and not name.startswith(".")]
    others = [name for name in NAMES if name not in listed]
    assert len(others) >= 5 and len(listed) >= 30
    status, results, said = statuses(scans, "-o", tmp_path / "out")
    assert (status, set(results.values())) == (0, {"written"}), said
    files = contents(tmp_path / "out")
    assert sorted(files) == sorted(listed)
    assert len(set(files.values())) == 1 and files[listed[0]] != SCAN
    assert statuses(scans, "-o", tmp_path / "out")[1].keys() == results.keys()
    # Named themselves they are listed whatever they are called.
    paths = [scans / name for name in others]
    status, results, said = statuses(*paths, "-o", tmp_path / "named", "--format", "ply")
    assert (status, len(results)) == (0, len(others)), said
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
