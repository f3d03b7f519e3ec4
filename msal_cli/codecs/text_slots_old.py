"""New positions and normals in a text file whose numbers are plain, and the check of the result.

Plain is nearly every text mesh: see ``kernels.fast_numbers``.  For the others the codecs of OBJ and
PLY have slower ways, which take more memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Bytes, Floats, Longs

_MOST_RUNS = 4096
"""Changes between positions and normals, on the way through a file, that are dealt with one by
one; a file with more of them takes another way."""

_BLOCK = 1 << 18
"""Bytes compared at a time; what they differ in fits the cache."""


@dataclass(frozen=True, eq=False)
class Statements:
    """Three numbers each, with blanks between them, to be replaced where they changed.

    Attributes
    ----------
    at : (n,) int64, ascending, first byte of each; ``skipped`` bytes of it are a keyword.
    old, new : (n, 3) float64; a number that is the same in both keeps its bytes.
    decimals : (n,) uint8, digits behind the point of the new numbers.
    """

    at: Longs
    skipped: int
    old: Floats
    new: Floats
    decimals: Bytes


def usual_decimals(decimals: Bytes) -> int:
    """The fewest decimals that all but one in a hundred of ``decimals`` (n,) do not exceed.

    A few numbers that some program wrote with all 17 digits say nothing about the others.
    """
    if not len(decimals):
        return 0
    counts = np.bincount(decimals, minlength=256)
    above = len(decimals) - np.cumsum(counts)
    return int(np.argmax(above * 100 <= len(decimals)))


def row_decimals(decimals: Bytes, least: int, largest: float) -> Bytes | None:
    """The digits behind the point for each new position: its own, and at least ``least``.

    ``decimals`` (n,) are those that the file has, ``largest`` the largest magnitude of a new
    number.  They are cut down to what float64 tells apart, about 15 digits in all; None where
    ``least`` are more than that.
    """
    most = 16
    while most >= 0 and not largest * 10.0**most < 2.0**52:
        most -= 1
    if least > most:
        return None
    return np.clip(decimals, least, most).astype(np.uint8)


def patched(data: Bytes, groups: Sequence[Statements]) -> memoryview | None:
    """The file with its statements' changed numbers replaced; None where it takes another way."""
    from msal_cli.kernels import fast_patch as plain_patch

    runs = _runs(groups)
    if runs is None:
        return None
    out = np.empty(len(data) + sum(map(_room, groups)) + 8, dtype=np.uint8)
    done = to = 0
    for which, start, stop in runs:
        one = groups[which]
        done, to = plain_patch.patched(
            data, done, start, stop, one.at, one.skipped, one.old, one.new, one.decimals, out, to
        )
    size = to + len(data) - done
    out[to:size] = data[done:]
    return out[:size].data


def _room(one: Statements) -> int:
    """Most bytes that new numbers take: sign, point, decimals, and digits before the point."""
    if not len(one.at):
        return 0
    largest = max(float(one.new.max()), -float(one.new.min()))
    return 3 * len(one.at) * (len(str(int(largest))) + int(one.decimals.max()) + 2)


def compared(data: Bytes, result: Bytes, groups: Sequence[Statements]) -> tuple[int, int, int]:
    """Whether ``result`` is the file with just that replaced: what ``plain_patch.compared`` says.

    It is ODD too where this is not the way to compare them.  Also the group and the statement.
    """
    from msal_cli.kernels import fast_patch as plain_patch

    runs = _runs(groups)
    if runs is None:
        return plain_patch.ODD, 0, 0
    tolerances = 0.5 * 10.0 ** -np.arange(256.0) * (1.0 + 1e-9)
    done = result_done = at = which = 0
    for which, start, stop in runs:
        one = groups[which]
        status, at, done, result_done = plain_patch.compared(
            data,
            result,
            done,
            result_done,
            start,
            stop,
            one.at,
            one.skipped,
            one.old,
            one.new,
            one.decimals,
            tolerances,
        )
        if status != plain_patch.DONE:
            return status, which, at
    if not is_same(data[done:], result[result_done:]):
        return plain_patch.DIFFERENT, which, at
    return plain_patch.DONE, which, at


def is_same(a: Bytes, b: Bytes) -> bool:
    """Whether two byte strings are equal, without a temporary as large as they are."""
    return len(a) == len(b) and all(
        np.array_equal(a[at : at + _BLOCK], b[at : at + _BLOCK]) for at in range(0, len(a), _BLOCK)
    )


def _runs(groups: Sequence[Statements]) -> list[tuple[int, int, int]] | None:
    """Group, first statement and end of each run without one of another group between, in order.

    None for more runs than ``_MOST_RUNS``.
    """
    runs = list(_merged([one.at for one in groups], _MOST_RUNS + 1))
    return runs if len(runs) <= _MOST_RUNS else None


def _merged(at: Sequence[Longs], most: int) -> Iterator[tuple[int, int, int]]:
    """The first ``most`` runs of ascending lists merged: list, first item, end."""
    next_ones = [0] * len(at)
    for _ in range(most):
        left = [k for k, one in enumerate(at) if next_ones[k] < len(one)]
        if not left:
            return
        first = min(left, key=lambda k: at[k][next_ones[k]])
        start = next_ones[first]
        others = [at[k][next_ones[k]] for k in left if k != first]
        stop = int(np.searchsorted(at[first], min(others))) if others else len(at[first])
        next_ones[first] = stop
        yield first, start, stop
