"""Noise that is added to meshes."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.errors import UsageError
from msal_cli.mesh import prepared
from msal_cli.noise import KINDS, AddedNoise, add_noise, noisy
from tests.shapes import grid, torus

FIRST_KINDS = ("gaussian-normal", "gaussian", "mixed", "impulsive")
KINDS_MOVED = {"impulsive": 0.1, "half": 0.5}


def added(mesh, kind, level=0.2, seed=7, **settings):
    weights = np.ones(len(mesh.vertices)) if kind == "property" else None
    return add_noise(mesh, AddedNoise(kind, level, seed, **settings), weights)


@pytest.mark.parametrize("kind", KINDS)
def test_noise_is_the_same_for_the_same_seed_only(kind):
    mesh = prepared(*torus()).mesh
    first = added(mesh, kind)
    assert np.array_equal(first, added(mesh, kind))
    assert not np.array_equal(first, added(mesh, kind, seed=8))


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"quantised", "outliers"}))
def test_a_level_of_nothing_moves_nothing(kind):
    mesh = prepared(*torus()).mesh
    assert np.array_equal(added(mesh, kind, 0.0), mesh.vertices)


@pytest.mark.parametrize("kind", FIRST_KINDS)
def test_the_short_form_adds_the_same(kind):
    mesh = prepared(*torus()).mesh
    short = noisy(mesh, kind, 0.2, 7, 0.3)
    assert np.array_equal(short, added(mesh, kind, fraction=0.3))


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"quantised", "ramp"}))
def test_how_many_vertices_move(kind):
    mesh = prepared(*torus(40, 21)).mesh
    direction = (1.0, 0.1, 0.3)
    moved = (added(mesh, kind, direction=direction) != mesh.vertices).any(axis=1)
    assert moved.mean() == pytest.approx(KINDS_MOVED.get(kind, 1.0), abs=0.001)


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
