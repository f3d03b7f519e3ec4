"""The block arctangent against the library's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.kernels.elementary import arctangents

LENGTHS = st.floats(0.0, 1e6)


def computed(numerators, denominators):
    values = np.array(numerators, dtype=np.float64)
    arctangents(values, np.array(denominators, dtype=np.float64), len(values))
    return values


@pytest.mark.parametrize(
    ("y", "x", "angle"),
    [(0, 0, 0), (0, 1, 0), (1, 0, np.pi / 2), (1, 1, np.pi / 4), (3, np.sqrt(3), np.pi / 3)],
)
def test_by_hand(y, x, angle):
    assert computed([y], [x])[0] == pytest.approx(angle, abs=1e-15)


@given(st.lists(st.tuples(LENGTHS, LENGTHS), min_size=1, max_size=20))
def test_it_is_that_of_the_library(pairs):
    y, x = np.array(pairs).T
    expected = np.arctan2(y, x)
    assert np.abs(computed(y, x) - expected).max() <= 4e-16 * np.pi


def test_tiny_angles_keep_their_digits():
    y = np.logspace(-300, 0, 1000)
    assert np.allclose(computed(y, np.ones(1000)), np.arctan(y), rtol=1e-15, atol=0.0)


def test_only_so_many_are_replaced():
    values = np.array([1.0, 5.0])
    arctangents(values, np.ones(2), 1)
    assert values[1] == 5.0
