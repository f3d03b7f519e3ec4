"""Quantiles against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from msal_cli.kernels.patch_fits import MOST_VERTICES
from scipy import stats

from msal_cli.kernels.quantiles import MOST_FREEDOMS, chi_square, student

FREEDOMS = np.arange(1, MOST_FREEDOMS + 1)


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_chi_square(share):
    exact = stats.chi2.ppf(share, FREEDOMS) / FREEDOMS
    assert chi_square(share)[1:] == pytest.approx(exact, rel=0.006)
    assert chi_square(share)[1:5] == pytest.approx(exact[:4], rel=1e-5)


def test_student():
    freedoms = FREEDOMS[4:].astype(float)
    assert student(freedoms) == pytest.approx(stats.t.isf(0.005, freedoms), rel=0.01)


def test_there_is_a_quantile_for_every_patch():
    assert MOST_FREEDOMS >= MOST_VERTICES - 1
