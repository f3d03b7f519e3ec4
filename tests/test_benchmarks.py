"""The benchmarks of speed run from end to end, on tiny meshes, against what msal itself needs."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import (
    auto_seconds,
    batch,
    contest,
    fidelity,
    ground_truth,
    large_file,
    machine,
    measured,
    peers,
    scans,
    small_file,
    stages,
)

PEER = ["--peers", "meshio_mean", "--peers-python", sys.executable]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="measures by fork and /proc")


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


def test_the_forms_of_a_scan_hold_the_same_mesh(tmp_path):
    import trimesh

    made = scans.scan("vase", 12, 9, 0.1, seed=0)
    for form in scans.FORMS:
        path = scans.file_of(tmp_path, "scan", form, lambda: made)
        read = trimesh.load_mesh(path, process=False)
        corners = read.vertices[read.faces]
        assert np.allclose(corners, made.vertices[made.faces], atol=1e-6), form


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


@pytest.mark.parametrize("peer", peers.PEERS, ids=lambda peer: peer.script)
def test_every_peer_has_its_script(peer):
    path = Path(peer.command("python", Path("in.ply"), Path("out.ply"))[1])
    tree = ast.parse(path.read_text(encoding="utf-8"))
    functions = {one.name: one for one in tree.body if isinstance(one, ast.FunctionDef)}
    assert [one.arg for one in functions["denoise"].args.args] == ["source", "target"]
    assert "msal" not in ast.dump(tree)
    steps = [one.value for one in tree.body if isinstance(one, ast.Assign)]
    assert 4 in [one.value for one in steps if isinstance(one, ast.Constant)]


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


def test_a_peer_that_is_not_there_is_skipped(monkeypatch, capsys):
    monkeypatch.setattr(peers, "PEERS", (peers.Peer("nonsuch", "No such tool", ("no-such",)),))
    assert peers.installed(sys.executable)[0] == []
    assert "skipped: No such tool" in capsys.readouterr().err


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


def test_large_file_prints_its_tables(tmp_path, capsys):
    words = ["--around", "24", "--repeats", "1", "--cores", "all", "--folder", str(tmp_path)]
    large_file.main([*words, "--forms", "ply-ascii", *PEER])
    said = capsys.readouterr().out
    assert machine.processor() in said
    rows = re.findall(
        r"^\| (\*\*msal\*\*|meshio and numpy) \| \d.*moved 0\.\d+ \| 1 \|$", said, re.M
    )
    assert rows == ["**msal**", "meshio and numpy"]
    assert len(re.findall(r"^\| ascii PLY \| all \d+ \| .*\(meshio", said, re.M)) == 1


@pytest.mark.slow
def test_small_file_prints_its_tables(capsys):
    small_file.main(["--around", "24", "--repeats", "1", "--cores", "one", "--forms", "obj", *PEER])
    said = capsys.readouterr().out
    assert len(re.findall(r"^\| OBJ \| one \| .*\(meshio", said, re.M)) == 1


@pytest.mark.slow
def test_stages_prints_its_table(capsys):
    stages.main(["--around", "24", "--repeats", "1", "--forms", "obj"])
    assert re.search(r"^\| OBJ \| \d.* \d+\.\d % \| \d+ \|$", capsys.readouterr().out, re.M)


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


@pytest.mark.slow
def test_auto_seconds_prints_its_table(tmp_path, capsys):
    words = ["--across", "12", "--repeats", "1", "--cores", "one", "--folder", str(tmp_path)]
    auto_seconds.main(words)
    said = capsys.readouterr().out
    assert re.search(r"^\| 432 \| one \| default \| .* \| 1\.0 \| 1\.0 \|$", said, re.M)
    assert re.search(r"^\| 432 \| one \| --auto \| .* \| \d+\.\d \|$", said, re.M)
    assert re.search(r"^432 vertices: noise 0\.\d", said, re.M)


def test_batch_prints_its_tables(tmp_path, capsys):
    words = ["--files", "6", "--most", "300", "--repeats", "1", "--sample", "1"]
    batch.main([*words, "--folder", str(tmp_path), *PEER])
    said = capsys.readouterr().out
    assert "6 scans" in said
    assert re.search(r"^\| \*\*msal\*\* \| \d", said, re.M)
    assert re.search(r"^\| meshio and numpy \| \d.* \| 6 files \|$", said, re.M)
    assert re.search(r"^\| meshio and numpy, a process per file \| \d.* \| 1 files \|$", said, re.M)
    # Another run finds the scans that this one left, and makes none.
    assert sorted(path.name for path in tmp_path.iterdir()) == ["scans-6-300"]


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
