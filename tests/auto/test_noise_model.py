"""Fields of noise to draw from."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.auto.noise_model import AXIS, ISOTROPIC, NoiseModel
from msal_cli.mesh import prepare_mesh
from tests.shapes import torus


@pytest.fixture(scope="module")
def mesh():
    return prepare_mesh(*torus(90, 45)).mesh


def drawn(mesh, seed=0, way="draw", **given):
    noise = NoiseModel(0.2, **given)
    generator = np.random.default_rng(seed)
    return getattr(noise, way)(mesh, mesh.vertex_normals("uniform"), generator)


def correlation(mesh, heights):
    """Of neighbours."""
    start, ring = mesh.topology.ring_start, mesh.topology.ring
    first = np.repeat(np.arange(len(heights)), np.diff(start))
    return float(np.mean(heights[first] * heights[ring]) / np.mean(heights * heights))


@pytest.mark.parametrize("way", ["draw", "probe"])
def test_plain_noise_is_along_the_normals_and_white(mesh, way):
    moves = drawn(mesh, way=way)
    normals = mesh.vertex_normals("uniform")
    heights = np.einsum("ij,ij->i", moves, normals)
    assert moves == pytest.approx(heights[:, None] * normals, abs=1e-12)
    assert heights.std() == pytest.approx(0.2, rel=0.05)
    assert abs(correlation(mesh, heights)) < 0.05
    assert NoiseModel(0.2).is_plain
    if way == "probe":
        assert np.abs(heights) == pytest.approx(np.full(len(heights), 0.2))


@pytest.mark.parametrize("way", ["draw", "probe"])
def test_shared_noise_is_alike_at_neighbours(mesh, way):
    over_one, over_two = (
        np.einsum("ij,ij->i", drawn(mesh, way=way, rings=rings), mesh.vertex_normals("uniform"))
        for rings in (1, 2)
    )
    assert correlation(mesh, over_one) == pytest.approx(0.57, abs=0.05)
    assert correlation(mesh, over_two) == pytest.approx(0.78, abs=0.05)
    assert over_two.std() == pytest.approx(0.2, rel=0.05)


def test_isotropic_noise_has_the_level_in_every_coordinate(mesh):
    moves = drawn(mesh, direction=ISOTROPIC)
    assert moves.std(axis=0) == pytest.approx([0.2] * 3, rel=0.05)
    assert np.corrcoef(moves.T) == pytest.approx(np.eye(3), abs=0.05)


def test_noise_along_an_axis_has_no_other_part(mesh):
    axis = (0.6, 0.0, 0.8)
    moves = drawn(mesh, direction=AXIS, axis=axis)
    assert np.cross(moves, axis) == pytest.approx(np.zeros_like(moves), abs=1e-12)
    assert (moves @ axis).std() == pytest.approx(0.2, rel=0.05)


@pytest.mark.parametrize("direction", ["normals", ISOTROPIC])
def test_levels_of_vertices_and_the_variance(mesh, direction):
    shares = np.where(mesh.vertices[:, 0] > 0.0, 1.4, 0.0)
    moves = drawn(mesh, direction=direction, shares=shares)
    squares = (moves**2).sum(axis=1)
    assert (squares[shares == 0.0] == 0.0).all()
    model = NoiseModel(0.2, direction=direction, shares=shares)
    everywhere = np.ones(len(shares), dtype=bool)
    assert squares.mean() == pytest.approx(model.variance(everywhere), rel=0.08)
    assert model.variance(shares > 0.0) == pytest.approx(
        1.4**2 * NoiseModel(0.2, direction=direction).variance(everywhere)
    )
    assert not model.is_plain and model.at_level(0.3).shares is shares
