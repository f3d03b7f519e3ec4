"""A mesh through standard input and output, within bounds of memory and time."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile

import pytest

from msal_cli import machine
from msal_cli.cli.streams import Stream, choose_format, copy_stream, find_stream, read_stream
from msal_cli.errors import InputError, OutputError, ResourceError, TooLargeError, UsageError
from msal_cli.storage import regular
from tests.cli.scans import MSAL, closed_scan, folder_of, msal, msal_on, process, record_of
from tests.files import Terminal

SCAN = closed_scan()


class Endless:
    """Standard input of ``yes``; counts what was read."""

    def __init__(self):
        self.buffer = self
        self.n_read = 0

    def fileno(self):
        raise io.UnsupportedOperation

    def read(self, size):
        self.n_read += size
        assert self.n_read < 1 << 30, "it is read without end"
        return b"y\n" * (size // 2)


@pytest.fixture
def endless(monkeypatch):
    stream = Endless()
    monkeypatch.setattr(sys, "stdin", stream)
    return stream


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """The folder for temporary files; nothing may stay in it."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("place", "n_bytes", "error_class", "message"),
    [
        ((regular, "memory_bytes"), 32 << 20, TooLargeError, "memory of this machine"),
        ((machine, "available_bytes"), 8 << 20, ResourceError, "no more memory is left"),
    ],
)
def test_more_than_fits_is_not_read(endless, monkeypatch, place, n_bytes, error_class, message):
    monkeypatch.setattr(*place, lambda: n_bytes)
    with pytest.raises(error_class, match=message):
        read_stream()
    assert endless.n_read <= 18 << 20


@pytest.mark.parametrize("words", [("denoise", "-", "-o", "-"), ("info", "-")])
def test_the_commands_read_no_more_either(words, monkeypatch):
    monkeypatch.setattr(regular, "memory_bytes", lambda: 4 << 20)
    made = msal_on(b"y\n" * (3 << 20), *words)
    assert made.exit_code == 1
    assert made.stdout == ""
    assert "(E_TOO_LARGE)" in made.stderr


def test_a_limit_of_memory_bounds_the_reading(endless, tmp_path):
    with pytest.raises(ResourceError, match="the memory limit is no more") as caught:
        copy_stream(str(tmp_path / "copy"), None, 6 << 20)
    assert caught.value.code == "E_MEMORY"
    assert endless.n_read <= 8 << 20


def test_all_of_a_stream_is_copied_or_it_is_an_error(tmp_path, monkeypatch):
    data = os.urandom(3_000_000)
    (tmp_path / "a").write_bytes(data)
    for timeout_s in (None, 60.0):
        with (tmp_path / "a").open() as stream:
            monkeypatch.setattr(sys, "stdin", stream)
            left_s = copy_stream(str(tmp_path / f"copy{timeout_s}"), timeout_s, None)
        assert (tmp_path / f"copy{timeout_s}").read_bytes() == data
        assert (left_s is None) == (timeout_s is None)
    with open(os.devnull) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        with pytest.raises(OutputError, match="cannot be kept"):
            copy_stream(str(tmp_path / "none" / "copy"), None, None)
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="closed"):
        read_stream()


def test_within_the_limits_the_result_is_the_same(tmp_path, scratch, denoised, workers):
    made = msal_on(SCAN, "denoise", "-", "--timeout", "5m", "--memory-limit", "2G")
    assert made.exit_code == 0, made.stderr
    assert made.stdout_bytes == denoised
    assert made.stderr.startswith("standard input -> standard output in ")
    output = tmp_path / "new" / "out.obj.gz"
    made = msal_on(SCAN, "denoise", "-", "-o", output, "--timeout", "5m", "--json", "-q")
    record = record_of(made)
    assert (record["input"], record["output"]) == ("-", str(output))
    assert record["format"] == "ply"
    assert output.read_bytes()[:2] == b"\x1f\x8b"


def test_a_worker_that_takes_too_long_is_ended(tmp_path, scratch, workers):
    scan = folder_of(tmp_path / "in", scan=SCAN) / "scan.ply"
    report = tmp_path / "r.json"
    made = msal("denoise", scan, "-o", "-", "--timeout", "0.001", "--report", report)
    assert made.exit_code == 1
    assert made.stdout == ""
    assert "it was not done within 0.001 s (E_TIMEOUT)" in made.stderr
    (record,) = json.loads(report.read_bytes())["records"]
    assert (record["input"], record["error"]["code"]) == (str(scan), "E_TIMEOUT")


def test_a_mesh_that_takes_too_much_is_refused(tmp_path, scratch):
    made = msal_on(SCAN * 60, "denoise", "-", "--memory-limit", "53M")
    assert made.exit_code == 1
    assert made.stdout == ""
    assert "(E_MEMORY)" in made.stderr
    made = msal_on(SCAN, "denoise", "-", "--memory-limit", "1M")
    assert made.exit_code == 2
    assert "not enough for any file" in made.stderr


def test_a_real_pipe_that_stays_open(tmp_path):
    words = (*MSAL, "denoise", "-", "-o", "-", "--timeout", "0.5")
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(words, env={**os.environ, "TMPDIR": str(tmp_path)}, **pipes) as process:
        process.stdin.write(b"ply\n")
        process.stdin.flush()
        assert process.wait(30.0) == 1
        assert b"(E_TIMEOUT)" in process.stderr.read()
        assert process.stdout.read() == b""
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def scan(tmp_path):
    return folder_of(tmp_path, scan=SCAN) / "scan.ply"


@pytest.fixture(scope="module")
def denoised():
    return msal_on(SCAN, "denoise", "-", "-q").stdout_bytes


@pytest.mark.parametrize("is_packed", [False, True])
@pytest.mark.parametrize("name", ["out.ply", "out.ply.gz"])
def test_a_file_is_compressed_if_its_name_says_so(tmp_path, denoised, is_packed, name):
    output = tmp_path / "new" / name
    data = gzip.compress(SCAN) if is_packed else SCAN
    record = record_of(msal_on(data, "denoise", "-", "-o", output, "--json", "-q"))
    written = output.read_bytes()
    assert (gzip.decompress(written) if name.endswith(".gz") else written) == denoised
    assert (record["input"], record["output"]) == ("-", str(output))
    assert record["output_sha256"] == hashlib.sha256(written).hexdigest()


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


def test_real_pipes(scan, tmp_path, denoised):
    """A stream is denoised like a file."""
    assert msal("denoise", scan, "-o", tmp_path / "out.ply").exit_code == 0
    made = process("denoise", "-", input=SCAN)
    assert (made.returncode, made.stdout) == (0, (tmp_path / "out.ply").read_bytes())
    assert denoised == made.stdout != SCAN
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
