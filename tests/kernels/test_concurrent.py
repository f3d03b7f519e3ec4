"""Different work at the same time."""

from __future__ import annotations

import threading

import pytest

from msal_cli.kernels.parallel import MIN_COUNT, at_once, is_worth_it


@pytest.mark.parametrize("cores", ["1", "3"])
def test_results_come_in_the_order_of_the_tasks(cores, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", cores)
    assert at_once(MIN_COUNT, lambda: 1, lambda: "two", lambda: None) == [1, "two", None]
    assert at_once(1, lambda: 1) == [1]


def test_many_items_and_cores_are_shared(monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", "2")
    meeting = threading.Barrier(2, timeout=20.0)
    # Neither passes before the other has come.
    at_once(MIN_COUNT, meeting.wait, meeting.wait)
    assert not is_worth_it(MIN_COUNT - 1)
    monkeypatch.setenv("MSAL_THREADS", "1")
    assert not is_worth_it(MIN_COUNT)


@pytest.mark.parametrize("cores", ["1", "2"])
def test_the_first_failure_is_raised(cores, monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", cores)

    def fail(word):
        raise ValueError(word)

    with pytest.raises(ValueError, match="one"):
        at_once(MIN_COUNT, lambda: 0, lambda: fail("one"), lambda: fail("two"))
