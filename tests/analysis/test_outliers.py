"""Outliers planted on known shapes are found and brought back, and what belongs stays."""

import numpy as np
import pytest

from benchmarks import ground_truth, machined_shapes
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.outliers import MAX_SHARE, find_outliers
from msal_cli.mesh import prepare_mesh
from tests.files import SAMPLES
from tests.shapes import ball, box, cube, grid, torus


def torus_mesh():
    return prepare_mesh(*torus(96, 48)).mesh


def cone(height, rings=12, around=24):
    """An open cone of base radius 1, its tip up."""
    vertices, faces = grid(around + 1, rings + 1)
    r, turn = vertices[:, 0] / rings, 2 * np.pi * (vertices[:, 1] % around) / around
    return np.stack([r * np.cos(turn), r * np.sin(turn), height * (1 - r)], axis=1), faces


def with_outliers(mesh, level, share, seed=1):
    """The mesh with noise, and a share of its vertices 1 to 3 edges off in random directions."""
    kind = AddedNoise("outliers", level=level, seed=seed, fraction=share)
    vertices = add_noise(mesh, kind)
    ways = np.linalg.norm(vertices - mesh.vertices, axis=1)
    return mesh.with_vertices(vertices), ways > 0.99 * mesh.mean_edge_length


CLEAN = {
    "cube": cube,
    "fine cube": lambda: box(12, 12, 12),
    "plate one edge thick": lambda: box(16, 16, 1),
    "bar one edge thick": lambda: box(20, 1, 1),
    "cone": lambda: cone(1.0),
    "needle": lambda: cone(12.0),
    "needle of few sides": lambda: cone(6.0, around=5),
    "ball with poles": ball,
    "torus": torus,
    "two triangles": lambda: grid(2, 2),
    "star_prism": machined_shapes.star_prism,
    "stepped_cylinder": machined_shapes.stepped_cylinder,
    "chipped_cube": machined_shapes.chipped_cube,
}


@pytest.mark.parametrize("name", CLEAN)
def test_clean_shapes_have_no_outliers(name):
    mesh = prepare_mesh(*CLEAN[name]()).mesh
    found = find_outliers(mesh)
    assert found.count == 0
    assert not found.are_clear
    assert found.vertices is mesh.vertices


def test_clean_samples_have_no_outliers():
    paths = [path for path in sorted(SAMPLES.glob("*_clean.*")) if path.suffix != ".mtl"]
    assert len(paths) == 8
    assert {path.name: find_outliers(ground_truth.opened(path)).count for path in paths} == {
        path.name: 0 for path in paths
    }


@pytest.mark.ci
def test_clean_files_of_others_have_no_clear_outliers(real_data):
    paths = [
        path
        for folder in ("clean", "clean_foreign")
        for path in sorted((real_data / folder).iterdir())
        if path.suffix != ".md"
    ]
    assert len(paths) >= 40
    assert [p.name for p in paths if find_outliers(ground_truth.opened(p)).are_clear] == []


@pytest.mark.parametrize("share", [0.01, 0.1])
@pytest.mark.parametrize("level", [0.0, 0.2])
@pytest.mark.parametrize("shape", [torus_mesh, lambda: prepare_mesh(*box(20, 20, 20)).mesh])
def test_outliers_are_found_and_brought_back(shape, level, share):
    true = shape()
    mesh, planted = with_outliers(true, level, share)
    found = find_outliers(mesh)
    hits = found.flags & planted
    assert hits.sum() >= 0.95 * planted.sum()
    assert (found.flags & ~planted).sum() <= 0.005 * len(planted)
    assert found.are_clear
    assert (found.vertices[~found.flags] == mesh.vertices[~found.flags]).all()
    errors = np.linalg.norm(found.vertices - true.vertices, axis=1) / true.mean_edge_length
    assert errors[hits].mean() < 0.25 + level


@pytest.mark.parametrize(
    ("spread", "size", "is_clear"), [(0.0, 16, False), (0.1, 16, True), (0.1, 20, False)]
)
def test_outliers_of_a_design_are_not_clear(spread, size, is_clear):
    """In one plane, or few."""
    mesh = prepare_mesh(*box(size, size, size)).mesh
    vertices, top = mesh.vertices.copy(), mesh.vertices[:, 2].max()
    rows = np.isin(vertices[:, :2], [-6.0, -2.0, 2.0, 6.0]).all(axis=1)
    planted = np.flatnonzero(rows & (vertices[:, 2] == top))
    heights = 2.0 + spread * np.arange(len(planted))
    vertices[planted, 2] += heights * mesh.mean_edge_length
    found = find_outliers(mesh.with_vertices(vertices))
    assert len(planted) == 16
    assert found.flags[planted].all()
    assert found.are_clear == is_clear


@pytest.mark.parametrize("are_tips", [False, True])
def test_tips_of_three_faces_are_of_a_design(are_tips):
    mesh = torus_mesh()
    edge, chosen = mesh.mean_edge_length, mesh.faces[700:7000:900]
    heights = edge * np.linspace(2.0, 3.0, len(chosen))[:, None]
    vertices = ground_truth.add_plain_noise(mesh, "gaussian-normal", 0.1, 3)
    faces = mesh.faces
    tips = vertices[chosen].mean(axis=1) + heights * mesh.vertex_normals()[chosen[:, 0]]
    if are_tips:
        new = len(vertices) + np.arange(len(chosen))
        sides = [np.column_stack([chosen[:, k], chosen[:, k - 2], new]) for k in range(3)]
        faces = np.concatenate([np.delete(faces, np.s_[700:7000:900], axis=0), *sides])
        vertices = np.concatenate([vertices, tips])
    else:
        vertices[chosen[:, 0]] = tips
    found = find_outliers(prepare_mesh(vertices, faces).mesh)
    assert found.count == len(chosen)
    assert found.are_clear != are_tips


@pytest.mark.parametrize(
    ("kind", "level"),
    [
        *((kind, level) for kind in ("gaussian-normal", "gaussian") for level in (0.1, 0.3)),
        *(("half", 0.3), ("impulsive", 0.5), ("impulsive", 1.0)),
    ],
)
def test_noise_alone_has_hardly_any(kind, level):
    mesh = torus_mesh()
    rough = ground_truth.add_plain_noise(
        mesh, "gaussian-normal" if kind == "half" else kind, level, 3, 0.5
    )
    if kind == "half":
        rough = np.where(mesh.vertices[:, :1] > 0.0, rough, mesh.vertices)
    found = find_outliers(mesh.with_vertices(rough))
    assert kind == "impulsive" or found.count <= 0.002 * len(mesh.vertices)
    assert not found.are_clear


def test_too_many_are_noise():
    mesh, _ = with_outliers(torus_mesh(), 0.0, 0.3)
    found = find_outliers(mesh)
    assert found.are_too_many
    assert found.share > MAX_SHARE
    assert not found.flags.any()
    assert found.vertices is mesh.vertices


@pytest.mark.parametrize("size", [2, 3, 5])
def test_neighbours_that_are_outliers_together_are_found(size):
    true = torus_mesh()
    draw = np.random.default_rng(size)
    planted = np.zeros(len(true.vertices), dtype=bool)
    vertices = true.vertices.copy()
    for start in range(100, len(vertices), 300):
        together = [start]
        while len(together) < size:
            near = together[draw.integers(len(together))]
            row = slice(true.topology.ring_start[near], true.topology.ring_start[near + 1])
            together = sorted({*together, int(draw.choice(true.topology.ring[row]))})
        ways = draw.standard_normal((size, 3))
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        vertices[together] += ways * draw.uniform(1, 3, (size, 1)) * true.mean_edge_length
        planted[together] = True
    found = find_outliers(true.with_vertices(vertices))
    assert (found.flags & planted).sum() >= 0.9 * planted.sum()
    assert not (found.flags & ~planted).any()


def test_place_size_direction_and_threads_make_no_difference(monkeypatch):
    mesh, _ = with_outliers(prepare_mesh(*torus(150, 75)).mesh, 0.1, 0.01)
    monkeypatch.setenv("MSAL_THREADS", "1")
    found = find_outliers(mesh)
    monkeypatch.setenv("MSAL_THREADS", "2")
    assert find_outliers(mesh).vertices.tobytes() == found.vertices.tobytes()
    turn, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    other = prepare_mesh(1000.0 * mesh.vertices @ turn.T + 5.0, mesh.faces).mesh
    assert (find_outliers(other).flags == found.flags).all()


def test_held_vertices_are_no_outliers():
    mesh, planted = with_outliers(torus_mesh(), 0.0, 0.02)
    held = np.zeros(len(planted), dtype=bool)
    held[np.flatnonzero(planted)[::2]] = True
    found = find_outliers(mesh.with_constraints(held, None))
    assert not (found.flags & held).any()
    assert (found.vertices[held] == mesh.vertices[held]).all()
    assert (found.flags & planted).sum() >= 0.95 * (planted & ~held).sum()
