"""The sweeps of equation (2) against a plain transcription, and the schedules by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from msal_cli.kernels.operators import Step
from msal_cli.kernels.schedules import Alternating, Constant, Multiscale, Pace, Plain, Wiener
from msal_cli.kernels.sweeps import run_sweeps
from tests.kernels.test_ring_blocks import operator as ring_operator

SCHEDULES = [
    Plain(0.4),
    Constant(0.4, 0.25),
    Constant(0.4, 1.0),
    Multiscale(0.7, 0.4),
    Multiscale(0.7, 0.4, 0.6),
    Alternating(0.4, -0.3),
    Wiener(0.4),
]


class Rolled:
    """An operator: every vertex goes towards the one before it, freely or along a normal."""

    def __init__(self, normals=None, sigma="largest"):
        self.normals, self.sigma = normals, sigma

    def __call__(self, x):
        move = 0.3 * (np.roll(x, 1, axis=0) - x)
        sigma = np.abs(move).sum(axis=1) * (np.arange(len(x)) % 5 > 0)
        if self.normals is not None:
            move = (move * self.normals).sum(axis=1)
        if not self.sigma:
            return Step(move)
        return Step(move, sigma, sigma.max() if self.sigma == "largest" else None)


def points(n=40):
    return 0.1 * np.random.default_rng(1).normal(size=(n, 3))


def unit_normals(n=40):
    normals = np.random.default_rng(2).normal(size=(n, 3))
    return normals / np.linalg.norm(normals, axis=1)[:, None]


def plain(vertices, operator, schedule, iterations, trust=1.0):
    """Equation (2) as it is written; also lambda of the first sweep."""
    x, first = vertices, np.zeros(len(vertices))
    for sweep in range(iterations):
        step = operator(x)
        sigma = np.zeros(len(x)) if step.sigma is None else step.sigma
        scale, share = None, schedule.quantile
        if share is not None:
            above = np.sort(sigma[sigma > 0.0])
            scale = above[math.ceil(share * len(above)) - 1]
        pace = schedule(sweep, scale)
        pulls = trust * np.minimum(pace.constant + pace.per_sigma * sigma, 1.0)
        first = first if sweep else pulls
        normals = operator.normals
        move = step.move if normals is None else step.move[:, None] * normals
        x = x + pace.time_step * move + pulls[:, None] * (vertices - x)
    return x, first


@pytest.mark.parametrize("schedule", SCHEDULES, ids=str)
@pytest.mark.parametrize("kind", ["free", "free, largest unknown", "along normals", "over rings"])
@pytest.mark.parametrize("has_trust", [False, True])
@pytest.mark.parametrize("iterations", [0, 1, 4])
def test_sweeps_are_equation_2(schedule, kind, has_trust, iterations):
    vertices = points()
    operator = {
        "free": Rolled(),
        "free, largest unknown": Rolled(sigma="alone"),
        "along normals": Rolled(unit_normals()),
        "over rings": None,
    }[kind]
    if operator is None:
        operator, vertices = ring_operator("mixed")
    trust = np.linspace(0.0, 1.0, len(vertices)) if has_trust else None
    calls = []
    result = run_sweeps(
        vertices,
        operator,
        schedule,
        iterations,
        lambda done, total: calls.append((done, total)),
        trust=trust,
    )
    x, fidelity = plain(vertices, operator, schedule, iterations, 1.0 if trust is None else trust)
    assert np.abs(result.vertices - x).max() <= 1e-11
    assert np.abs(result.fidelity - fidelity).max() <= 1e-12
    assert calls == [(done, iterations) for done in range(1, iterations + 1)]


def test_sigma_comes_from_scale_where_the_operator_has_none():
    vertices, silent, known = points(), Rolled(sigma=""), Rolled()
    for schedule in (Multiscale(0.7, 0.4), Multiscale(0.7, 0.4, 0.6)):
        with pytest.raises(ValueError, match="needs sigma"):
            run_sweeps(vertices, silent, schedule, 1)
        result = run_sweeps(vertices, silent, schedule, 3, scale=lambda x: known(x).sigma)
        assert result.vertices == pytest.approx(plain(vertices, known, schedule, 3)[0])
    # It is not needed otherwise.
    run_sweeps(vertices, silent, Plain(), 1)


@pytest.mark.parametrize(
    ("schedule", "paces"),
    [
        (Plain(), [Pace(1.0, 0.0, 0.0)] * 3),
        (Wiener(), [Pace(1.0, 0.0, 0.0)] * 3),
        (Constant(), [Pace(1.0, 0.1, 0.0)] * 3),
        (Multiscale(), [Pace(1.0, 0.0, 0.25), Pace(0.5, 0.0, 0.25), Pace(0.25, 0.0, 0.25)]),
        (Alternating(), [Pace(0.5), Pace(-0.53), Pace(0.5)]),
    ],
    ids=str,
)
def test_the_pace_of_each_sweep(schedule, paces):
    assert [schedule(sweep, 4.0) for sweep in range(3)] == paces
    assert schedule(0, 0.5).per_sigma == 8.0 * paces[0].per_sigma
    assert schedule.quantile == (1.0 if isinstance(schedule, Multiscale) else None)


@pytest.mark.parametrize("scale", [None, 0.0])
def test_without_any_sigma_multiscale_pulls_nothing(scale):
    assert Multiscale()(1, scale) == Pace(0.5, 0.0, 0.0)


def test_wiener_estimates_the_noise_and_takes_all_of_it():
    assert (Wiener().noise, Wiener().caution) == (None, 1.0)
