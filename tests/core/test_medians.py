"""The median against numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.core.medians import median


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=30))
def test_it_is_that_of_numpy(values):
    assert median(np.array(values)) == np.median(values)


@pytest.mark.parametrize(("values", "middle"), [([3.0], 3.0), ([1, 2], 1.5), ([5, 1, 2], 2.0)])
def test_by_hand(values, middle):
    assert median(np.array(values)) == middle
