"""Conjugate gradients against numpy's dense solver, and what they promise besides."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.kernels.conjugate_gradient import RowMatrix, conjugate_gradients
from msal_cli.kernels.connectivity import connectivity
from tests.shapes import grid


def row_matrix(dense):
    """A dense symmetric matrix as rows, with its zeros left out."""
    rest = dense - np.diag(np.diag(dense))
    rows, columns = np.nonzero(rest)
    row_start = np.zeros(len(dense) + 1, dtype=np.int32)
    np.cumsum(np.bincount(rows, minlength=len(dense)), out=row_start[1:])
    return RowMatrix(
        np.diag(dense).copy(), row_start, columns.astype(np.int32), rest[rows, columns]
    )


def spd(rng, n, spread=1.0):
    """A random sparse symmetric positive definite matrix; rows scaled over ``spread`` decades."""
    half = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.3)
    scale = 10.0 ** rng.uniform(-spread / 2, spread / 2, n)
    return scale[:, None] * (half @ half.T + np.eye(n)) * scale


def umbrella_system(faces, n, weight):
    """I + weight times the graph Laplacian."""
    links = connectivity(n, faces)
    diagonal = 1.0 + weight * np.diff(links.ring_start)
    return RowMatrix(diagonal, links.ring_start, links.ring, np.full(len(links.ring), -weight))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 40), spread=st.floats(0.0, 8.0))
def test_it_agrees_with_a_dense_solver(seed, n, spread):
    rng = np.random.default_rng(seed)
    dense = spd(rng, n, spread)
    right = rng.normal(size=(n, 3))
    found = conjugate_gradients(
        row_matrix(dense), right, rng.normal(size=(n, 3)), tolerance=1e-12, most_iterations=40 * n
    )
    assert found.converged
    scale = np.sqrt(np.diag(dense))[:, None]
    expected = np.linalg.solve(dense / (scale * scale.T), right / scale) / scale
    error = np.abs((found.values - expected) * scale).max()
    assert error <= 1e-7 * np.abs(expected * scale).max()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), n=st.integers(2, 25))
def test_it_ends_within_n_steps_times_three(seed, n):
    # Exact arithmetic ends after as many steps as the matrix has eigenvalues, for all columns.
    rng = np.random.default_rng(seed)
    found = conjugate_gradients(
        row_matrix(spd(rng, n)), rng.normal(size=(n, 3)), np.zeros((n, 3)), tolerance=1e-9
    )
    assert found.converged
    assert found.iterations <= 3 * n


def test_the_residual_is_the_true_one():
    rng = np.random.default_rng(3)
    dense = spd(rng, 25, 2.0)
    right = rng.normal(size=(25, 3))
    found = conjugate_gradients(row_matrix(dense), right, np.zeros((25, 3)), most_iterations=7)
    rest = right - dense @ found.values
    d = np.diag(dense)
    expected = np.sqrt((rest**2 / d[:, None]).sum() / d.sum())
    assert found.iterations == 7
    assert not found.converged
    assert found.residual == pytest.approx(expected, rel=1e-9)


def test_it_turns_with_the_axes_even_when_stopped_early():
    rng = np.random.default_rng(7)
    matrix = row_matrix(spd(rng, 30, 2.0))
    right = rng.normal(size=(30, 3)) * [1.0, 10.0, 0.01]
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    start = np.zeros((30, 3))
    plain = conjugate_gradients(matrix, right, start, most_iterations=5).values
    turned = conjugate_gradients(matrix, right @ turn, start, most_iterations=5).values
    assert np.allclose(turned, plain @ turn, atol=1e-11 * np.abs(plain).max())


def test_held_rows_stay_and_count_as_data():
    rng = np.random.default_rng(8)
    dense = spd(rng, 20)
    right, start = rng.normal(size=(20, 3)), rng.normal(size=(20, 3))
    held = rng.random(20) < 0.3
    assert 0 < held.sum() < 20
    found = conjugate_gradients(row_matrix(dense), right, start, held=held, tolerance=1e-13)
    free = ~held
    expected = np.linalg.solve(
        dense[np.ix_(free, free)], right[free] - dense[np.ix_(free, held)] @ start[held]
    )
    assert (found.values[held] == start[held]).all()
    assert np.allclose(found.values[free], expected, rtol=1e-8, atol=1e-8)


def test_an_empty_row_stays():
    dense = np.diag([2.0, 0.0, 4.0])
    found = conjugate_gradients(row_matrix(dense), np.ones((3, 3)), np.full((3, 3), 7.0))
    assert np.allclose(found.values[:, 0], [0.5, 7.0, 0.25])


def test_an_indefinite_matrix_ends_unconverged_and_finite():
    dense = np.array([[1.0, 2.0], [2.0, 1.0]])
    right = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    found = conjugate_gradients(row_matrix(dense), right, np.zeros((2, 3)))
    assert not found.converged
    assert np.isfinite(found.values).all()


def test_threads_do_not_change_a_bit(monkeypatch):
    # Not a multiple of the chunk, and enough rows for three ranges that end amid chunks.
    vertices, faces = grid(331, 307)
    n = len(vertices)
    matrix = umbrella_system(faces, n, 5.0)
    right = np.random.default_rng(10).normal(size=(n, 3))
    results = []
    for count in ("1", "2", "3"):
        monkeypatch.setenv("MSAL_THREADS", count)
        results.append(conjugate_gradients(matrix, right, np.zeros((n, 3)), tolerance=1e-9))
    assert results[0].iterations > 5
    for other in results[1:]:
        assert other.iterations == results[0].iterations
        assert other.residual == results[0].residual
        assert (other.values == results[0].values).all()
    rest = np.empty((n, 3))
    matrix.times(results[0].values, rest)
    assert np.abs(right - rest).max() < 1e-6
