"""Every exit status, and which one wins."""

from __future__ import annotations

import itertools

import pytest

from msal_cli import errors
from msal_cli.batch.inputs import NothingMatched
from msal_cli.batch.interrupts import Terminated
from msal_cli.cli import console


@pytest.mark.parametrize(
    ("n_files", "n_failed", "gate", "status"),
    [(1, 0, False, 0), (3, 0, True, 4), (1, 1, False, 1), (3, 3, True, 1), (3, 1, True, 3)]
    + [(3, 2, False, 3), (0, 0, False, 0)],
)
def test_of_files(n_files, n_failed, gate, status):
    assert console.status_of_files(n_files, n_failed, is_gate_failed=gate) == status


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (errors.UsageError("x"), 2),
        (errors.UsageError("x", code="E_LOCKED"), 2),
        (NothingMatched("x"), 5),
        (errors.OutputError("x"), 1),
        (errors.InputError("x"), 1),
        (errors.InternalError("x"), 1),
        (errors.ResourceError("x"), 1),
    ],
)
def test_of_errors(error, status):
    assert console.status_of_error(error) == status


def test_of_signals():
    assert console.status_of_interrupt(KeyboardInterrupt()) == 130
    assert console.status_of_interrupt(Terminated(15)) == 143


def test_the_worst_wins():
    ranking = [130, 1, 3, 4, 0]
    for first, second in itertools.combinations_with_replacement(ranking, 2):
        assert console.worst_status(first, second) == first
        assert console.worst_status(second, first) == first
    assert console.worst_status(2, 1) == console.worst_status(1, 2) == 2
    assert console.worst_status(143, 130) == 143
