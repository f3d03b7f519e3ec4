"""Ground truth: the volumes of the paper's Table 1, from its own Fandisk."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.table1 import volumes


def test_fandisk(real_data):
    original, rows = volumes(real_data / "clean" / "fandisk.obj", seeds=4)
    assert original == pytest.approx(20.243, abs=5e-4)
    al, msal = (rows[:, 1:] - rows[:, :1]).mean(axis=0)
    assert abs(al + 0.262) < 0.006
    assert abs(msal + 0.066) < 0.007
    assert np.abs((rows[:, 1:] - rows[:, :1]) - [-0.262, -0.066]).max() < 0.012


def test_bunny(real_data):
    _, rows = volumes(real_data / "clean" / "stanford-bunny.obj", seeds=1)
    al, msal = rows[0, 1:] / rows[0, 0]
    assert al == pytest.approx(0.9956, abs=4e-4)
    assert msal == pytest.approx(0.9977, abs=4e-4)
