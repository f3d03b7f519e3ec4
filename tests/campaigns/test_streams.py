"""Standard streams that break: readers that go away, full disks; quiet, and with a status."""

from __future__ import annotations

import json
import os
import subprocess

import pytest

from tests.campaigns.runs import IS_LINUX, contents
from tests.cli.scans import MSAL, closed_scan, folder_of, ply_text, process
from tests.shapes import noisy, torus

pytestmark = pytest.mark.skipif(not IS_LINUX, reason="pipes and /dev/full")

FULL = "/dev/full"


def piped(*arguments, reader, unbuffered=""):
    """The status of msal while a shell command reads it, and what msal said."""
    with subprocess.Popen(
        [*MSAL, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
    ) as one:
        reading = subprocess.Popen(
            ["sh", "-c", reader], stdin=one.stdout, stdout=subprocess.DEVNULL
        )
        one.stdout.close()
        reading.wait()
        said = one.stderr.read().decode()
    return one.returncode, said


def test_a_reader_that_has_had_enough_is_no_noise(tmp_path):
    vertices, faces = torus(80, 40)
    # More than a pipe holds, so that writing goes on when the reader is gone.
    folder_of(tmp_path, big=ply_text(noisy(vertices, 0, 0.01), faces), small=closed_scan())
    big, small = tmp_path / "big.ply", tmp_path / "small.ply"
    for unbuffered in ("", "1"):
        words = ["denoise", big, "-o", "-", "-q"]
        assert piped(*words, reader="head -c 10", unbuffered=unbuffered) == (141, "")
    status, said = piped("info", small, reader="true")
    assert (status, said) in ((141, ""), (0, ""))
    folder_of(tmp_path / "in", **{f"s{n}": closed_scan() for n in range(2)})
    words = ["denoise", tmp_path / "in", "-o", tmp_path / "out", "-q", "--json"]
    status, said = piped(*words, "--report", tmp_path / "r.json", reader="exec <&-")
    assert (status, said) == (141, "")
    # The files are there all the same, and so is the report.
    assert sorted(contents(tmp_path / "out")) == ["s0.ply", "s1.ply"]
    assert json.loads((tmp_path / "r.json").read_bytes())["totals"]["written"] == 2


@pytest.mark.skipif(not os.path.exists(FULL), reason="no /dev/full")
def test_a_full_disk_behind_standard_output_costs_no_file(tmp_path):
    scans = folder_of(tmp_path / "in", a=closed_scan())
    with open(FULL, "wb") as full:
        made = process(
            *("denoise", scans, "-o", tmp_path / "out", "--json", "-q"),
            capture_output=False,
            stdout=full,
            stderr=subprocess.PIPE,
        )
    assert made.returncode == 1
    assert made.stderr.count(b"\n") == 1 and b"(E_WRITE)" in made.stderr
    assert list(contents(tmp_path / "out")) == ["a.ply"]


@pytest.mark.skipif(not os.path.exists(FULL), reason="no /dev/full")
def test_a_report_onto_a_device_is_refused_or_fails(tmp_path):
    scans = folder_of(tmp_path / "in", a=closed_scan())
    (tmp_path / "r.json").symlink_to(FULL)
    made = process("denoise", scans, "-o", tmp_path / "out", "--report", tmp_path / "r.json", "-q")
    assert made.returncode == 2 and b"device or a pipe" in made.stderr
    assert os.path.exists(FULL) and not os.path.isfile(FULL)
