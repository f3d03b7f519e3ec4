"""Numbers by themselves: medians, quantiles, clusters and exponentials."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from msal_cli.kernels import quantiles, vectors


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30))
def test_they_are_those_of_numpy(values):
    assert quantiles.median(np.array(values)) == np.median(values)
    shares = (0.0, 0.3, 1.0)
    found = quantiles.quantiles(np.array(values), shares)
    assert found == pytest.approx(np.quantile(values, shares), rel=1e-12, abs=1e-6)
    whole = np.abs(values).astype(np.int64)
    assert quantiles.find_distinct(whole).tolist() == np.unique(whole).tolist()


@pytest.mark.parametrize("count", [2, 3, 7])
def test_equal_values_are_the_lowest_cluster(count):
    assert quantiles.clusters(np.full(5, 0.3), count).tolist() == [0] * 5
    assert quantiles.clusters(np.array([0.3]), count).tolist() == [0]


def test_student():
    freedoms = np.arange(5.0, 41.0)
    exact = special.stdtrit(freedoms, 0.995)
    assert quantiles.student(freedoms) == pytest.approx(exact, rel=0.01)


def computed(values):
    values = np.array(values, dtype=np.float64)
    vectors.exponentials(values, len(values))
    return values


def powers(exponents):
    return np.array([vectors.power_of_two(float(exponent)) for exponent in exponents])


@pytest.mark.parametrize("low", [-1e-8, -0.5, -1.0, -30.0, vectors.MIN_POWER])
def test_within_two_ulp(low):
    exponents = np.random.default_rng(0).uniform(low, 0.0, 10_000)
    exact = np.exp2(exponents)
    assert (np.abs(powers(exponents) - exact) <= 2 * np.spacing(exact)).all()
    # The exponent of exp is rounded before.
    exact = np.exp(exponents[exponents > -700.0])
    assert computed(np.log(exact)) == pytest.approx(exact, rel=3e-16 * max(2.0, -low))


@given(st.lists(st.floats(-1e300, 0.0), min_size=1, max_size=40))
def test_any_list_gives_what_single_numbers_give(values):
    # No number's bits may depend on its neighbours: ranges of threads cut blocks anywhere.
    together = computed(values)
    assert together.tolist() == [computed([value])[0] for value in values]
    assert ((together >= 0.0) & (together <= 1.0)).all()


def test_whole_powers_of_two_are_exact():
    whole = np.arange(vectors.MIN_POWER, 1.0)
    assert (powers(whole) == np.ldexp(1.0, whole.astype(int))).all()


LENGTHS = st.floats(0.0, 1e6)


@given(st.lists(st.tuples(LENGTHS, LENGTHS), min_size=1, max_size=20))
def test_it_is_that_of_the_library(pairs):
    y, x = np.array(pairs).T.copy()
    expected = np.arctan2(y, x)
    vectors.arctangents(y, x, len(y))
    assert np.abs(y - expected).max() <= 4e-16 * np.pi
