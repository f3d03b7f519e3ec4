"""How far the vertices of two meshes that are read in pieces are apart."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import DisplacementStatistics
from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.job.streamed_faces import OnStep, used_flags, vertex_ranges
from msal_cli.kernels.geometry import distances

BIN_BITS = 20
"""Bits of a number that are told apart in one pass: a bin is 0.4 % wide after the first."""

MOST_KEPT = 1 << 22
"""Numbers that are kept in memory at once: 34 MB."""

Pass = Callable[[], Iterator[Floats]]
"""Gives all numbers in parts, each time anew."""


def displacement_in_pieces(
    before: StreamedMesh,
    after: StreamedMesh,
    used: NDArray[np.uint8],
    on_step: OnStep,
) -> DisplacementStatistics:
    """Statistics over the vertices that are marked in ``used``; see ``streamed_totals.Totals``.

    The vertices of both are read twice, rarely more often.
    """

    def lengths() -> Iterator[Floats]:
        for start, stop in vertex_ranges(before):
            first = before.read_vertices(start, stop).astype(np.float64)
            second = after.read_vertices(start, stop).astype(np.float64)
            yield distances(first, second)[used_flags(used, start, stop)]
            on_step(2 * (stop - start))

    count = n_moved = 0
    total = squares = largest = 0.0
    bins = np.zeros(1 << BIN_BITS, dtype=np.int64)
    for part in lengths():
        count += len(part)
        n_moved += int(np.count_nonzero(part))
        total += float(part.sum())
        squares += float((part * part).sum())
        largest = max(largest, float(part.max(initial=0.0)))
        bins += leading_bins(part)
    if not count:
        return DisplacementStatistics(0.0, 0.0, 0.0, 0.0, 0)
    rank = min(count - 1, math.ceil(0.95 * count) - 1)
    return DisplacementStatistics(
        mean=total / count,
        rms=math.sqrt(squares / count),
        p95=number_of_rank(lengths, rank, bins),
        max=largest,
        moved_vertices=n_moved,
    )


def number_of_rank(numbers: Pass, rank: int, bins: Longs | None = None) -> float:
    """The number, none of which is negative, that ``rank`` others come before in their order.

    The bits of such numbers are in the same order.  ``bins`` counts their leading bits, where they
    are counted already; each pass more looks at those with the right ones only, until they are few
    enough to be sorted.
    """
    shift, leading = 64 - BIN_BITS, 0
    if bins is None:
        bins = sum((leading_bins(part) for part in numbers()), np.zeros(1 << BIN_BITS, np.int64))
    while True:
        before = np.cumsum(bins)
        found = int(np.searchsorted(before, rank, side="right"))
        leading = leading << BIN_BITS | found
        rank -= int(before[found] - bins[found])
        wanted, places = np.uint64(leading), np.uint64(shift)
        if bins[found] <= MOST_KEPT:
            kept = [part[part.view(np.uint64) >> places == wanted] for part in numbers()]
            return float(np.partition(np.concatenate(kept), rank)[rank])
        if shift < BIN_BITS:
            # So many numbers that differ in the last four bits at most.
            return float(np.array([leading << shift], dtype=np.uint64).view(np.float64)[0])
        shift -= BIN_BITS
        bins = np.zeros(1 << BIN_BITS, dtype=np.int64)
        for part in numbers():
            bits = part.view(np.uint64)
            bits = bits[bits >> places == wanted] >> np.uint64(shift)
            bins += _bins(bits & np.uint64((1 << BIN_BITS) - 1))


def leading_bins(numbers: Floats) -> Longs:
    """How many numbers have each combination of leading bits (2 ** ``BIN_BITS``,)."""
    return _bins(numbers.view(np.uint64) >> np.uint64(64 - BIN_BITS))


def _bins(numbers: NDArray[np.uint64]) -> Longs:
    return np.bincount(numbers.astype(np.int64), minlength=1 << BIN_BITS)
