"""Histograms: every value is counted, and a few outliers squeeze nothing."""

from __future__ import annotations

import random
from xml.etree import ElementTree as Xml

import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.report import histogram


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=50))
def test_every_value_is_counted(values):
    bins = histogram.bin_values(values)
    assert bins.below + sum(bins.counts) + bins.beyond == len(values)
    assert len(bins.edges) == len(bins.counts) + 1
    Xml.fromstring(histogram.svg("title", values, ".3g"))


def test_equal_steps_from_the_lowest_to_the_highest():
    bins = histogram.bin_values([at / 100 for at in range(2401)])
    assert bins.edges[0] == 0.0 and bins.edges[-1] == pytest.approx(24.0)
    assert bins.below == bins.beyond == 0
    assert bins.counts[:-1] == (100,) * 23


def test_a_few_outliers_stand_beside_the_axis():
    chance = random.Random(1)
    bins = histogram.bin_values([*(chance.random() for _ in range(1000)), 1e6, -1e6])
    assert (bins.below, bins.beyond) == (1, 1)
    assert -3.0 < bins.edges[0] < bins.edges[-1] < 4.0


def test_one_value_and_none():
    assert sum(histogram.bin_values([5.0]).counts) == 1
    assert histogram.svg("t", [float("nan"), float("inf")], ".3g") == ""


def test_it_tells_those_who_do_not_see_it():
    drawn = Xml.fromstring(histogram.svg('a "b" <c>', [1.0, 2.0, 3.0], ".3g"))
    assert drawn.get("aria-label") == 'a "b" <c>: 3 files from 1 to 3, median 2'
    titles = [one.text for one in drawn.iter("title")]
    assert len(titles) == 3 and titles[0].startswith("1 file, 1 to ")
