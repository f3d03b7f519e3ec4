"""The benchmarks of speed run from end to end, on tiny meshes, against what msal itself needs."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from benchmarks import auto_seconds, batch, clean_files, large_file, measured, small_file, stages

PEER = ["--peers", "meshio_mean", "--peers-python", sys.executable]

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="measures by fork and /proc"),
    pytest.mark.ci,
]


def test_a_run_is_measured():
    busy = [sys.executable, "-c", "held = bytearray(200 << 20)\nfor _ in range(10**6): pass"]
    ran = measured.run(busy, is_pinned=True)
    assert ran.fault == ""
    assert ran.seconds >= ran.cpu_seconds / 2 > 0.0
    assert 200 << 20 < ran.peak_bytes < 400 << 20
    cores = "import os, sys; sys.exit(len(os.sched_getaffinity(0)))"
    assert measured.run([sys.executable, "-c", cores], is_pinned=True).status == 1
    failed = measured.run([sys.executable, "-c", "raise OSError('no')"], is_pinned=False)
    assert failed.fault == "exit status 1: OSError: no"
    assert "nonsuch" in measured.run(["nonsuch"], is_pinned=False).fault


SAMPLES = Path(__file__).resolve().parents[1] / "sample_meshes"
ONE_RUN = ["--repeats", "1", "--folder", "."]
SCRIPTS = {
    large_file: (
        ["--around", "24", "--cores", "all", "--forms", "ply-ascii", *ONE_RUN, *PEER],
        [r"\| (\*\*msal\*\*|meshio and numpy) \| \d.*moved 0\.\d+ \| 1 \|"]
        + [r"\| ascii PLY \| all \d+ \| .*\(meshio.*"],
    ),
    small_file: (
        ["--around", "24", "--repeats", "1", "--cores", "one", "--forms", "obj", *PEER],
        [r"\| OBJ \| one \| .*\(meshio.*"],
    ),
    stages: (
        ["--around", "24", "--repeats", "1", "--forms", "obj"],
        [r"\| OBJ \| \d.* \d+\.\d % \| \d+ \|"],
    ),
    auto_seconds: (
        ["--across", "12", "--cores", "one", *ONE_RUN],
        [r"\| 432 \| one \| --method msal \| .* \| 1\.0 \| 1\.0 \|"]
        + [r"\| 432 \| one \| --auto \| .* \| \d+\.\d \|", r"432 vertices, --auto: noise 0.*"],
    ),
    batch: (
        ["--files", "6", "--most", "300", "--sample", "1", *ONE_RUN, *PEER],
        [r".*6 scans.*", r"\| \*\*msal\*\* \| \d.*"]
        + [r"\| meshio and numpy \| \d.* \| 6 files \|"]
        + [r"\| meshio and numpy, a process per file \| \d.* \| 1 files \|"],
    ),
    clean_files: (
        [str(SAMPLES), "--most", "1"],
        [r"plain command: 8 of 16 files pass", r"\| clean \| .*", r"\| 0\.97 to 1 \| .*"],
    ),
}
"""By script its options, and lines that it prints."""


@pytest.mark.parametrize(
    "script",
    [
        pytest.param(script, marks=[] if script is large_file else pytest.mark.slow)
        for script in SCRIPTS
    ],
    ids=lambda script: script.__name__,
)
def test_a_script_prints_its_tables(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options, lines = SCRIPTS[script]
    script.main(options)
    said = capsys.readouterr().out
    for line in lines:
        assert re.search(rf"^{line}$", said, re.M), line
