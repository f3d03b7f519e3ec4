"""The noise estimate against noise that was put in."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.mesh import prepared
from msal_cli.noise import WHITE_NOISE_GAIN, noise_level
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
    assert noise_level(mesh) == pytest.approx(amount, rel=0.08)


def test_a_smooth_mesh_has_none():
    mesh = prepared(*torus(160, 80)).mesh
    assert noise_level(mesh) < 0.002 * mesh.mean_edge_length


def test_open_and_tiny_meshes_give_a_number():
    assert noise_level(prepared(*grid(3, 3)).mesh) == 0.0
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]])
    assert noise_level(prepared(*triangle).mesh) == 0.0


def test_outliers_do_not_pass_for_noise():
    vertices, faces = torus(160, 80)
    vertices[::97] *= 1.2
    mesh = prepared(vertices, faces).mesh
    assert noise_level(mesh) < 0.05 * mesh.mean_edge_length
