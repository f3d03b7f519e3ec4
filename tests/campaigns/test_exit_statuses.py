"""Every exit status of the real command, and no escape sequence where nobody looks."""

from __future__ import annotations

import os
import re
import subprocess

import pytest

from tests.campaigns.runs import IS_LINUX
from tests.cli.scans import BAD_SCAN, MSAL, closed_scan, folder_of, msal, process
from tests.report.made import HOSTILE_NAMES


@pytest.fixture
def mixed(tmp_path):
    """A folder with a good scan, a bad one, and a bad one with a hostile name."""
    scans = folder_of(tmp_path / "in", a=closed_scan(), bad=BAD_SCAN)
    (scans / next(name for name in HOSTILE_NAMES if "\x1b" in name)).write_bytes(BAD_SCAN)
    return scans


def is_plain(*texts):
    return not any(b"\x1b" in one or b"\r" in one or b"Traceback" in one for one in texts)


# 129, 130 and 143 are those of tests/campaigns/test_interrupts.py, 141 that of test_streams.py.
def test_every_status(mixed, tmp_path):
    out = tmp_path / "out"
    cases = (
        (0, ["denoise", mixed / "a.ply", "-o", tmp_path / "o.ply"]),
        (1, ["denoise", mixed / "bad.ply", "-o", tmp_path / "o.ply"]),
        (2, ["denoise", tmp_path / "missing", "-o", out]),
        (3, ["denoise", mixed, "-o", out, "--json", "-vv", "--log-file", tmp_path / "log"]),
        (5, ["denoise", mixed, "-o", out, "--include", "*.stl"]),
    )
    for status, words in cases:
        # Neither a terminal's name nor a wish for colours makes a pipe a terminal.
        made = process(*words, env={"TERM": "xterm-256color", "CLICOLOR": "1"})
        assert made.returncode == status, (words, made.stderr)
        assert is_plain(made.stdout, made.stderr), words
    assert is_plain((tmp_path / "log").read_bytes())


def test_no_command_prints_escapes_off_a_terminal(mixed, tmp_path):
    out = tmp_path / "out"
    cases = (
        (3, ["denoise", mixed, "-o", out]),
        (3, ["denoise", mixed, "-o", out, "-q"]),
        (0, ["denoise", mixed, "-o", out, "--dry-run", "--include", "a.ply"]),
        (3, ["info", mixed]),
        (3, ["info", mixed, "--json"]),
        (0, ["methods"]),
        (0, ["methods", "msal", "--json"]),
        (0, ["report", out]),
        (0, ["report", out, "--json"]),
        (0, ["completion", "bash"]),
        (0, ["--help"]),
        (2, ["denoise"]),
        (2, []),
    )
    for status, words in cases:
        made = msal(*words)
        assert made.exit_code == status, (words, made.stderr)
        assert is_plain(made.stdout_bytes, made.stderr_bytes), words


@pytest.mark.skipif(not IS_LINUX, reason="needs a pseudo terminal")
@pytest.mark.parametrize(
    "environment", [{"NO_COLOR": "1"}, pytest.param({"TERM": "dumb"}, marks=pytest.mark.slow)]
)
def test_a_terminal_without_colours(mixed, tmp_path, environment):
    import pty

    leader, follower = pty.openpty()
    words = [*MSAL, "denoise", str(mixed), "-o", str(tmp_path / "out")]
    with subprocess.Popen(
        words, stdout=follower, stderr=follower, env={**os.environ, **environment}
    ) as running:
        os.close(follower)
        said = b""
        while True:
            try:
                part = os.read(leader, 65536)
            except OSError:
                break
            if not part:
                break
            said += part
    os.close(leader)
    assert running.returncode == 3
    assert b"failed: 2" in said
    # A bar moves the cursor, but nothing is coloured, and no name reaches the terminal.
    assert (
        not re.search(rb"\x1b\[[0-9;]*m", said) and b"\x1b]" not in said and b"\x1b[2J" not in said
    )
