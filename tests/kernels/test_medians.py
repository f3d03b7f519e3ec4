"""The median against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.kernels.quantiles import MANY, median, quantile_above_zero, ranked


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30))
def test_it_is_that_of_numpy(values):
    assert median(np.array(values)) == np.median(values)


@pytest.mark.parametrize(("values", "middle"), [([3.0], 3.0), ([1, 2], 1.5), ([5, 1, 2], 2.0)])
def test_by_hand(values, middle):
    assert median(np.array(values)) == middle


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
    assert ranked(values, *ranks) == np.sort(values)[list(ranks)].tolist()


def test_the_zeros_are_alike_and_infinity_is_last():
    values = np.tile([0.0, -0.0, np.inf, -np.inf], MANY // 4)
    assert median(values) == 0.0
    assert ranked(values, 0, MANY // 2, MANY - 1) == [-np.inf, 0.0, np.inf]


@pytest.mark.parametrize(
    ("values", "share", "expected"),
    [
        ([4.0, 1.0, 3.0, 2.0], 1.0, 4.0),
        ([4.0, 1.0, 3.0, 2.0], 0.75, 3.0),
        ([4.0, 1.0, 3.0, 2.0], 0.76, 4.0),
        ([4.0, 1.0, 3.0, 2.0], 1e-9, 1.0),
        ([0.0, 0.0, 5.0, 0.0, 2.0], 0.5, 2.0),
        ([0.0, -0.0], 0.5, 0.0),
        ([], 1.0, 0.0),
    ],
)
def test_quantiles_above_zero_by_hand(values, share, expected):
    assert quantile_above_zero(np.array(values), share) == expected


@pytest.mark.parametrize("n", [1000, MANY + 7])
def test_a_quantile_is_the_least_that_the_share_does_not_exceed(n):
    values = np.maximum(np.random.default_rng(0).normal(size=n), 0.0)
    above = np.sort(values[values > 0.0])
    for share in (0.01, 0.5, 0.99, 0.995, 1.0):
        found = quantile_above_zero(values, share)
        assert (above <= found).mean() >= share
        assert (above < found).mean() < share
