"""The median and its like, without sorting and without the masked arrays that numpy's own imports.

Of many numbers those that share their leading bits are counted first; only the few that share
those of the number looked for are then partitioned.
"""

from __future__ import annotations

import math

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.kernels.compiled import compiled

MANY = 1 << 16
"""Numbers below which partitioning them all is as fast."""


@compiled
def _leading(bits):
    """Sixteen bits of a number that is not NaN, greater for greater numbers."""
    below_zero = bits >> np.uint64(63)
    turn = np.uint64(0xFFFFFFFFFFFFFFFF) if below_zero else np.uint64(0x8000000000000000)
    return (bits ^ turn) >> np.uint64(48)


@compiled
def _counted(bits, counts):
    for at in range(len(bits)):
        counts[_leading(bits[at])] += 1


@compiled
def _alike(bits, leading, found):
    """Collect in ``found`` those with these leading bits; one place more than they need."""
    count = 0
    wanted = np.uint64(leading)
    for at in range(len(bits)):
        found[count] = bits[at]
        count += _leading(bits[at]) == wanted


def ranked(values: Floats, *ranks: int) -> list[float]:
    """Those of values (n,), none NaN, that would stand at ``ranks``, from 0 on, if sorted."""
    if len(values) < MANY:
        return [float(np.partition(values, rank)[rank]) for rank in ranks]
    bits = np.ascontiguousarray(values).view(np.uint64)
    counts = np.zeros(1 << 16, dtype=np.int64)
    _counted(bits, counts)
    through = np.cumsum(counts)
    results = []
    known: dict[int, Floats] = {}
    for rank in ranks:
        leading = int(np.searchsorted(through, rank, side="right"))
        if leading not in known:
            found = np.empty(int(counts[leading]) + 1, dtype=np.uint64)
            _alike(bits, leading, found)
            known[leading] = np.sort(found[:-1].view(np.float64))
        results.append(float(known[leading][rank - int(through[leading] - counts[leading])]))
    return results


def median(values: Floats) -> float:
    """The median of one number at least, none of them NaN; the mean of the middle two."""
    middle = len(values) // 2
    if len(values) % 2:
        return ranked(values, middle)[0]
    return sum(ranked(values, middle - 1, middle)) / 2.0


def quantile_above_zero(values: Floats, share: float) -> float:
    """The least value which at least ``share`` of those above zero do not exceed; 0.0 if none is.

    ``values`` (n,) are not below zero and not NaN; 0 < ``share`` <= 1, where 1 gives the largest.
    """
    above = int(np.count_nonzero(values))
    if not above:
        return 0.0
    return ranked(values, len(values) - above + math.ceil(share * above) - 1)[0]
