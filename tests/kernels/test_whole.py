"""Numbers of a whole mesh from what its parts contribute."""

from __future__ import annotations

import json
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.kernels import quantiles, selection
from msal_cli.kernels.exact_sum import BINS, add_exactly, combine_means, mean_partial
from msal_cli.kernels.geometry import edge_lengths_partial, mean_edge_length
from msal_cli.kernels.whole import (
    Pending,
    Whole,
    combine,
    largest_of_all,
    median_of_all,
    quantile_of_all,
    select_of_all,
)

LENGTHS = st.lists(st.floats(0.0, 1e300), max_size=50)


def partial_of(lengths):
    bins = np.zeros(BINS, dtype=np.int64)
    add_exactly(np.array(lengths, dtype=np.float64).view(np.int64), len(lengths), bins)
    return mean_partial(bins, len(lengths))


@given(LENGTHS, st.integers(0, 50))
def test_a_mean_is_rounded_once_however_it_is_split(lengths, at):
    parts = [partial_of(lengths[:at]), partial_of(lengths[at:])]
    true = float(sum(map(Fraction, lengths), Fraction()) / len(lengths)) if lengths else 0.0
    assert combine_means(json.loads(json.dumps(parts))) == true
    assert combine_means([partial_of(lengths)]) == true


def test_the_least_numbers_count():
    least = np.nextafter(0.0, 1.0)
    assert combine_means([partial_of([least, 3 * least])]) == 2 * least
    assert combine_means([partial_of([2.0**-1022, 2.0**-1022])]) == 2.0**-1022


def test_a_mean_edge_length_does_not_depend_on_threads(monkeypatch):
    generator = np.random.default_rng(1)
    n = 200_000
    vertices = generator.normal(size=(n, 3)) * 10.0 ** generator.uniform(-5, 5, (n, 1))
    starts = np.arange(n + 1, dtype=np.int32)
    ring = np.roll(np.arange(n, dtype=np.int32), -1)
    found = []
    for threads in "123":
        monkeypatch.setenv("MSAL_THREADS", threads)
        found.append(mean_edge_length(vertices, starts, ring))
    own = generator.random(n) < 0.5
    parts = [edge_lengths_partial(vertices, starts, ring, one) for one in (own, ~own)]
    assert {combine(parts), *found} == {found[0]}
    lengths = np.linalg.norm(np.diff(vertices, axis=0), axis=1)
    assert found[0] == pytest.approx(lengths.mean(), rel=1e-12)


def split(values, parts, seed):
    labels = np.random.default_rng(seed).integers(0, parts, len(values))
    return [values[labels == one] for one in range(parts)]


def of_parts(ask, parts, rounds=20):
    """What ``ask(whole, values)`` gives for all parts, with reductions over them."""
    known = {}
    for _ in range(rounds):
        contributed = {}
        results = []
        for values in parts:
            own = np.ones(len(values), dtype=bool)
            try:
                results.append(ask(Whole(own, own[:0], known), values))
            except Pending as pending:
                text = json.dumps(pending.partial)
                assert len(text) < 200_000
                contributed.setdefault(pending.key, []).append(json.loads(text))
        if results:
            assert len(results) == len(parts)
            assert len(set(map(repr, results))) == 1
            return results[0]
        ((key, partials),) = contributed.items()
        known[key] = json.loads(json.dumps(combine(partials)))
    raise AssertionError("the rounds do not end")


@given(
    st.lists(st.floats(0.0, 10.0) | st.sampled_from([0.0, 1.0, 2.0]), min_size=1, max_size=60),
    st.floats(0.0, 1.0, exclude_min=True),
    st.sampled_from([1, 7, 4096]),
)
def test_quantiles_of_parts_are_those_of_the_whole(values, share, few):
    values = np.array(values)
    parts = split(values, 3, 0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selection, "FEW", few)
        found = of_parts(lambda whole, part: quantile_of_all(whole, "q", part, share), parts)
    assert found == quantiles.quantile_above_zero(values, share)


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_medians_of_parts_are_those_of_the_whole(values):
    parts = split(np.array(values), 4, 1)
    found = of_parts(lambda whole, part: median_of_all(whole, "m", lambda: part), parts)
    assert found == quantiles.median(np.array(values))


def test_quantiles_of_many_values():
    values = np.random.default_rng(2).lognormal(size=300_000)
    parts = split(values, 5, 2)
    found = of_parts(lambda whole, part: quantile_of_all(whole, "q", part, 0.99), parts)
    assert found == quantiles.quantile_above_zero(values, 0.99)


def test_no_value_in_any_part():
    parts = [np.zeros(3), np.zeros(0)]
    assert of_parts(lambda whole, part: quantile_of_all(whole, "q", part, 0.5), parts) == 0.0
    empty = [np.zeros(0), np.zeros(0)]
    assert of_parts(lambda whole, part: median_of_all(whole, "m", lambda: part), empty) is None
    assert of_parts(lambda whole, part: select_of_all(whole, "s", lambda: part, []), empty) == []
    assert of_parts(lambda whole, part: largest_of_all(whole, "l", part), empty) == 0.0


def test_the_largest_counts_own_vertices_only():
    own = np.array([True, False])
    with pytest.raises(Pending) as raised:
        largest_of_all(Whole(own, own), "l", np.array([1.0, 5.0]), lambda: {"x": own})
    assert raised.value.key == "l"
    assert combine([raised.value.partial]) == 1.0
    assert raised.value.state["x"] is own


def test_steps_have_keys_and_states_of_their_own():
    flags = np.ones(1, dtype=bool)
    inner = Whole(flags, flags).under("a").under("b")
    with pytest.raises(Pending) as raised:
        inner.reduce("key", lambda: 1, lambda: {"x": flags})
    assert raised.value.key == "a/b/key"
    again = Whole(flags, flags, {"a/b/key": 7}, raised.value.state)
    assert again.state().keys() == {"a/b/x"}
    assert again.under("a").under("b").state().keys() == {"x"}
    assert again.under("a").under("b").reduce("key", lambda: 1) == 7
