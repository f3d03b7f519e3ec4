"""Medians, ranks, quantiles of distributions, and clusters of plain numbers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from msal_cli.kernels.quantiles import (
    MANY,
    MAX_FREEDOMS,
    chi_square,
    clusters,
    median,
    select_ranks,
    student,
)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30))
def test_it_is_that_of_numpy(values):
    assert median(np.array(values)) == np.median(values)


@pytest.mark.parametrize("odd", [0, 1])
@pytest.mark.parametrize("kind", ["normal", "few", "equal", "wide", "tiny"])
def test_many_numbers(kind, odd):
    rng = np.random.default_rng(odd)
    n = MANY + odd
    values = {
        "normal": rng.normal(size=n),
        "few": rng.integers(-2, 3, n) * 1.0,
        "equal": np.full(n, -7.25),
        "wide": rng.normal(size=n) * 10.0 ** rng.integers(-300, 300, n),
        "tiny": rng.integers(-3, 4, n) * 5e-324,
    }[kind]
    assert median(values) == np.median(values)
    ranks = (0, 1, n // 3, n - 1)
    assert select_ranks(values, *ranks) == np.sort(values)[list(ranks)].tolist()


@pytest.mark.parametrize("count", [2, 3, 7])
def test_equal_values_are_the_lowest_cluster(count):
    assert clusters(np.full(5, 0.3), count).tolist() == [0] * 5
    assert clusters(np.array([0.3]), count).tolist() == [0]


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
    means = np.array([values[found == label].mean() for label in present])
    assert (np.diff(means) > 0).all()
    own = means[np.searchsorted(present, found)]
    nearest = np.abs(values[:, None] - means).min(axis=1)
    assert (np.abs(values - own) <= nearest + 1e-9).all()


FREEDOMS = np.arange(1, MAX_FREEDOMS + 1)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_chi_square(share):
    exact = stats.chi2.ppf(share, FREEDOMS) / FREEDOMS
    assert chi_square(share)[1:] == pytest.approx(exact, rel=0.006)
    assert chi_square(share)[1:5] == pytest.approx(exact[:4], rel=1e-5)


def test_student():
    freedoms = FREEDOMS[4:].astype(float)
    assert student(freedoms) == pytest.approx(stats.t.isf(0.005, freedoms), rel=0.01)
