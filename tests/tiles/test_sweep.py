"""A mesh denoised by tiles has the very bits that it has in memory."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis import harm
from msal_cli.mesh import prepare_mesh
from msal_cli.tiles import measures
from tests.shapes import ball, fan, grid, noisy, torus
from tests.tiles.fakes import FakeMesh
from tests.tiles.whole_run import check_same


def to_mesh(vertices: np.ndarray, faces: np.ndarray, dtype: type = np.float32) -> FakeMesh:
    return FakeMesh(np.ascontiguousarray(vertices, dtype=dtype), faces.astype(np.uint32))


def noisy_ball(dtype: type = np.float32) -> FakeMesh:
    vertices, faces = ball(40, 20)
    return to_mesh(noisy(vertices, level=0.03), faces, dtype)


def noisy_grid(rows: int = 24, columns: int = 30) -> FakeMesh:
    vertices, faces = grid(rows, columns)
    return to_mesh(noisy(vertices, level=0.2), faces)


@pytest.mark.parametrize("method", ["al", "msal"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_closed_mesh(monkeypatch, tmp_path, method, dtype):
    scratch = check_same(monkeypatch, tmp_path, noisy_ball(dtype), method)
    assert len(scratch.finished("prepare")) > 8


@pytest.mark.parametrize(
    ("method", "given"),
    [
        ("al", {"iterations": 0}),
        ("al", {"boundary": "fixed", "mollify": 3}),
        ("al", {"schedule": "constant", "weights": "tukey"}),
        ("al", {"schedule": "robust", "iterations": 2}),
        ("al", {"schedule": "wiener", "noise": 0.2, "iterations": 2}),
        ("al", {"scaling": "mass", "normals": "area"}),
        ("msal", {"boundary": "fixed", "iterations": 2}),
    ],
)
def test_an_open_mesh(monkeypatch, tmp_path, method, given):
    check_same(monkeypatch, tmp_path, noisy_grid(), method, given)


def test_positions_are_exchanged_between_iterations(monkeypatch, tmp_path):
    members = "0.5*guided_normal(iterations=2,vertex_iterations=1)+0.5*msal(iterations=2)"
    given = {"members": members, "relax": 1}
    check_same(monkeypatch, tmp_path, noisy_grid(80, 8), "blend", given, tile_vertices=100)


def test_vertices_in_any_order(monkeypatch, tmp_path):
    mesh = noisy_ball()
    rng = np.random.default_rng(3)
    order = rng.permutation(mesh.n_vertices)
    mesh.faces = np.argsort(order)[mesh.faces].astype(np.uint32)[rng.permutation(mesh.n_polygons)]
    mesh.vertices = mesh.vertices[order]
    check_same(monkeypatch, tmp_path, mesh, "msal")


def test_tiles_of_a_vertex_or_so(monkeypatch, tmp_path):
    vertices, faces = torus(6, 5)
    mesh = to_mesh(noisy(vertices, level=0.1), faces)
    scratch = check_same(monkeypatch, tmp_path, mesh, tile_vertices=1)
    counts = [one["own"] for one in scratch.results("prepare").values()]
    assert min(counts) <= 1
    assert len(counts) >= 30


def test_tasks_can_be_repeated(monkeypatch, tmp_path):
    mesh = noisy_grid()
    mesh.faces[::7] = mesh.faces[::7, ::-1]
    check_same(
        monkeypatch, tmp_path, mesh, "msal", {"iterations": 2}, is_repeated=True, tile_vertices=200
    )


def test_a_mesh_that_stays_as_it_is(monkeypatch, tmp_path):
    check_same(monkeypatch, tmp_path, noisy_grid(), "none", tile_vertices=200)


def test_harm_is_found(monkeypatch, tmp_path):
    mesh = noisy_ball()
    given = {"iterations": 60}
    scratch = check_same(monkeypatch, tmp_path, mesh, "umbrella", given, tile_vertices=200)
    assert measures.changes_of(scratch).harm is not None


def test_folds_are_counted(monkeypatch, tmp_path):
    monkeypatch.setattr(harm, "MOST_SAMPLED", 300)
    vertices, faces = grid(24, 30)
    mesh = to_mesh(noisy(vertices, level=0.6), faces)
    scratch = check_same(monkeypatch, tmp_path, mesh, tile_vertices=200)
    folds = sum(one["measures"]["folds"] for one in scratch.results("denoise-0").values())
    step = harm.sampling_step(len(faces))
    expected = harm.folded_faces(prepare_mesh(mesh.vertices, faces).mesh)
    assert folds * step == expected > 0
    assert step > 1


def test_a_spike_rules_lambda_in_both(monkeypatch, tmp_path):
    mesh = noisy_grid(40, 50)
    mesh.vertices[777, 2] += 30.0
    scratch = check_same(monkeypatch, tmp_path, mesh, "msal", tile_vertices=500)
    assert measures.is_ruled_by_spike(scratch)
    scratch = check_same(
        monkeypatch, tmp_path / "other", noisy_grid(40, 50), "msal", tile_vertices=500
    )
    assert not measures.is_ruled_by_spike(scratch)


def test_a_vertex_with_faces_in_many_tiles(monkeypatch, tmp_path):
    vertices, faces = fan(np.random.default_rng(0).uniform(-0.1, 0.1, 500))
    check_same(monkeypatch, tmp_path, to_mesh(vertices, faces), tile_vertices=40)


def test_coincident_vertices_are_one(monkeypatch, tmp_path):
    mesh = noisy_ball()
    soup = FakeMesh(
        mesh.vertices[mesh.faces.reshape(-1)],
        np.arange(mesh.faces.size, dtype=np.uint32).reshape(-1, 3),
    )
    check_same(monkeypatch, tmp_path, soup, "msal", tile_vertices=600)


def test_useless_vertices_and_faces(monkeypatch, tmp_path):
    mesh = noisy_grid()
    rng = np.random.default_rng(5)
    stray = rng.uniform(-40.0, 40.0, (200, 3)).astype(np.float32)
    # Vertices that only degenerate faces use, and seams between some others.
    n = mesh.n_vertices
    twins = rng.choice(n, 50, replace=False)
    mesh.vertices = np.concatenate([mesh.vertices, stray, mesh.vertices[twins]])
    faces = mesh.faces.copy()
    for k, twin in enumerate(twins):
        f = rng.choice(np.flatnonzero((mesh.faces == twin).any(axis=1)))
        faces[f][faces[f] == twin] = n + 200 + k
    degenerate = np.stack([n + np.arange(60), n + np.arange(60), twins[rng.integers(0, 50, 60)]], 1)
    doubled = faces[rng.choice(len(faces), 40, replace=False)]
    collapsed = np.stack([twins, n + 200 + np.arange(50), rng.integers(0, n, 50)], axis=1)
    faces = np.concatenate([faces, degenerate, collapsed])
    mesh.faces = faces[rng.permutation(len(faces))].astype(np.uint32)
    check_same(monkeypatch, tmp_path, mesh, tile_vertices=130)
    mesh.faces = np.concatenate([mesh.faces, np.roll(doubled, 1, axis=1)]).astype(np.uint32)
    check_same(monkeypatch, tmp_path / "doubled", mesh, "msal", tile_vertices=130)


def test_parts_are_counted_across_tiles(monkeypatch, tmp_path):
    parts = []
    n = 0
    faces = []
    for k in range(9):
        vertices, own = torus(10 + k, 6)
        parts.append(noisy(vertices + (9.0 * (k % 3), 9.0 * (k // 3), 0.0), level=0.1))
        faces.append(own + n)
        n += len(vertices)
    mesh = to_mesh(np.concatenate(parts), np.concatenate(faces))
    check_same(monkeypatch, tmp_path, mesh, tile_vertices=200)
    check_same(monkeypatch, tmp_path / "fine", mesh, tile_vertices=40)
