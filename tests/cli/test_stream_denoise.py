"""A single mesh through standard input and output."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import subprocess
import sys

import pytest

from msal_cli.cli.streams import Stream, choose_format, find_stream
from msal_cli.errors import UsageError
from tests.cli.scans import (
    BAD_SCAN,
    MSAL,
    closed_scan,
    folder_of,
    msal,
    msal_on,
    process,
    record_of,
)

SCAN = closed_scan()


@pytest.fixture
def scan(tmp_path):
    return folder_of(tmp_path, scan=SCAN) / "scan.ply"


@pytest.fixture(scope="module")
def denoised():
    return msal_on(SCAN, "denoise", "-", "-q").stdout_bytes


def test_a_stream_is_denoised_like_a_file(scan, tmp_path, denoised):
    assert msal("denoise", scan, "-o", tmp_path / "out.ply").exit_code == 0
    assert denoised == (tmp_path / "out.ply").read_bytes()
    assert denoised != SCAN


def test_talk_and_data_do_not_mix(denoised):
    made = msal_on(SCAN, "denoise", "-")
    assert made.exit_code == 0
    assert made.stdout_bytes == denoised
    assert made.stderr.startswith("standard input -> standard output in ")


def test_a_file_to_standard_output(scan, denoised):
    assert msal("denoise", scan, "-o", "-").stdout_bytes == denoised


def test_a_stream_to_a_file(tmp_path, denoised):
    output = tmp_path / "new" / "out.ply"
    made = msal_on(SCAN, "denoise", "-", "-o", output, "--json", "-q")
    assert made.exit_code == 0
    assert output.read_bytes() == denoised
    record = record_of(made)
    assert (record["input"], record["output"]) == ("-", str(output))
    assert record["output_sha256"] == hashlib.sha256(denoised).hexdigest()


@pytest.mark.parametrize("is_packed", [False, True])
@pytest.mark.parametrize("name", ["out.ply", "out.ply.gz"])
def test_a_file_is_compressed_if_its_name_says_so(tmp_path, denoised, is_packed, name):
    output = tmp_path / name
    data = gzip.compress(SCAN) if is_packed else SCAN
    made = msal_on(data, "denoise", "-", "-o", output, "--json", "-q")
    assert made.exit_code == 0
    written = output.read_bytes()
    assert (gzip.decompress(written) if name.endswith(".gz") else written) == denoised
    record = record_of(made)
    assert record["output_sha256"] == hashlib.sha256(written).hexdigest()


def test_a_compressed_stream_stays_compressed(denoised):
    made = msal_on(gzip.compress(SCAN), "denoise", "-", "-q")
    assert gzip.decompress(made.stdout_bytes) == denoised


def test_the_suffix_of_the_output_says_the_format(tmp_path):
    output = tmp_path / "out.obj"
    assert msal_on(SCAN, "denoise", "-", "-o", output).exit_code == 0
    assert b"\nf " in output.read_bytes()
    assert b"\nf " in msal_on(SCAN, "denoise", "-", "--to", "obj", "-q").stdout_bytes


def test_a_stream_that_is_no_mesh():
    made = msal_on(b"nonsense", "denoise", "-")
    assert made.exit_code == 1
    assert made.stdout == ""
    assert made.stderr.startswith("msal: error: standard input: ")
    assert "--format" in made.stderr


def test_nothing_is_written_if_something_is_wrong(tmp_path):
    made = msal_on(BAD_SCAN, "denoise", "-", "-o", tmp_path / "o.ply", "--json")
    assert made.exit_code == 1
    assert json.loads(made.stdout)["records"][0]["error"]["code"] == "E_INDEX"
    assert list(tmp_path.iterdir()) == []
    assert msal_on(BAD_SCAN, "denoise", "-").stdout == ""


def test_an_output_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    made = msal_on(
        SCAN, "denoise", "-", "-o", tmp_path / "file" / "o.ply", "--report", tmp_path / "r.json"
    )
    assert made.exit_code == 1
    assert "(E_WRITE)" in made.stderr
    (record,) = json.loads((tmp_path / "r.json").read_bytes())["records"]
    assert (record["status"], record["error"]["code"]) == ("failed", "E_WRITE")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["-", "SCAN", "-o", "o.ply"], "hold one mesh, not several"),
        (["SCAN", "SCAN", "-o", "-"], "hold one mesh, not several"),
        (["FOLDER", "-o", "-"], "is a folder"),
        (["nowhere.ply", "-o", "-"], "is no file"),
        (["-", "-o", "FOLDER"], "has no name to put there"),
        (["-", "--report", "-"], "needs the name of a file"),
        (["-", "-o", "o.ply", "--to", "stl"], "say two formats"),
        (["SCAN", "-o", "-", "--report", "SCAN"], "unknown report format"),
    ],
)
def test_wrong_use(scan, tmp_path, arguments, words):
    given = [one.replace("SCAN", str(scan)).replace("FOLDER", str(tmp_path)) for one in arguments]
    made = msal_on(SCAN, "denoise", *given)
    assert made.exit_code == 2
    assert made.stdout == ""
    assert words in made.stderr
    assert [one.name for one in tmp_path.iterdir()] == ["scan.ply"]


def test_a_mesh_does_not_go_to_a_terminal_unasked(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setattr(sys, "stdout", Terminal())
    with pytest.raises(UsageError, match="would go to the terminal"):
        find_stream(("-",), None)
    assert find_stream(("-",), "-") == Stream("-", "-")


@pytest.mark.parametrize(
    ("target", "to", "format"),
    [("-", None, None), ("-", "stl", "stl"), ("o.stl", None, "stl"), ("o.obj.gz", None, "obj")]
    + [("o.PLY", "ply", "ply"), ("o.dat", None, None), ("o.dat", "stl", "stl")],
)
def test_the_format_of_the_target(target, to, format):
    assert choose_format(Stream("-", target), to) == format


def test_real_pipes(tmp_path, denoised):
    made = process("denoise", "-", input=SCAN)
    assert (made.returncode, made.stdout) == (0, denoised)
    words = " ".join(f"'{one}'" for one in (*MSAL, "denoise", "-", "-q"))
    head = subprocess.run(
        ["sh", "-c", f"{words} | head -c 3"], input=SCAN, capture_output=True, check=False
    )
    assert (head.stdout, head.stderr) == (b"ply", b"")


def test_a_file_of_no_known_format_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in ("denoise", "noise"):
        done = msal_on(closed_scan(), command, "-", "-o", "y.stp")
        assert done.exit_code == 2
        assert "no mesh format" in done.stderr and "ply, obj, stl" in done.stderr
    assert list(tmp_path.iterdir()) == []
