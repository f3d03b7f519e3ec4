"""Numbers in a text of which three are one behind the other, as nearly all text meshes have them.

No place per number is kept, and one walk over the file replaces or compares them.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from msal_cli.arrays import Bytes, Floats, Longs
from msal_cli.codecs.decimals import row_decimals
from msal_cli.codecs.slots import TextSlots
from msal_cli.errors import InternalError

_MOST_RUNS = 4096
"""Changes between positions and normals, on the way through a file, that are dealt with one by
one; a file with more of them takes another way."""

_BLOCK = 1 << 18
"""Bytes compared at a time; what they differ in fits the cache."""


@dataclass(eq=False)
class Statements(TextSlots):
    """Three numbers each, with blanks between them.

    Attributes
    ----------
    at : (n,) int64, ascending, first byte of each; ``skipped`` bytes of it are a keyword.
    used : (n,) uint8, the most decimals of each one's numbers.
    """

    at: Longs = field(repr=False)
    used: Bytes = field(repr=False)
    skipped: int = 0

    def used_decimals(self) -> Bytes:
        return self.used

    @functools.cached_property
    def _spans(self) -> tuple[Longs, Longs]:
        from msal_cli.kernels.fast_patch import find_tokens

        starts = np.empty(3 * len(self.at), dtype=np.int64)
        stops = np.empty_like(starts)
        find_tokens(self.data, self.at, self.skipped, starts, stops)
        return starts, stops

    @property
    def starts(self) -> Longs:  # type: ignore[override]
        return self._spans[0]

    @property
    def stops(self) -> Longs:  # type: ignore[override]
        return self._spans[1]

    def row_decimals(self, values: Floats) -> Bytes | None:
        """Decimals (n,) for new ``values`` (n, 3); None where they take another way."""
        if self._is_whole.any():
            return None
        if self.unit_length:
            return row_decimals(np.zeros_like(self.used), self.decimals, 1.0)
        largest = max(float(values.max()), -float(values.min()))
        return row_decimals(self.used, self.decimals, largest)


class Patch(NamedTuple):
    """Statements, their new ``values`` (n, 3), and the ``decimals`` (n,) of each one's."""

    slots: Statements
    values: Floats
    decimals: Bytes


def replace_statements(data: Bytes, patches: Sequence[Patch]) -> memoryview | None:
    """The file with its statements' changed numbers replaced; None where it takes another way."""
    from msal_cli.kernels import fast_patch

    runs = _runs(patches)
    if runs is None:
        return None
    out = np.empty(len(data) + sum(map(_room, patches)) + 8, dtype=np.uint8)
    done = to = 0
    for which, start, stop in runs:
        slots, values, decimals = patches[which]
        done, to = fast_patch.patched(
            data,
            done,
            start,
            stop,
            slots.at,
            slots.skipped,
            slots.values,
            values,
            decimals,
            out,
            to,
        )
    size = to + len(data) - done
    out[to:size] = data[done:]
    return out[:size].data


def _room(patch: Patch) -> int:
    """Most bytes that new numbers take: sign, point, decimals, and digits before the point."""
    if not len(patch.values):
        return 0
    largest = max(float(patch.values.max()), -float(patch.values.min()))
    return 3 * len(patch.values) * (len(str(int(largest))) + int(patch.decimals.max()) + 2)


def is_replaced(data: Bytes, result: Bytes, patches: Sequence[Patch]) -> bool:
    """Whether ``result`` is the file with just that replaced.

    False where this is not the way to compare them; raises InternalError where it is not.
    """
    from msal_cli.kernels import fast_patch

    runs = _runs(patches)
    if runs is None:
        return False
    tolerances = 0.5 * 10.0 ** -np.arange(256.0) * (1.0 + 1e-9)
    done = result_done = row = which = 0
    for which, start, stop in runs:
        slots, values, decimals = patches[which]
        status, row, done, result_done = fast_patch.compared(
            data,
            result,
            done,
            result_done,
            start,
            stop,
            slots.at,
            slots.skipped,
            slots.values,
            values,
            decimals,
            tolerances,
        )
        where = f"{'normal' if slots.unit_length else 'vertex'} {row + 1}"
        if status == fast_patch.ODD:
            return False
        if status == fast_patch.WRONG_VALUE:
            raise InternalError("the output holds another number than it should", where=where)
        if status == fast_patch.DIFFERENT:
            raise InternalError(
                "the output differs from the input in more than positions and normals",
                where=f"near {where}",
            )
    if not is_same(data[done:], result[result_done:]):
        raise InternalError("the output differs from the input in more than positions and normals")
    return True


def is_same(a: Bytes, b: Bytes) -> bool:
    """Whether two byte strings are equal, without a temporary as large as they are."""
    return len(a) == len(b) and all(
        np.array_equal(a[at : at + _BLOCK], b[at : at + _BLOCK]) for at in range(0, len(a), _BLOCK)
    )


def _runs(patches: Sequence[Patch]) -> list[tuple[int, int, int]] | None:
    """Patch, first statement and end of each run without one of another patch between, in order.

    None for more runs than ``_MOST_RUNS``.
    """
    runs = list(_merge([one.slots.at for one in patches], _MOST_RUNS + 1))
    return runs if len(runs) <= _MOST_RUNS else None


def _merge(at: Sequence[Longs], most: int) -> Iterator[tuple[int, int, int]]:
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
