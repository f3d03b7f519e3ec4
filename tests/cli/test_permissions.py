"""What commands make of a private mesh is private, too; reports are not."""

from __future__ import annotations

import os

import pytest

from tests.cli.scans import closed_scan, folder_of, msal, process

pytestmark = pytest.mark.skipif(os.name != "posix", reason="permission bits of POSIX")


@pytest.fixture
def scan(tmp_path):
    path = folder_of(tmp_path, scan=closed_scan()) / "scan.ply"
    path.chmod(0o600)
    return path


@pytest.fixture(autouse=True)
def umask():
    before = os.umask(0o022)
    yield
    os.umask(before)


def mode_of(path):
    return path.stat().st_mode & 0o777


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("out.ply", ("denoise", "SCAN", "--method", "al", "-o", "OUT")),
        ("out.ply", ("noise", "SCAN", "-o", "OUT")),
        ("out.ply", ("compare", "SCAN", "SCAN", "--heatmap", "OUT")),
        ("out.html", ("view", "SCAN", "-o", "OUT")),
        ("out.png", ("view", "SCAN", "--size", "48", "-o", "OUT")),
        ("out.png", ("sweep", "SCAN", "--columns", "K=1", "--size", "48", "-o", "OUT")),
    ],
)
def test_outputs_are_as_private_as_the_mesh(scan, tmp_path, name, words):
    out = tmp_path / name
    made = msal(*({"SCAN": scan, "OUT": out}.get(word, word) for word in words))
    assert made.exit_code == 0, made.stderr
    assert mode_of(out) == 0o600


def test_a_private_file_that_the_shell_redirects(scan, tmp_path):
    out = tmp_path / "out.ply"
    with scan.open("rb") as stream:
        done = process("denoise", "-", "-o", out, "--method", "al", "-q", stdin=stream)
    assert done.returncode == 0
    assert mode_of(out) == 0o600


def test_a_report_has_no_mesh_in_it(scan, tmp_path):
    report = tmp_path / "run.json"
    words = ("--method", "al", "--report", report)
    assert msal("denoise", scan, "-o", tmp_path / "out.ply", *words).exit_code == 0
    assert mode_of(report) == 0o644
