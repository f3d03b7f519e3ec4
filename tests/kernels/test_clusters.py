"""K-means of plain numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.kernels.quantiles import clusters


def test_worked_by_hand():
    # Seeds 0.1, 5.1, 9 (the quantiles 1/6, 1/2, 5/6 of six); bounds 2.6 and 7.05 at once.
    values = np.array([5.0, 0.0, 9.0, 0.1, 5.1, 0.2])
    assert clusters(values, 3).tolist() == [1, 0, 2, 0, 1, 0]


def test_centres_move():
    # Seeds 1 and 4 part at 2.5; the means 1 and 6.5 part at 3.75, which takes 3 over, and then
    # 1.5 and 8 at 4.75, which takes 4.
    values = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 14.0])
    assert clusters(values, 2).tolist() == [0, 0, 0, 0, 0, 0, 1]


def test_a_value_between_two_centres_joins_the_lower():
    # Seeds 0 and 2; 1 joins 0, and their mean 0.5 keeps it.
    assert clusters(np.array([0.0, 1.0, 2.0]), 2).tolist() == [0, 0, 1]


@pytest.mark.parametrize("count", [2, 3, 7])
def test_equal_values_are_the_lowest_cluster(count):
    assert clusters(np.full(5, 0.3), count).tolist() == [0] * 5
    assert clusters(np.array([0.3]), count).tolist() == [0]


@settings(max_examples=100, deadline=None)
@given(
    values=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=60),
    count=st.integers(2, 5),
    seed=st.integers(0, 1000),
)
def test_each_value_is_nearest_to_its_own_mean_in_any_order(values, count, seed):
    values = np.array(values)
    found = clusters(values, count)
    order = np.random.default_rng(seed).permutation(len(values))
    assert (clusters(values[order], count) == found[order]).all()
    present = np.unique(found)
    assert set(present) <= set(range(count))
    means = np.array([values[found == one].mean() for one in present])
    assert (np.diff(means) > 0).all()
    own = means[np.searchsorted(present, found)]
    nearest = np.abs(values[:, None] - means).min(axis=1)
    assert (np.abs(values - own) <= nearest + 1e-9).all()
