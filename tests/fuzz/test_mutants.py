"""Damaged files end in an error of ours or in a whole result, whatever was done to them.

`python -m tests.fuzz.mutants` runs 30,000 of each format and says how fast.
"""

from __future__ import annotations

import gzip

import pytest

from tests.fuzz import mutants, survival


@pytest.mark.parametrize("format", survival.FORMATS)
def test_seeds_are_whole(format):
    for data in mutants.seeds(format):
        whole = gzip.compress(data) if format == "gz" else data
        assert survival.outcome(whole, format) == "ok"


@pytest.mark.parametrize("format", survival.FORMATS)
def test_mutants(format):
    tally, _ = mutants.campaign(format, 400)
    # Both ends of the scale must be met, or the damage is too mild or too rough to tell.
    assert 0.05 * tally.total() < tally["ok"] < 0.95 * tally.total()
    assert len(tally) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("format", survival.FORMATS)
def test_many_mutants(format):
    mutants.campaign(format, 30_000, 1_000)


def test_a_mutant_can_be_made_again():
    for format in survival.FORMATS:
        made = [mutants.mutant(format, number) for number in range(60)]
        assert made == [mutants.mutant(format, number) for number in range(60)]
        assert len(set(made)) > 50


def test_a_failure_names_its_mutant(monkeypatch):
    def traceback(data: bytes, format: str) -> str:
        raise IndexError("a defect")

    monkeypatch.setattr(mutants, "outcome", traceback)
    with pytest.raises(
        AssertionError, match=r"mutant 7 of ply: python -m tests.fuzz.mutants ply 1 7"
    ):
        mutants.campaign("ply", 1, 7)
