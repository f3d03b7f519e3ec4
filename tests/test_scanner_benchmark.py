"""The benchmark of scanner noise: its cases, its measures, its cache and its tables."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import scanner_cases, scanner_outcomes, scanners
from benchmarks.scanner_cases import Case, Pair
from benchmarks.scanner_outcomes import NOISY
from benchmarks.scanner_settings import PEER_SETTINGS
from benchmarks.true_surface import TrueSurface, corner_normals
from msal_cli.analysis.surface_distance import nearest_on_surface
from msal_cli.kernels.geometry import face_normals
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import ball, cube, torus

pytest.importorskip("fcpw")


def small_torus() -> Mesh:
    return prepare_mesh(*torus(32, 16)).mesh


@pytest.fixture
def one_model(monkeypatch):
    """A torus in place of all models, and no data."""
    monkeypatch.setattr(scanner_cases, "sources", lambda: {"torus": small_torus})
    monkeypatch.setattr(scanner_cases.ground_truth, "data_folder", lambda: None)


def test_every_kind_changes_its_model_and_repeats(one_model):
    for kind, cases in scanner_cases.cases().items():
        (case,) = cases
        pair, again = case.make(), case.make()
        assert np.array_equal(pair.noisy.vertices, again.noisy.vertices), kind
        has_moved = not np.array_equal(pair.noisy.vertices, pair.true.vertices)
        assert has_moved == (kind != scanner_cases.CLEAN), kind


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


def test_true_normals_are_smooth_on_a_ball_and_sharp_on_a_cube():
    coarse = prepare_mesh(*ball(24, 12)).mesh
    points = prepare_mesh(*ball(96, 48)).mesh.vertices
    radial = points / np.linalg.norm(points, axis=1)[:, None]
    facets = face_normals(coarse.vertices, coarse.faces)[nearest_on_surface(points, coarse)[0]]
    smooth = TrueSurface(coarse).normals_at(points)
    errors = [
        np.arccos(np.clip((normals * radial).sum(axis=1), -1, 1)) for normals in (smooth, facets)
    ]
    assert errors[0].mean() < 0.3 * errors[1].mean()
    box = prepare_mesh(*cube()).mesh
    normals = face_normals(box.vertices, box.faces)
    assert np.allclose(corner_normals(box), normals[:, None, :])


def test_the_cache_is_used_until_the_mesh_changes(tmp_path, monkeypatch):
    path = tmp_path / "cache.json"
    made = []

    def make(level: float) -> Pair:
        made.append(level)
        true = small_torus()
        return Pair(true.with_vertices((1.0 + level) * true.vertices), true)

    def rows(level: float, again: bool = False):
        outcomes = scanner_outcomes.Outcomes(path, None)
        case = Case("kind", "model", lambda: make(level))
        if again:
            outcomes.forget(["msal"], [case.key])
        return outcomes.run([case], ["msal"], PEER_SETTINGS)["model"]

    first = rows(0.1)
    assert set(first) == {NOISY, "msal"}
    assert rows(0.2) == first and made == [0.1]
    changed = rows(0.2, again=True)
    assert made == [0.1, 0.2]
    assert changed[NOISY].errors.distance_percent > first[NOISY].errors.distance_percent


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
