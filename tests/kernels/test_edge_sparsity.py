"""The edge operator and its linear system against the formulas, written out densely."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.dihedral_flaps import flaps
from msal_cli.kernels.edge_sparsity import LARGEST, edge_sparsity
from tests.shapes import fan, grid, noisy, torus

ONE_FLAP = np.array([[0, 1, 2, 3]], dtype=np.int32)


def bend(points, threshold=0.0):
    """Coefficients (4,) and delta (3,) of the flap with these four corners."""
    coefficients, deltas = edge_sparsity(4, ONE_FLAP).bent(np.asarray(points, float), threshold)
    return coefficients[0], deltas[0]


def printed(p1, p2, p3, p4):
    """The coefficients as He and Schaefer print them."""

    def area(a, b, c):
        return np.linalg.norm(np.cross(b - a, c - a)) / 2

    s123, s134 = area(p1, p2, p3), area(p1, p3, p4)
    square, both = (p3 - p1) @ (p3 - p1), s123 + s134
    return np.array(
        [
            (s123 * (p4 - p3) @ (p3 - p1) + s134 * (p1 - p3) @ (p3 - p2)) / (square * both),
            s134 / both,
            (s123 * (p3 - p1) @ (p1 - p4) + s134 * (p2 - p1) @ (p1 - p3)) / (square * both),
            s123 / both,
        ]
    )


quads = st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12).map(
    lambda numbers: np.array(numbers).reshape(4, 3)
)


@settings(max_examples=200, deadline=None)
@given(points=quads)
def test_coefficients_are_the_printed_ones(points):
    points = points + [[0, 0, 0], [0.5, 2.5, 0], [3, 0, 0], [1.5, -2.5, 0]]
    coefficients, delta = bend(points)
    assert np.allclose(coefficients, printed(*points), rtol=1e-12, atol=1e-12)
    assert np.allclose(delta, coefficients @ points, atol=1e-12)
    assert coefficients.sum() == pytest.approx(0.0, abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(points=quads, seed=st.integers(0, 1000))
def test_a_flat_flap_is_not_bent(points, seed):
    # Also one that is not convex: the opposite corners anywhere on their sides of the edge.
    flat = points * [1, 1, 0] + [[0, 0, 0], [0, 1.5, 0], [3, 0, 0], [0, -1.5, 0]]
    flat[[0, 2], 1] = 0.0
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    _, delta = bend(flat @ turn + [5.0, -3.0, 1.0])
    assert np.abs(delta).max() < 1e-13


def test_the_bend_by_hand():
    # A square folded along its diagonal, corners lifted by one: D is their height over the edge.
    points = [[-1.0, 0, 0], [0, 1, 1], [1, 0, 0], [0, -1, 1]]
    coefficients, delta = bend(points)
    assert np.allclose(coefficients, [-0.5, 0.5, -0.5, 0.5])
    assert np.allclose(delta, [0, 0, 1])


def test_delta_is_zero_below_the_threshold_only():
    points = [[-1.0, 0, 0], [0, 1, 1], [1, 0, 0], [0, -1, 1]]
    assert (bend(points, 1.0 + 1e-9)[1] == 0.0).all()
    assert np.allclose(bend(points, 1.0 - 1e-9)[1], [0, 0, 1])
    assert np.allclose(bend(points, 1.0 - 1e-9)[0], [-0.5, 0.5, -0.5, 0.5])


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((4, 3)),
        [[0.0, 0, 0], [0, 1, 0], [0, 0, 0], [0, -1, 1]],
        [[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]],
        [[0.0, 0, 0], [1e-160, 0, 0], [0, 1e-160, 0], [0, 0, 1e-160]],
    ],
)
def test_a_flap_without_area_does_not_count(points):
    coefficients, delta = bend(points)
    assert (coefficients == 0.0).all()
    assert (delta == 0.0).all()


def test_a_flap_on_a_needle_is_scaled_down():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1e-12, 0], [1, 1, 0.5]])
    coefficients, delta = bend(points)
    assert np.abs(coefficients).max() <= LARGEST * (1 + 1e-9)
    assert np.isfinite(delta).all()
    assert coefficients.sum() == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("shape", ["torus", "grid"])
def test_the_system_is_the_dense_one(shape):
    vertices, faces = torus(8, 6) if shape == "torus" else grid(6, 5)
    vertices = noisy(vertices, 1, 0.2)
    n = len(vertices)
    corners = flaps(faces, connectivity(n, faces))
    edges = edge_sparsity(n, corners)
    threshold = np.median((edges.bent(vertices, 0.0)[1] ** 2).sum(axis=1))
    coefficients, deltas = edges.bent(vertices, threshold)
    assert 0.4 < (deltas == 0).all(axis=1).mean() < 0.6
    alpha, beta = 0.7, 3.0
    matrix, pulls = edges.system(coefficients, deltas, alpha, beta)

    bends, regular = np.zeros((2, len(corners), n))
    for e, flap in enumerate(corners):
        bends[e, flap] = coefficients[e]
        regular[e, flap] = [1, -1, 1, -1]
    expected = np.eye(n) + alpha * regular.T @ regular + beta * bends.T @ bends
    product = np.empty((n, 3))
    for first in range(0, n, 3):
        x = np.zeros((n, 3))
        for axis, k in enumerate(range(first, min(first + 3, n))):
            x[k, axis] = 1.0
        matrix.times(x, product)
        width = min(3, n - first)
        assert np.allclose(product[:, :width], expected[:, first : first + width], atol=1e-12)
    assert np.allclose(pulls, beta * bends.T @ deltas, atol=1e-12)
    assert np.allclose(matrix.diagonal, np.diag(expected), atol=1e-12)


def test_no_flaps_give_the_identity():
    edges = edge_sparsity(3, np.empty((0, 4), dtype=np.int32))
    matrix, pulls = edges.system(*edges.bent(np.eye(3), 0.0), 1.0, 1.0)
    assert (matrix.diagonal == 1.0).all()
    assert (pulls == 0.0).all()
    assert len(matrix.values) == 0


def test_a_hub_is_not_quadratic():
    vertices, faces = fan(np.random.default_rng(0).normal(size=50_000))
    corners = flaps(faces, connectivity(len(vertices), faces))
    edges = edge_sparsity(len(vertices), corners)
    edges.system(*edges.bent(vertices, 0.0), 1.0, 1.0)
    started = time.perf_counter()
    edges = edge_sparsity(len(vertices), corners)
    matrix, _ = edges.system(*edges.bent(vertices, 0.0), 1.0, 1.0)
    assert time.perf_counter() - started < 1.0
    assert np.isfinite(matrix.values).all()
