"""The steps towards the minimum of the static/dynamic energy."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.face_rings import face_centroids, face_rings, faces_within
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.static_dynamic import minimising_normals, pair_weights
from tests.shapes import noisy, torus


def problem(level=0.3):
    vertices, faces = torus()
    vertices = noisy(vertices, 1, level)
    normals, areas = face_normals_and_areas(vertices, faces)
    centroids = face_centroids(vertices, faces)
    ring = face_rings(faces, connectivity(len(vertices), faces), "vertex")
    near = faces_within(centroids, *ring, 2.0, 1000)
    weights, share = pair_weights(normals, centroids, areas, *near, 0.7, 1.5)
    return normals, areas, near, weights, 2.0 * share


def minimised(steps, tolerance=0.0, nu=0.3):
    normals, areas, near, weights, strength = problem()
    return minimising_normals(normals, areas, *near, weights, strength, nu, tolerance, steps)


def energy(n, nu=0.3):
    n0, areas, (start, near), weights, strength = problem()
    i = np.repeat(np.arange(len(n)), np.diff(start))
    welsch = 1 - np.exp(-((n[i] - n[near]) ** 2).sum(axis=1) / (2 * nu**2))
    return areas @ ((n - n0) ** 2).sum(axis=1) + strength * (weights * welsch).sum() / 2


def test_two_faces_by_hand():
    # Areas 1 and 3 at distance 1, normals at a right angle: w = 4 e^(-1/2) e^(-2 / 2),
    # lambda' = lambda 4 / (4 e^(-1/2)), and a step adds w e^(-2 / 2) of the other normal.
    normals = np.array([[1.0, 0, 0], [0, 1.0, 0]])
    areas = np.array([1.0, 3.0])
    near = np.array([0, 1, 2]), np.array([1, 0], dtype=np.int32)
    centroids = np.array([[0.0, 0, 0], [1.0, 0, 0]])
    weights, share = pair_weights(normals, centroids, areas, *near, 1.0, 1.0)
    assert weights == pytest.approx([4 * np.exp(-1.5)] * 2)
    assert share == pytest.approx(np.exp(0.5))
    out = minimising_normals(normals, areas, *near, weights, 2 * share, 1.0, 0.0, 1)
    own, other = 2 / (2 * np.exp(0.5)) * areas, 4 * np.exp(-2.5)
    expected = np.array([[own[0], other, 0], [other, own[1], 0]])
    assert out == pytest.approx(expected / np.linalg.norm(expected, axis=1)[:, None])


def test_the_energy_falls_from_step_to_step():
    energies = [energy(minimised(steps)) for steps in range(8)]
    assert (np.diff(energies) < 0).all()
    assert energies[-1] < 0.85 * energies[0]


def test_it_ends_where_nothing_improves():
    # At the end no small turn of any normal makes less energy.
    end = minimised(3000)
    least = energy(end)
    rng = np.random.default_rng(3)
    for size in (1e-3, 1e-2):
        turned = end + size * rng.normal(size=end.shape)
        assert energy(turned / np.linalg.norm(turned, axis=1)[:, None]) > least


def test_it_stops_at_the_tolerance():
    steps = []
    normals, areas, near, weights, strength = problem()
    loose = minimising_normals(
        normals, areas, *near, weights, strength, 0.3, 0.01, 1000, lambda: steps.append(1)
    )
    last, before = minimised(len(steps)), minimised(len(steps) - 1)
    earlier = minimised(len(steps) - 2)
    assert (loose == last).all()

    def change(one, other):
        return np.sqrt(areas @ ((one - other) ** 2).sum(axis=1) / areas.sum())

    assert change(last, before) <= 0.01 < change(before, earlier)


def test_a_face_without_a_normal_takes_that_of_its_neighbours():
    normals = np.array([[0.0, 0, 0], [0, 0, 1.0]])
    near = np.array([0, 1, 2]), np.array([1, 0], dtype=np.int32)
    out = minimising_normals(normals, np.array([0.0, 1.0]), *near, np.ones(2), 1.0, 0.3, 0.0, 1)
    assert (out == [[0, 0, 1], [0, 0, 1]]).all()


def test_nothing_near_changes_nothing():
    normals = np.array([[1.0, 0, 0], [0, 1.0, 0]])
    near = np.array([0, 0, 0]), np.empty(0, dtype=np.int32)
    weights, share = pair_weights(normals, normals, np.ones(2), *near, 1.0, 1.0)
    assert share == 0.0
    out = minimising_normals(normals, np.ones(2), *near, weights, share, 0.3, 0.0, 5)
    assert (out == normals).all()
    assert out is not normals
