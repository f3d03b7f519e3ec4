"""Numbers as colours, and their scale."""

import numpy as np
import pytest

from msal_cli.analysis import colour_maps as colours
from msal_cli.view.colours import scale_of


def test_a_signed_scale_is_symmetric_about_a_pale_middle():
    scale = scale_of(np.array([-1.0, 0.0, 3.0]), is_signed=True)
    assert scale.low == -scale.high == -3.0
    low, middle, high = scale.paint(np.array([-3.0, 0.0, 3.0])).astype(int)
    assert np.ptp(middle) <= 3 and middle.min() > 200
    assert low[2] > low[0] and high[0] > high[2]


def test_one_stray_vertex_does_not_pale_the_rest():
    values = np.append(np.linspace(-1.0, 1.0, 1000), 500.0)
    scale = scale_of(values, is_signed=True)
    assert 0.95 < scale.high <= 1.0
    assert (scale.paint(np.array([500.0])) == colours.colour_table("diverging")[-1]).all()


@pytest.mark.parametrize(
    ("size", "end"), [(0.00123, 0.0013), (1.0, 1.0), (987.0, 990.0), (3e-9, 3e-9), (1e12, 1e12)]
)
def test_ends_are_rounded_up_to_two_digits(size, end):
    assert scale_of(np.full(5, size), is_signed=False).high == pytest.approx(end, rel=1e-12)


def test_distances_start_at_nothing():
    scale = scale_of(np.array([0.5, 2.0]), is_signed=False)
    assert (scale.low, scale.map_name) == (0.0, "sequential")


@pytest.mark.parametrize("values", [[0.0, 0.0], [], [np.nan]])
@pytest.mark.parametrize("is_signed", [True, False])
def test_nothing_to_show_still_has_a_scale(values, is_signed):
    scale = scale_of(np.array(values), is_signed=is_signed)
    assert scale.high == 1.0
    assert len(scale.paint(np.array(values))) == len(values)


def test_the_legend_says_both_units():
    legend = scale_of(np.array([-4.0, 4.0]), is_signed=True).legend(("moved",), 8.0)
    assert [tick[0] for tick in legend.ticks] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert [tick[1] for tick in legend.ticks] == ["-4", "-2", "0", "2", "4"]
    assert [tick[2] for tick in legend.ticks] == ["-0.5", "-0.25", "0", "0.25", "0.5"]


@pytest.mark.parametrize("size", [5e-324, 1e-300, 1e-12, 1.0, 1e12, 1e300])
def test_a_scale_fits_the_smallest_and_the_largest_deviations(size):
    scale = scale_of(np.array([-size, 0.0, size]), is_signed=True)
    assert np.isfinite(scale.high) and scale.high >= size and scale.low == -scale.high
    painted = scale.paint(np.array([-size, 0.0, size]))
    legend = scale.legend(("",), 1.0)
    assert [above for _, above, _ in legend.ticks][2] == "0"
    if size >= 1e-290:
        assert (painted[0] != painted[2]).any()


def test_the_scale_of_equal_meshes_is_about_zero():
    scale = scale_of(np.zeros(5), is_signed=True, if_none=0.25)
    assert (scale.low, scale.high) == (-0.25, 0.25)
    assert [above for _, above, _ in scale.legend(("",), 0.25).ticks][2] == "0"
