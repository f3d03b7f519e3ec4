"""The table of what is tried."""

from __future__ import annotations

import pytest

from msal_cli import methods
from msal_cli.auto import candidates
from msal_cli.auto.candidates import CANDIDATES, NAMES


@pytest.mark.parametrize("candidate", CANDIDATES, ids=lambda candidate: candidate.label)
def test_settings_are_allowed(candidate):
    method = methods.find(candidate.method)
    settings = candidate.settings(0.125)
    values = method.validate(settings)
    assert ("noise" in settings) == candidate.takes_noise
    if candidate.takes_noise:
        assert values["noise"] == 0.125
    assert candidate.cost > 0.0
    assert {spec.name for spec in method.parameters} >= set(settings)


def test_all_differ_in_what_they_are_and_in_what_they_are_called():
    assert len({candidate.label for candidate in CANDIDATES}) == len(CANDIDATES)
    made = {
        repr((candidate.method, sorted(candidate.settings(0.1).items())))
        for candidate in CANDIDATES
    }
    assert len(made) == len(CANDIDATES)


def test_a_farther_reach_is_a_multiple_of_the_noise():
    settings = [
        candidate.settings(0.125)["noise"] for candidate in (candidates.LEARNED, candidates.FARTHER)
    ]
    assert settings == [0.125, 0.25]
    assert candidates.FARTHER.label == "learned (noise times 2)"


def test_every_name_is_in_use():
    tried = (*CANDIDATES, *candidates.PULLED, *candidates.LINEAR, candidates.FLATTENER)
    used = {candidate.method for candidate in tried}
    # The others are schedules that the plain command chooses.
    assert set(NAMES) == used | set(candidates._KINDS.values())
    assert set(candidates._WORDS) <= set(NAMES)
