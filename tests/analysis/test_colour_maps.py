"""Colour maps: ends, order of lightness, and values that are beyond them or no numbers."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis import colour_maps as colours


def luminance(table):
    part = table / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    return linear @ [0.2126, 0.7152, 0.0722]


def test_sequential_gets_darker_at_every_step():
    light = luminance(colours.colour_table("sequential"))
    assert (np.diff(light) < 0.004).all()
    assert (np.diff(light[::4]) < 0.0).all()


def test_diverging_is_palest_and_grey_in_the_middle_and_as_dark_at_both_ends():
    table = colours.colour_table("diverging")
    light = luminance(table)
    middle = colours.SHADES // 2
    assert (np.diff(light[:middle:4]) > 0.0).all()
    assert (np.diff(light[middle::4]) < 0.0).all()
    assert np.ptp(table[middle].astype(int)) <= 4
    assert light[0] == pytest.approx(light[-1], abs=0.03)
    zero = colours.map_colours(np.array([0.0]), -1.0, 1.0, "diverging")
    assert np.array_equal(zero, table[middle : middle + 1])


@pytest.mark.parametrize("name", colours.map_names())
def test_ends_beyond_and_not_a_number(name):
    table = colours.colour_table(name)
    got = colours.map_colours(np.array([-9.0, 1.0, 3.0, np.inf, -np.inf, np.nan]), 1.0, 3.0, name)
    assert got.dtype == np.uint8
    expected = [table[0], table[0], table[-1], table[-1], table[0], colours.UNKNOWN]
    assert np.array_equal(got, expected)
