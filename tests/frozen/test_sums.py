"""Every method gives the bytes that it gave when the sums were frozen."""

from __future__ import annotations

import json

import pytest

from tests.frozen import sums

KEPT = json.loads(sums.KEPT.read_text())


@pytest.fixture(autouse=True)
def same_environment():
    here = sums.environment()
    different = [f"{name} {here[name]}" for name in here if here[name] != KEPT["environment"][name]]
    if different:
        pytest.skip(f"the sums were made elsewhere: here is {', '.join(different)}")


def compare(case, folder):
    path = sums.locate(case[0])
    if path is None:
        pytest.skip("MSAL_DATA is not set: no real scans at hand")
    # If this is meant: python -m tests.frozen.sums --write
    assert sums.output_sum(path, case[1], folder) == KEPT["sums"][sums.key(case)]


@pytest.mark.parametrize("case", list(sums.fast_cases()), ids=sums.key)
def test_the_bytes_are_the_frozen_ones(case, tmp_path):
    compare(case, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("case", list(sums.all_cases()), ids=sums.key)
def test_all_bytes_are_the_frozen_ones(case, tmp_path):
    compare(case, tmp_path)


def test_every_case_has_a_sum():
    assert set(KEPT["sums"]) == {sums.key(case) for case in sums.all_cases()}
