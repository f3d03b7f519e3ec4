"""The benchmark of scanner noise: simulated scanners, measures, cache and tables."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import scanner_cases, scanner_outcomes, scanners
from benchmarks.scan_simulation import ScannerSettings, simulate_scan
from benchmarks.scanner_cases import Pair
from benchmarks.scanner_settings import PEER_SETTINGS
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import ball, torus

pytest.importorskip("fcpw")
pytest.importorskip("skimage")

SPHERE = prepare_mesh(*ball(48, 24)).mesh
"""A sphere of radius 1."""


def scan(scanner, cells=24, mesh=SPHERE, **settings):
    return simulate_scan(mesh, ScannerSettings(scanner, cells=cells, **settings))


@pytest.mark.parametrize("scanner", ["voxels", "ct", "slices"])
def test_a_solid_stays_closed_oriented_and_of_its_volume(scanner):
    made = scan(scanner)
    defects = prepare_mesh(made.vertices, made.faces).defects
    assert (defects.boundary_edges, defects.non_manifold_edges, defects.components) == (0, 0, 1)
    volume = area_and_volume(SPHERE.vertices, SPHERE.faces)[1]
    assert area_and_volume(made.vertices, made.faces)[1] == pytest.approx(volume, rel=0.05)


@pytest.mark.parametrize("scanner", ["voxels", "ct", "slices", "depth", "fusion"])
def test_the_same_seed_makes_the_same_scan_only(scanner):
    first, again, other = (scan(scanner, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.vertices, again.vertices)
    assert np.array_equal(first.faces, again.faces)
    assert not np.array_equal(first.vertices[:9], other.vertices[:9])


pytest.importorskip("fcpw")


def small_torus() -> Mesh:
    return prepare_mesh(*torus(32, 16)).mesh


@pytest.fixture
def one_model(monkeypatch):
    """A torus in place of all models, and no data."""
    monkeypatch.setattr(scanner_cases, "sources", lambda: {"torus": small_torus})
    monkeypatch.setattr(scanner_cases.ground_truth, "data_folder", lambda: None)


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


def test_the_section_is_printed_without_any_peer(one_model, tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("MSAL_PEERS_PYTHON", raising=False)
    words = [
        "--cache",
        str(tmp_path / "cache.json"),
        "--only",
        "plain",
        "--kinds",
        "normals",
        "clean",
    ]
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
