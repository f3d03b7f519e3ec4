"""Noise that is added to meshes."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.errors import UsageError
from msal_cli.mesh import prepared
from msal_cli.noise import KINDS, noisy
from tests.shapes import grid, torus

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
