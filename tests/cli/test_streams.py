"""A mesh through standard input and output, within bounds of memory and time."""

import gzip
import hashlib
import subprocess
import sys

import pytest

from msal_cli import machine
from msal_cli.cli.streams import choose_format, find_stream, read_stream
from msal_cli.errors import InputError, ResourceError, TooLargeError, UsageError
from msal_cli.job.settings import Task
from msal_cli.storage import regular
from tests.cli.scans import MSAL, closed_scan, msal, msal_on, process, record_of
from tests.files import Terminal

SCAN = closed_scan()


class Endless:
    """Standard input of ``yes``; counts what was read."""

    def __init__(self):
        self.buffer = self
        self.n_read = 0

    def read(self, size):
        self.n_read += size
        assert self.n_read < 1 << 30, "it is read without end"
        return b"y\n" * (size // 2)


@pytest.fixture
def endless(monkeypatch):
    stream = Endless()
    monkeypatch.setattr(sys, "stdin", stream)
    return stream


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


def test_a_standard_input_that_is_closed(monkeypatch):
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="closed"):
        read_stream()


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


def test_a_mesh_does_not_go_to_a_terminal_unasked(monkeypatch):
    monkeypatch.setattr(sys, "stdout", Terminal())
    with pytest.raises(UsageError, match="would go to the terminal"):
        find_stream(("-",), None)
    assert find_stream(("-",), "-") == Task("-", "-", "-")


@pytest.mark.parametrize(
    ("target", "to", "format"),
    [("-", None, None), ("-", "stl", "stl"), ("o.stl", None, "stl"), ("o.obj.gz", None, "obj")]
    + [("o.PLY", "ply", "ply"), ("o.dat", None, None), ("o.dat", "stl", "stl")],
)
def test_the_format_of_the_target(target, to, format):
    assert choose_format(target, to) == format


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
