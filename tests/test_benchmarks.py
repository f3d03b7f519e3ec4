"""The benchmarks of speed run from end to end, on tiny meshes, against what msal itself needs."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from benchmarks import (
    auto_seconds,
    batch,
    contest,
    fidelity,
    ground_truth,
    large_file,
    measured,
    scans,
    small_file,
    stages,
)

PEER = ["--peers", "meshio_mean", "--peers-python", sys.executable]

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="measures by fork and /proc"),
    pytest.mark.ci,
]


@pytest.mark.parametrize("surface", scans.SURFACES)
def test_a_scan_is_a_grid_with_noise(surface):
    smooth, noisy = (scans.scan(surface, 40, 20, noise, seed=3) for noise in (0.0, 0.2))
    closes = scans.SURFACES[surface].closes
    cells = (40 if closes[0] else 39) * (20 if closes[1] else 19)
    assert smooth.vertices.shape == (800, 3)
    assert smooth.faces.shape == (2 * cells, 3)
    assert set(smooth.faces.reshape(-1)) == set(range(800))
    # The faces are wound alike: no directed edge comes twice.
    edges = smooth.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(edges, axis=0)) == len(edges)
    moved = np.abs(noisy.vertices - smooth.vertices)
    assert 0.0 < moved.mean() < 1.0


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


def test_the_best_peer_is_a_tool_if_there_is_any():
    def row(title, seconds, **kind):
        ran = measured.Ran(
            {"seconds": seconds, "cpu_seconds": seconds, "peak_bytes": 1, "status": 0}, ""
        )
        return contest.Row(contest.Contestant(title, lambda *paths: [], **kind), [ran])

    msal = row("msal", 0.1, is_peer=False)
    by_hand = row("by hand", 0.2, is_by_hand=True)
    slow, fast, failed = row("slow", 2.0), row("fast", 1.0), row("failed", 0.5)
    failed.fault = "exit status 1"
    assert contest.best_peer([msal, by_hand, slow, failed, fast]) is fast
    assert contest.best_peer([msal, by_hand, failed]) is by_hand
    assert contest.best_peer([msal]) is None


def test_outputs_are_compared_with_inputs(tmp_path):
    made = scans.scan("torus", 12, 8, 0.1, seed=0)
    source = scans.file_of(tmp_path, "scan", "ply", lambda: made)
    half = scans.Scan(made.vertices, made.faces[::2])
    shifted = scans.Scan(made.vertices + np.float32(0.01), made.faces)
    words = []
    for n, one in enumerate((made, half, shifted)):
        words.append(
            contest.compared(source, scans.file_of(tmp_path, f"{n}", "ply", lambda one=one: one))
        )
    (tmp_path / "not.ply").write_bytes(b"nothing")
    words.append(contest.compared(source, tmp_path / "not.ply"))
    assert words[0] == "moved 0.000"
    assert words[1] == "96 faces"
    assert words[2] not in words[:2] and words[2].startswith("moved 0.0")
    assert words[3].startswith("not a mesh")


@pytest.mark.parametrize("across", [45, 108])
def test_the_rippled_torus_is_closed_and_as_noisy_as_said(across, monkeypatch):
    from msal_cli.mesh import prepare_mesh

    noisy = auto_seconds.rippled_torus(across)
    monkeypatch.setattr(auto_seconds, "NOISE", 0.0)
    smooth = auto_seconds.rippled_torus(across)
    ready = prepare_mesh(noisy.vertices, noisy.faces)
    assert len(noisy.vertices) == 3 * across**2 and len(noisy.faces) == 6 * across**2
    assert ready.defects.boundary_edges == ready.defects.inconsistent_edges == 0
    moved = np.linalg.norm(noisy.vertices - smooth.vertices, axis=1)
    spread = np.sqrt((moved**2).mean()) / ready.mesh.mean_edge_length
    assert spread == pytest.approx(0.15, rel=0.03)


def test_ways_of_pulling_back_are_held_against_the_truth(capsys, monkeypatch):
    from msal_cli.mesh import prepare_mesh
    from tests.shapes import torus

    vertices, faces = torus(32, 16)
    true = prepare_mesh(vertices, faces).mesh
    cases = [
        ground_truth.Case("torus", of, lambda: ground_truth.corrupted(true, 0.2, 1))
        for of in fidelity.CLASSES
    ]
    monkeypatch.setattr(ground_truth, "cases", lambda quick: iter(cases))
    monkeypatch.setattr(ground_truth, "data_folder", lambda: None)
    monkeypatch.setattr(
        fidelity, "ROWS", {label: settings[:2] for label, settings in fidelity.ROWS.items()}
    )
    fidelity.main(["--models"])
    printed = capsys.readouterr().out
    for of in fidelity.CLASSES:
        assert f"{of} (1 models)" in printed
    rows = [line.split("|") for line in printed.splitlines() if line.startswith("| ")]
    found = {row[1].strip(): row[3].strip() for row in rows if "/" in row[3]}
    noisy, wiener = (
        float(found[one].split("/")[0]) for one in ("noisy", "`wiener` method, default")
    )
    assert wiener < 0.6 * noisy


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
}
"""By script its options, and lines that it prints."""


@pytest.mark.parametrize(
    "script",
    [pytest.param(one, marks=[] if one is large_file else pytest.mark.slow) for one in SCRIPTS],
    ids=lambda script: script.__name__,
)
def test_a_script_prints_its_tables(script, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    options, lines = SCRIPTS[script]
    script.main(options)
    said = capsys.readouterr().out
    for line in lines:
        assert re.search(rf"^{line}$", said, re.M), line
