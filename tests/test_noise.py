"""The noise estimate against noise that was put in."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.errors import UsageError
from msal_cli.mesh import prepared
from msal_cli.noise import KINDS, noisy
from msal_cli.noise_estimate import WHITE_NOISE_GAIN, estimated
from tests.shapes import grid, torus


def with_normal_noise(vertices, faces, level, seed=0):
    """A mesh with Gaussian noise of ``level`` mean edge lengths along its normals."""
    mesh = prepared(vertices, faces).mesh
    amount = level * mesh.mean_edge_length
    heights = np.random.default_rng(seed).normal(0.0, amount, len(vertices))
    normals = mesh.vertex_normals()
    return prepared(vertices + heights[:, None] * normals, faces).mesh, amount


def test_the_gain_is_that_of_the_stencil():
    # Unit noise at one vertex of the valence-6 lattice, umbrella twice, squares summed.
    c = np.array([7 / 6] + 6 * [-5 / 18] + 6 * [1 / 36] + 6 * [1 / 18])
    assert np.sqrt((c**2).sum()) == pytest.approx(WHITE_NOISE_GAIN, abs=1e-4)


@pytest.mark.parametrize("level", [0.05, 0.1, 0.2, 0.3])
def test_gaussian_noise_is_told(level):
    mesh, amount = with_normal_noise(*torus(160, 80), level)
    assert estimated(mesh).file_units == pytest.approx(amount, rel=0.08)


def test_a_smooth_mesh_has_none():
    mesh = prepared(*torus(160, 80)).mesh
    assert estimated(mesh).file_units < 0.002 * mesh.mean_edge_length


def test_open_and_tiny_meshes_give_a_number():
    assert estimated(prepared(*grid(3, 3)).mesh).file_units == 0.0
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]])
    assert estimated(prepared(*triangle).mesh).file_units == 0.0


def test_outliers_do_not_pass_for_noise():
    vertices, faces = torus(160, 80)
    vertices[::97] *= 1.2
    mesh = prepared(vertices, faces).mesh
    assert estimated(mesh).file_units < 0.05 * mesh.mean_edge_length


KINDS_MOVED = {"gaussian-normal": 1.0, "gaussian": 1.0, "mixed": 1.0, "impulsive": 0.1}


@pytest.mark.parametrize("kind", KINDS)
def test_noise_is_the_same_for_the_same_seed_only(kind):
    mesh = prepared(*torus()).mesh
    first = noisy(mesh, kind, 0.2, 7)
    assert np.array_equal(first, noisy(mesh, kind, 0.2, 7))
    assert not np.array_equal(first, noisy(mesh, kind, 0.2, 8))
    assert np.array_equal(noisy(mesh, kind, 0.0, 7), mesh.vertices)


@pytest.mark.parametrize("kind", KINDS)
def test_how_many_vertices_move(kind):
    mesh = prepared(*torus()).mesh
    moved = (noisy(mesh, kind, 0.2, 7) != mesh.vertices).any(axis=1)
    assert moved.sum() == round(KINDS_MOVED[kind] * len(moved))


@pytest.mark.parametrize(
    ("kind", "along", "across"),
    [("gaussian-normal", 1.0, 0.0), ("gaussian", 1.0, np.sqrt(2.0)), ("mixed", 1.0, 1.0)],
)
def test_how_far_vertices_move_along_their_normals_and_across(kind, along, across):
    mesh = prepared(*torus(160, 80)).mesh
    steps = (noisy(mesh, kind, 0.2, 1) - mesh.vertices) / (0.2 * mesh.mean_edge_length)
    heights = (steps * mesh.vertex_normals()).sum(axis=1)
    rest = np.linalg.norm(steps - heights[:, None] * mesh.vertex_normals(), axis=1)
    assert heights.std() == pytest.approx(along, rel=0.03)
    assert heights.mean() == pytest.approx(0.0, abs=0.03)
    assert np.sqrt((rest**2).mean()) == pytest.approx(across, rel=0.03, abs=1e-12)


def test_mixed_noise_goes_every_way_across_the_normal():
    vertices, faces = grid(60, 60)
    mesh = prepared(vertices, faces).mesh
    steps = noisy(mesh, "mixed", 0.2, 1) - mesh.vertices
    assert steps.mean(axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=0.02)
    assert steps[:, 0].std() == pytest.approx(steps[:, 1].std(), rel=0.06)


def test_an_unknown_kind():
    with pytest.raises(UsageError, match="salt"):
        noisy(prepared(*grid()).mesh, "salt", 0.1, 0)
