"""Rows that are found once: put together in order, whatever the parts and threads."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels import parallel
from msal_cli.kernels import variable_rows as module
from msal_cli.kernels.variable_rows import found_rows

MOST = 7


def shares(start, stop, first, sizes, found):
    """Row i: the numbers 10 i, 10 i + 1, ..., i % 7 of them."""
    filled = start * MOST
    for i in range(first + start, first + stop):
        sizes[i] = i % MOST
        for k in range(sizes[i]):
            found[filled] = 10 * i + k
            filled += 1
    return start * MOST, filled


@pytest.mark.parametrize("threads", ["1", "3"])
@pytest.mark.parametrize("part", [4, 13, 100])
@pytest.mark.parametrize("count", [1, 50])
def test_rows_are_in_order(monkeypatch, count, part, threads):
    monkeypatch.setattr(module, "SMALLEST_PART", part)
    monkeypatch.setattr(parallel, "SMALLEST_RANGE", 2)
    monkeypatch.setenv("MSAL_THREADS", threads)
    sizes, rows = found_rows(shares, count, MOST)
    assert sizes.tolist() == [i % MOST for i in range(count)]
    assert rows.tolist() == [10 * i + k for i in range(count) for k in range(i % MOST)]
    assert rows.dtype == np.int32


def test_very_long_rows_take_smaller_parts(monkeypatch):
    monkeypatch.setattr(module, "MOST_ROOM", 3 * MOST + 1)
    parts = []

    def noted(start, stop, first, sizes, found):
        parts.append((first, len(found)))
        return shares(start, stop, first, sizes, found)

    _, rows = found_rows(noted, 8, MOST)
    assert parts == [(0, 3 * MOST), (3, 3 * MOST), (6, 2 * MOST)]
    assert rows.tolist() == [10 * i + k for i in range(8) for k in range(i % MOST)]


def test_all_rows_may_be_empty():
    sizes, rows = found_rows(lambda start, stop, first, sizes, found: (0, 0), 3, 0)
    assert len(sizes) == 3
    assert len(rows) == 0


def test_there_are_no_more_ranges_than_asked_for(monkeypatch):
    monkeypatch.setenv("MSAL_THREADS", "8")
    ranges = parallel.over_ranges(lambda start, stop: (start, stop), 100, smallest=1, most=3)
    assert ranges == [(0, 33), (33, 66), (66, 100)]
