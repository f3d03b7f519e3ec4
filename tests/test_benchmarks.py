"""The benchmarks: their meshes, scans, settings, measures and tables; of speed from end to end.

Tests that compare with ``methods.names()`` fail for a new method; they say what to run.
"""

import re
import sys

import numpy as np
import pytest

from benchmarks import (
    accuracy_tables,
    auto_seconds,
    batch,
    clean_files,
    giant_mesh,
    ground_truth,
    large_file,
    measured,
    scanner_cases,
    scanner_outcomes,
    scanners,
    small_file,
    stages,
    wishes,
)
from benchmarks.accuracy_grid import Setting, defaults, grid
from benchmarks.accuracy_outcomes import AUTO, NOISY, Outcome
from benchmarks.scan_simulation import ScannerSettings, simulate_scan
from benchmarks.scanner_cases import Pair
from benchmarks.scanner_settings import PEER_SETTINGS
from msal_cli import codecs, methods
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import prepare_mesh
from tests.files import ROOT
from tests.shapes import ball, torus


@pytest.mark.parametrize("order", giant_mesh.ORDERS)
def test_the_surface_is_the_same_in_every_order(order, tmp_path, monkeypatch):
    monkeypatch.setattr(giant_mesh, "_AT_ONCE", 1000)
    monkeypatch.setattr(giant_mesh, "_BLOCK", 256)
    path = tmp_path / "giant.ply"
    giant_mesh.main([str(path), "--millions", "0.0048", "--order", order])
    rows = giant_mesh.GiantMesh(40)
    mesh = codecs.open_mesh(path.read_bytes(), path.name)
    n = rows.n_vertices
    expected = rows.positions(np.arange(n))
    assert len(mesh.vertices) == n == 4800
    ready = prepare_mesh(mesh.vertices, mesh.faces)
    assert ready.defects.boundary_edges == ready.defects.inconsistent_edges == 0
    assert ready.defects.components == 1 and ready.defects.duplicate_faces == 0
    assert (np.unique(mesh.vertices, axis=0) == np.unique(expected, axis=0)).all()
    triangles = mesh.vertices[mesh.faces].reshape(-1, 9)
    same = expected[rows.corners(np.arange(2 * n))].reshape(-1, 9)
    assert (np.unique(triangles, axis=0) == np.unique(same, axis=0)).all()
    if order == "rows":
        assert (mesh.vertices == expected).all()
    else:
        assert not (mesh.vertices == expected).all()


A_NEW_METHOD = (
    "For a new method: add its settings to benchmarks/accuracy_grid.py, run `MSAL_DATA=FOLDER "
    "python -m benchmarks.accuracy --cache accuracy.json` (--quick leaves out large models), "
    "and put the tables that it prints into benchmarks/results/accuracy.txt"
)

SETTINGS = [Setting("al", {}), Setting("al", {"iterations": 1}), Setting("wiener", {})]


@pytest.mark.parametrize("coarse", [False, True])
def test_the_grid_has_every_default_and_nothing_twice(coarse):
    settings = grid(coarse)
    assert settings[0] == defaults()[0]
    assert {setting.method for setting in settings if setting.is_default} == set(methods.names()), (
        A_NEW_METHOD
    )
    texts = [setting.text for setting in settings]
    assert len(set(texts)) == len(texts) > 50
    distinct = {
        (setting.method, *methods.find(setting.method).validate(setting.given).items())
        for setting in settings
    }
    assert len(distinct) == len(settings)


def rows():
    """Two models; which setting is best differs with the model and the measure."""
    al, short, wiener = (setting.text for setting in SETTINGS)
    return {
        "one": {
            NOISY: Outcome(20.0, 16.0, 0.0),
            al: Outcome(4.0, 10.0, -1.0),
            short: Outcome(8.0, 6.0, 0.0),
            wiener: Outcome(5.0, 5.0, 0.0),
            AUTO: Outcome(5.0, 5.0, 0.5, "noise 0.1 e; because"),
        },
        "two": {
            NOISY: Outcome(20.0, 16.0, 0.0),
            al: Outcome(6.0, 10.0, 0.0),
            short: Outcome(7.0, 8.0, 0.0),
            wiener: Outcome(9.0, 9.0, 0.0),
            AUTO: Outcome(5.0, 7.0, 0.0),
        },
    }


def test_a_summary_by_hand():
    lines = accuracy_tables.summary("organic", rows(), SETTINGS)
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]
    found = {label: values for label, *values in cells}
    assert lines[0].startswith("| organic: 2 models | angle | vertex error |")
    assert found["best published setting, by angle"] == ["5.00", "10.00", "`al`"]
    assert found["best published setting, by vertex error"] == ["7.50", "7.00", "`al` iterations=1"]
    # 7 x 7 is less than 5 x 10 and 7.5 x 7.
    assert found["best setting of this package, by both"] == ["7.00", "7.00", "`wiener`"]
    assert found["tuned for each model, by angle"] == ["5.00", "10.00", ""]
    assert found["tuned for each model, by vertex error"] == ["6.00", "6.50", ""]
    assert found["tuned for each model, by both"] == ["6.00", "6.50", ""]
    assert found["**`--auto`**"] == ["5.00", "6.00", ""]
    assert found["goal"] == ["5.40", "7.80", ""]
    assert found["`--auto` / best published setting"] == ["1.00", "0.86", ""]
    assert found["`--auto` / tuning for both at once"] == ["0.83", "0.92", ""]


def test_the_page_has_every_class_and_every_method():
    page = (ROOT / "benchmarks/results/accuracy.txt").read_text("utf-8")
    for of in ground_truth.CLASSES:
        part = page.partition(f"\n### {of.capitalize()}\n")[2].partition("\n### ")[0]
        assert "**`--auto`**" in part, of
        for name in methods.names():
            assert f"\n| `{name}` | " in part, f"{of} has no row for {name}. {A_NEW_METHOD}"


# Scanners


SPHERE = prepare_mesh(*ball(48, 24)).mesh
"""A sphere of radius 1."""


@pytest.mark.parametrize("scanner", ["voxels", "ct", "slices", "depth", "fusion"])
def test_a_seed_makes_one_scan_and_solids_stay_closed_and_of_their_volume(scanner):
    pytest.importorskip("fcpw")
    pytest.importorskip("skimage")
    made, again, other = (
        simulate_scan(SPHERE, ScannerSettings(scanner, cells=24, seed=seed)) for seed in (3, 3, 4)
    )
    assert np.array_equal(made.vertices, again.vertices)
    assert np.array_equal(made.faces, again.faces)
    assert not np.array_equal(made.vertices[:9], other.vertices[:9])
    if scanner in ("voxels", "ct", "slices"):
        defects = prepare_mesh(made.vertices, made.faces).defects
        assert not defects.boundary_edges and not defects.non_manifold_edges
        assert defects.components == 1
        volume = area_and_volume(SPHERE.vertices, SPHERE.faces)[1]
        assert area_and_volume(made.vertices, made.faces)[1] == pytest.approx(volume, rel=0.05)


def test_errors_of_a_known_result():
    # A ball that shrinks by a tenth keeps its normals, and its vertices move inwards by a tenth.
    true = prepare_mesh(*ball(24, 12)).mesh
    small = true.with_vertices(0.9 * true.vertices)
    same = scanner_outcomes.measure_errors(Pair(small, true), small)
    assert same.angle_deg == pytest.approx(0.0, abs=1e-5)
    assert same.vertex_percent == pytest.approx(10.0 / true.mean_edge_length, rel=1e-6)
    assert same.distance_percent == pytest.approx(same.vertex_percent, rel=0.02)
    # Other faces: a finer ball is nearer than the facets of the coarse one are wide.
    finer = prepare_mesh(*ball(96, 48)).mesh
    other = scanner_outcomes.measure_errors(Pair(small, finer), small)
    assert other.vertex_percent is None
    assert 0.0 < other.angle_deg < 10.0
    expected = 10.0 / small.mean_edge_length
    assert other.distance_percent == pytest.approx(expected, rel=0.05)


def test_the_section_is_printed_without_any_peer(tmp_path, capsys, monkeypatch):
    pytest.importorskip("fcpw")
    small = prepare_mesh(*torus(32, 16)).mesh
    monkeypatch.setattr(scanner_cases, "sources", lambda: {"torus": lambda: small})
    monkeypatch.setattr(scanner_cases.ground_truth, "data_folder", lambda: None)
    monkeypatch.delenv("MSAL_PEERS_PYTHON", raising=False)
    cache = ["--cache", str(tmp_path / "cache.json")]
    words = [*cache, "--only", "plain", "--kinds", "normals", "clean"]
    scanners.main(words)
    printed = capsys.readouterr().out
    assert "## Noise as scanners make it" in printed
    (row,) = (line for line in printed.splitlines() if line.startswith("| normals 0.2 (1) |"))
    noisy, _, plain = (cell.strip() for cell in row.split("|")[2:5])
    assert float(plain.split("/")[0]) < float(noisy.split("/")[0])
    for setting in PEER_SETTINGS:
        assert f"| {setting.label} |" in printed
    scanners.main(words)
    assert capsys.readouterr().out == printed


# Speed


on_linux = pytest.mark.skipif(sys.platform != "linux", reason="measures by fork and /proc")


@on_linux
@pytest.mark.ci
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


PEER = f"--forms ply-ascii --peers meshio_mean --peers-python {sys.executable}"


SCRIPTS = [
    (large_file, f"--around 24 --cores all --repeats 1 --folder . {PEER}"),
    (small_file, "--around 24 --repeats 1 --cores one --forms obj"),
    (stages, "--around 24 --repeats 1 --forms obj"),
    (auto_seconds, "--across 12 --cores one --repeats 1 --folder ."),
    (batch, "--files 6 --most 300 --sample 1 --repeats 1 --folder ."),
    (clean_files, f"{ROOT / 'sample_meshes'} --most 1"),
    (wishes, f"{ROOT / 'sample_meshes'} --most 1"),
]
MARKS = [pytest.mark.ci] + (len(SCRIPTS) - 1) * [pytest.mark.slow]


@on_linux
@pytest.mark.parametrize(
    ("script", "words"),
    [pytest.param(*row, marks=mark) for row, mark in zip(SCRIPTS, MARKS, strict=True)],
)
def test_scripts_print_a_table(script, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    script.main(words.split())
    said = capsys.readouterr().out
    assert re.search(r"^\| .* \|$", said, re.M)
    assert script is not large_file or re.search(r"^\| meshio and numpy \| \d.*moved 0", said, re.M)
