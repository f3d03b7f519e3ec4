"""Every method with a schedule, found by name, composes with each of them as equation (2) says."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from msal_cli import methods
from tests.methods.runs import denoise, scan

SCHEDULED = [
    name
    for name in methods.names()
    if any("plain" in spec.choices for spec in methods.find(name).parameters)
]


@pytest.fixture(scope="module")
def mesh():
    return scan(0.05, 0)


@pytest.fixture(params=SCHEDULED)
def run(request, mesh):
    return functools.partial(denoise, request.param, mesh)


def moved(mesh, vertices):
    return np.linalg.norm(vertices - mesh.vertices, axis=1)


def test_the_plain_schedule_is_the_default_and_looks_at_neither_k_nor_lambda(run):
    assert (run(schedule="plain", K=0.1, fidelity=0.9) == run()).all()


def test_a_constant_pull_of_zero_is_the_plain_schedule(run):
    assert (run(schedule="constant", fidelity=0.0) == run()).all()


def test_multiscale_comes_back_to_the_input(run, mesh):
    # Section 3: as sweeps go on the process converges to the data, over any operator.
    few, many = (moved(mesh, run(n=n, schedule="multiscale")).max() for n in (4, 200))
    assert many < 1e-3 * few


def test_a_robust_schedule_that_asks_for_the_largest_is_the_multiscale_one(run):
    robust = run(schedule="robust", quantile=1.0, K=0.3, n=3)
    assert (robust == run(schedule="multiscale", K=0.3, n=3)).all()
    assert not (robust == run(schedule="robust", quantile=0.5, K=0.3, n=3)).all()


def test_wiener_gives_back_all_if_there_is_no_noise_and_nothing_if_there_is_much(run, mesh):
    plain = run(n=4)
    normals = mesh.vertex_normals("uniform", 1)

    def along(vertices):
        return ((vertices - mesh.vertices) * normals).sum(axis=1)

    assert np.abs(along(run(n=4, schedule="wiener", noise=1e-12))).max() < 1e-13
    assert (run(n=4, schedule="wiener", noise=100) == plain).all()
    some = along(run(n=4, schedule="wiener", noise=0.005))
    assert 0 < np.linalg.norm(some) < np.linalg.norm(along(plain))
