"""Conjugate gradients: what they promise beside a solution, which the methods show."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.conjugate_gradient import RowMatrix, conjugate_gradients


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


def test_an_empty_row_stays():
    dense = np.diag([2.0, 0.0, 4.0])
    found = conjugate_gradients(row_matrix(dense), np.ones((3, 3)), np.full((3, 3), 7.0))
    assert np.allclose(found.values[:, 0], [0.5, 7.0, 0.25])
