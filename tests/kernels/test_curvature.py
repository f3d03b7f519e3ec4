"""Cotangent weights and vertex areas: identities, hand-worked cases and dirt."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.curvature import FLATTEST, corner_cotangents, cotangent_weights, mixed_areas
from msal_cli.kernels.geometry import area_and_volume, ring_areas
from tests.shapes import cube, grid, noisy, torus


def surface(kind="torus", seed=1, level=0.1):
    vertices, faces = {"torus": torus, "grid": grid, "cube": cube}[kind]()
    return noisy(vertices, seed, level), faces, connectivity(len(vertices), faces)


def dense(weights, links):
    n = len(links.ring_start) - 1
    matrix = np.zeros((n, n))
    matrix[np.repeat(np.arange(n), np.diff(links.ring_start)), links.ring] = weights
    return matrix


def test_a_right_triangle_by_hand():
    vertices = np.array([[0.0, 0, 0], [2.0, 0, 0], [0, 1.0, 0]])
    faces = np.array([[0, 1, 2]], dtype=np.int32)
    assert np.allclose(corner_cotangents(vertices, faces), [[0.0, 2.0, 0.5]], atol=1e-15)
    links = connectivity(3, faces)
    weights = dense(cotangent_weights(vertices, faces, links), links)
    assert np.allclose(weights, [[0, 0.5, 2.0], [0.5, 0, 0.0], [2.0, 0.0, 0]])
    # The centre of the circle is amid the longest edge: the right angle has a half.
    assert np.allclose(mixed_areas(vertices, faces, links), [0.5, 0.25, 0.25])
    assert np.allclose(ring_areas(vertices, faces, links), [1.0, 1.0, 1.0])


@pytest.mark.parametrize("kind", ["torus", "grid", "cube"])
def test_areas_add_up(kind):
    vertices, faces, links = surface(kind, level=0.25)
    area = area_and_volume(vertices, faces)[0]
    assert mixed_areas(vertices, faces, links).sum() == pytest.approx(area, rel=1e-13)
    assert ring_areas(vertices, faces, links).sum() == pytest.approx(3 * area, rel=1e-13)


@pytest.mark.parametrize("kind", ["torus", "grid"])
def test_weights_give_the_gradient_of_the_area(kind):
    vertices, faces, links = surface(kind, 2, 0.05)
    matrix = dense(cotangent_weights(vertices, faces, links), links)
    gradient = 0.5 * (matrix.sum(axis=1)[:, None] * vertices - matrix @ vertices)
    step = 1e-6
    for i in (0, 7, 19):
        for axis in range(3):
            up, down = vertices.copy(), vertices.copy()
            up[i, axis] += step
            down[i, axis] -= step
            slope = (area_and_volume(up, faces)[0] - area_and_volume(down, faces)[0]) / (2 * step)
            assert gradient[i, axis] == pytest.approx(slope, abs=1e-7)


@pytest.mark.parametrize("height", [0.0, 1e-100, 1e-12, 0.02])
def test_flat_faces_are_bounded_and_keep_their_sign(height):
    vertices = np.array([[0.0, 0, 0], [1.0, 0, 0], [0.3, height, 0]])
    faces = np.array([[0, 1, 2]], dtype=np.int32)
    found = corner_cotangents(vertices, faces)[0]
    assert np.isfinite(found).all()
    assert np.abs(found).max() <= 1 / FLATTEST
    assert found[2] < 0 < min(found[0], found[1])
    areas = mixed_areas(vertices, faces, connectivity(3, faces))
    assert areas.sum() == pytest.approx(height / 2, rel=1e-12, abs=0)
