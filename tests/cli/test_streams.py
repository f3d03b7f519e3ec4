"""Standard input is read within bounds of memory and time, and nothing half-written leaves."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import tempfile
import time

import pytest

from msal_cli import machine
from msal_cli.cli.streams import copy_stream, read_stream
from msal_cli.errors import InputError, OutputError, ResourceError, TooLargeError
from msal_cli.storage import limits
from tests.cli.scans import BAD_SCAN, MSAL, closed_scan, folder_of, msal, msal_on, record_of

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
def silent(monkeypatch):
    """Standard input that neither ends nor brings anything."""
    receiving, sending = os.pipe()
    with os.fdopen(receiving) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        yield
        os.close(sending)


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """The folder for temporary files; nothing may stay in it."""
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def test_more_than_half_of_the_memory_is_not_read(endless, monkeypatch):
    monkeypatch.setattr(limits, "memory_bytes", lambda: 32 << 20)
    with pytest.raises(TooLargeError, match="memory of this machine"):
        read_stream()
    assert endless.n_read <= 18 << 20


def test_more_than_is_left_of_the_memory_is_not_read(endless, monkeypatch):
    monkeypatch.setattr(machine, "available_bytes", lambda: 8 << 20)
    with pytest.raises(ResourceError, match="no more memory is left") as caught:
        read_stream()
    assert caught.value.code == "E_MEMORY"
    assert endless.n_read <= 10 << 20


@pytest.mark.parametrize("words", [("denoise", "-", "-o", "-"), ("info", "-")])
def test_the_commands_read_no_more_either(words, monkeypatch):
    monkeypatch.setattr(limits, "memory_bytes", lambda: 4 << 20)
    made = msal_on(b"y\n" * (3 << 20), *words)
    assert made.exit_code == 1
    assert made.stdout == ""
    assert "(E_TOO_LARGE)" in made.stderr


def test_a_limit_of_memory_bounds_the_reading(endless, tmp_path):
    with pytest.raises(ResourceError, match="the memory limit is no more") as caught:
        copy_stream(str(tmp_path / "copy"), None, 6 << 20)
    assert caught.value.code == "E_MEMORY"
    assert endless.n_read <= 8 << 20


def test_a_limit_of_time_bounds_the_reading(silent, tmp_path):
    begun = time.monotonic()
    with pytest.raises(ResourceError, match=r"did not end within 0\.2 s") as caught:
        copy_stream(str(tmp_path / "copy"), 0.2, None)
    assert caught.value.code == "E_TIMEOUT"
    assert 0.2 <= time.monotonic() - begun < 5.0


def test_a_stream_that_never_rests_ends_in_time_too(endless, tmp_path, monkeypatch):
    monkeypatch.setattr(Endless, "read", lambda self, size: time.sleep(0.01) or b"y\n")
    with pytest.raises(ResourceError, match="did not end within"):
        copy_stream(str(tmp_path / "copy"), 0.2, None)


def test_all_of_a_stream_is_copied(tmp_path, monkeypatch):
    data = os.urandom(3_000_000)
    (tmp_path / "a").write_bytes(data)
    for timeout_s in (None, 60.0):
        with (tmp_path / "a").open() as stream:
            monkeypatch.setattr(sys, "stdin", stream)
            left_s = copy_stream(str(tmp_path / f"copy{timeout_s}"), timeout_s, None)
        assert (tmp_path / f"copy{timeout_s}").read_bytes() == data
        assert (left_s is None) == (timeout_s is None)


def test_a_stream_that_cannot_be_read_or_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="closed"):
        read_stream()
    with open(os.devnull) as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        with pytest.raises(OutputError, match="cannot be kept"):
            copy_stream(str(tmp_path / "none" / "copy"), None, None)


def test_within_the_limits_the_result_is_the_same(tmp_path, scratch):
    plain = msal_on(SCAN, "denoise", "-", "-q").stdout_bytes
    made = msal_on(SCAN, "denoise", "-", "--timeout", "5m", "--memory-limit", "2G")
    assert made.exit_code == 0, made.stderr
    assert made.stdout_bytes == plain
    assert made.stderr.startswith("standard input -> standard output in ")
    output = tmp_path / "new" / "out.obj.gz"
    made = msal_on(SCAN, "denoise", "-", "-o", output, "--timeout", "5m", "--json", "-q")
    record = record_of(made)
    assert (record["input"], record["output"]) == ("-", str(output))
    assert record["format"] == "ply"
    assert output.read_bytes()[:2] == b"\x1f\x8b"


def test_a_file_is_known_by_its_name(tmp_path, scratch):
    scan = folder_of(tmp_path / "in", scan=BAD_SCAN) / "scan.ply"
    made = msal("denoise", scan, "-o", "-", "--memory-limit", "2G")
    assert made.exit_code == 1
    assert made.stdout == ""
    assert "scan.ply" in made.stderr and "(E_INDEX)" in made.stderr


def test_a_worker_that_takes_too_long_is_ended(tmp_path, scratch):
    scan = folder_of(tmp_path / "in", scan=SCAN) / "scan.ply"
    report = tmp_path / "r.json"
    made = msal("denoise", scan, "-o", "-", "--timeout", "0.001", "--report", report)
    assert made.exit_code == 1
    assert made.stdout == ""
    assert "it was not done within 0.001 s (E_TIMEOUT)" in made.stderr
    (record,) = json.loads(report.read_bytes())["records"]
    assert (record["input"], record["error"]["code"]) == (str(scan), "E_TIMEOUT")


def test_a_mesh_that_takes_too_much_is_refused(tmp_path, scratch):
    made = msal_on(SCAN * 60, "denoise", "-", "--memory-limit", "51M")
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
