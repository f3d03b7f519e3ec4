"""Exponentials and arctangents against those of the library."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.kernels.elementary import (
    MIN_ARGUMENT,
    MIN_POWER,
    arctangents,
    exponentials,
    power_of_two,
)


def computed(values):
    values = np.array(values, dtype=np.float64)
    scratch = np.empty(len(values))
    exponentials(values, scratch, scratch.view(np.int64), len(values))
    return values


@pytest.mark.parametrize("low", [-1e-8, -1.0, -30.0, MIN_ARGUMENT])
def test_within_two_ulp(low):
    values = np.random.default_rng(0).uniform(low, 0.0, 100_000)
    exact = np.exp(values)
    assert (np.abs(computed(values) - exact) <= 2 * np.spacing(exact)).all()


@given(st.lists(st.floats(-1e300, 0.0), min_size=1, max_size=40))
def test_any_list_gives_what_single_numbers_give(values):
    # No number's bits may depend on its neighbours: ranges of threads cut blocks anywhere.
    together = computed(values)
    assert together.tolist() == [computed([value])[0] for value in values]
    assert ((together >= 0.0) & (together <= 1.0)).all()


def powers(exponents):
    return np.array([power_of_two(float(exponent)) for exponent in exponents])


def test_whole_powers_of_two_are_exact():
    whole = np.arange(MIN_POWER, 1.0)
    assert (powers(whole) == np.ldexp(1.0, whole.astype(int))).all()


@pytest.mark.parametrize("low", [-1e-8, -0.5, -1.0, -30.0, MIN_POWER])
def test_powers_of_two_are_within_two_ulp(low):
    exponents = np.random.default_rng(0).uniform(low, 0.0, 10_000)
    exact = np.exp2(exponents)
    assert (np.abs(powers(exponents) - exact) <= 2 * np.spacing(exact)).all()


LENGTHS = st.floats(0.0, 1e6)


def angles_of(numerators, denominators):
    values = np.array(numerators, dtype=np.float64)
    arctangents(values, np.array(denominators, dtype=np.float64), len(values))
    return values


@given(st.lists(st.tuples(LENGTHS, LENGTHS), min_size=1, max_size=20))
def test_it_is_that_of_the_library(pairs):
    y, x = np.array(pairs).T
    expected = np.arctan2(y, x)
    assert np.abs(angles_of(y, x) - expected).max() <= 4e-16 * np.pi
