"""Mean curvature and the paper's sigma, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.measures import local_scale, mean_curvature
from msal_cli.mesh import prepare_mesh
from tests.shapes import fan, grid, torus


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_of_a_torus(scale):
    vertices, faces = torus(160, 80)
    mesh = prepare_mesh(scale * vertices, faces).mesh
    beta = np.arctan2(vertices[:, 2], np.hypot(vertices[:, 0], vertices[:, 1]) - 3.0)
    expected = (3.0 + 2.0 * np.cos(beta)) / (2.0 * (3.0 + np.cos(beta)))
    assert scale * mean_curvature(mesh) == pytest.approx(expected, rel=0.01, abs=0.005)


def test_the_sign_follows_the_winding():
    vertices, faces = torus(40, 20)
    outward = mean_curvature(prepare_mesh(vertices, faces).mesh)
    inward = mean_curvature(prepare_mesh(vertices, faces[:, ::-1]).mesh)
    assert outward == pytest.approx(-inward, rel=1e-9)
    assert (outward > 0.0).mean() > 0.9


def test_of_a_plane_and_at_its_edges():
    assert np.abs(mean_curvature(prepare_mesh(*grid()).mesh)).max() < 1e-12


def test_open_edges_have_none():
    mesh = prepare_mesh(*fan([1.0, 0.0, 1.0, 0.0, 1.0, 0.0])).mesh
    assert (mean_curvature(mesh)[1:] == 0.0).all()


def test_sigma_by_hand():
    # Heights 1, -1, ... above the plane z = 0: mean 0, mean deviation 1, sigma 2.
    mesh = prepare_mesh(*fan([1.0, -1.0, 1.0, -1.0])).mesh
    normals = np.tile([0.0, 0.0, 1.0], (5, 1))
    assert local_scale(mesh, normals)[0] == pytest.approx(2.0)
    assert local_scale(prepare_mesh(*grid()).mesh, np.tile([0.0, 0.0, 1.0], (30, 1))).max() < 1e-6
