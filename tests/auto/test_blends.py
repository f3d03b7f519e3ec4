"""Weights of blends: the least of a quadratic, by hand and by the conditions that it must meet."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.auto.blends import (
    MORE,
    best_weights,
    hedge,
    least_over_simplex,
    round_weights,
    strengthen,
)
from msal_cli.auto.risk import Quadratic, Risk


@pytest.mark.parametrize(
    ("gain", "moved", "share"),
    [
        # It removes the noise and nothing else: half of it.
        (1.0, 1.0, 0.5),
        # It removes little of the noise: all of it.
        (0.4, 0.4, 1.0),
        # It moves more than it gains: as for noise alone, since less would be worse.
        (0.5, 2.0, 0.25),
        (-0.1, 1.0, 0.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_a_hedge_is_least_in_the_worse_case(gain, moved, share):
    found = hedge([risk(quadratic([[moved]], [gain]))], np.ones(1))
    assert found == share
    shares = np.linspace(0.0, 1.0, 1001)
    worse = np.maximum(shares**2 * moved, 1.0 - 2.0 * shares * gain + shares**2 * moved)
    assert max(found**2 * moved, 1.0 - 2.0 * found * gain + found**2 * moved) <= worse.min() + 1e-3


def problem(seed, count):
    """What filters of scattered moves give: M = D D', b = D a, M not far from singular."""
    draw = np.random.default_rng(seed)
    moves = draw.normal(size=(count, count + 3)) + 2.0 * draw.normal(size=count + 3)
    aim = draw.normal(size=count + 3) * draw.choice([0.1, 1.0, 3.0])
    return moves @ moves.T + 1e-4 * np.eye(count), moves @ aim


def risk(places, slopes=None):
    return Risk(places, places if slopes is None else slopes)


def quadratic(gram, gain):
    return Quadratic(np.array(gram, dtype=float), np.array(gain, dtype=float))


@given(st.integers(0, 10_000), st.integers(1, 12))
def test_the_conditions_of_a_least_hold(seed, count):
    gram, gain = problem(seed, count)
    weights = least_over_simplex(gram, gain)
    assert (weights >= 0.0).all() and weights.sum() <= 1.0 + 1e-9
    slope = gram @ weights - gain
    # What a little more of the sum would be worth; nothing where it does not bind.
    worth = -float(slope[weights > 1e-9].mean()) if weights.sum() > 1.0 - 1e-9 else 0.0
    scale = np.abs(gain).max()
    assert worth >= -1e-7 * scale
    assert (slope + worth >= -1e-6 * scale).all()
    assert np.abs((slope + worth)[weights > 1e-9]).max(initial=0.0) <= 1e-6 * scale


def test_slopes_count_by_their_share():
    # For places the first filter is right, for slopes the second.
    places = quadratic(np.eye(2), [0.9, 0.0])
    slopes = quadratic(np.eye(2), [0.0, 0.9])
    first = [best_weights([risk(places, slopes)], share)[0] for share in (0.0, 0.25, 0.75, 1.0)]
    assert first[0] == pytest.approx(0.9, abs=0.01)
    assert first == sorted(first, reverse=True)
    assert first[-1] == pytest.approx(0.0, abs=0.01)


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20))
def test_rounding_keeps_the_sum_and_moves_no_weight_by_a_step(parts):
    weights = np.array(parts)
    if weights.sum() > 1.0:
        weights /= weights.sum()
    short = round_weights(weights)
    assert short.sum() == pytest.approx(round(float(weights.sum()), 2), abs=1e-6) or (
        # Half-way between two hundredths either will do.
        abs(short.sum() - weights.sum()) <= 0.005 + 1e-9
    )
    assert short.sum() <= 1.0 + 1e-12
    assert (np.abs(short - weights) < 0.01 + 1e-6).all()
    assert all(float(f"{weight:.2f}") == weight for weight in short)


def test_what_rounds_alike_is_settled_by_order_not_by_last_digits():
    third = np.full(3, 1.0 / 3.0)
    shaken = third + np.array([-1e-13, 0.0, 1e-13])
    assert round_weights(third).tolist() == [0.34, 0.33, 0.33]
    assert round_weights(shaken).tolist() == [0.34, 0.33, 0.33]
    assert round_weights(np.array([0.29 - 1e-13, 0.71])).tolist() == [0.29, 0.71]


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
def test_the_mixture_moves_farther_by_as_much_as_is_asked_for(strength):
    draw = np.random.default_rng(0)
    base = draw.normal(size=(500, 3))
    near, far = base + 0.3 * draw.normal(size=(500, 3)), 3.0 * draw.normal(size=(500, 3))
    less = 0.5 * base
    k, weight = strengthen(base, [less, far, near], strength)
    assert k == 2 or strength > 1.0
    mixed = (1.0 - weight) * base + weight * [less, far, near][k]
    lengths = [np.linalg.norm(moves, axis=1).mean() for moves in (base, mixed)]
    ratio = lengths[1] / lengths[0]
    assert 1.0 + MORE * strength <= ratio < 1.0 + MORE * strength + 0.05


def test_if_none_moves_far_enough_the_farthest_is_mixed_in_but_never_less_than_there_is():
    base = np.ones((10, 3))
    assert strengthen(base, [0.2 * base, 1.01 * base], 2.0) == (1, 1.0)
    assert strengthen(base, [0.2 * base, 0.9 * base], 2.0) == (1, 0.0)
    # Half of each would be |(0.5, 0.51, 0)| = 0.71.
    assert strengthen(np.eye(3)[:1], [1.025 * np.eye(3)[1:2]], 1.0) == (0, 0.99)
