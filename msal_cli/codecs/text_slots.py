"""Numbers in a text of which three are one behind the other, as nearly all text meshes have them.

No place per number is kept, and one walk over the file replaces or compares them.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.decimals import SHORTEST_SINGLE, row_decimals
from msal_cli.codecs.slots import TextSlots
from msal_cli.errors import InternalError

MOST_TURNS = 4096
"""Changes between positions and normals, on the way through a file, from which on all of its new
numbers have the same decimals."""

_ROWS = 1 << 16
"""Statements of one kind that are replaced or compared at a time."""

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
        from msal_cli.kernels.statements import find_tokens

        starts = np.empty(3 * len(self.at), dtype=np.int64)
        stops = np.empty_like(starts)
        find_tokens(self.data, self.at + self.skipped, starts, stops)
        return starts, stops

    @property
    def starts(self) -> Longs:  # type: ignore[override]
        return self._spans[0]

    @property
    def stops(self) -> Longs:  # type: ignore[override]
        return self._spans[1]

    def row_decimals(self, values: Floats) -> Bytes | None:
        """Decimals (n,) for new ``values`` (n, 3), those of their own lines among them; None where
        all have the same."""
        if self.unit_length:
            return row_decimals(np.zeros_like(self.used), self.decimals, 1.0)
        largest = max(float(values.max()), -float(values.min()))
        return row_decimals(self.used, self.decimals, largest)


class Patch(NamedTuple):
    """Statements, their new ``values`` (n, 3), and the ``decimals`` (n,) of each one's.

    ``is_changed`` (n, 3) are the numbers to write, None for those that differ.
    """

    slots: Statements
    values: Floats
    decimals: Bytes
    is_changed: Flags | None = None


class _Block(NamedTuple):
    """Statements one behind the other: see ``kernels.statements.replace``."""

    begins: Longs
    old: Floats
    new: Floats
    decimals: Bytes


def replace_statements(data: Bytes, patches: Sequence[Patch]) -> memoryview:
    """The file with its statements' changed numbers replaced."""
    from msal_cli.kernels.statements import replace
    from msal_cli.kernels.text import format_shortest

    out = np.empty(len(data) + sum(map(_room, patches)) + 8, dtype=np.uint8)
    done = to = 0
    for block in _blocks(patches):
        row = axis = 0
        while True:
            done, to, row, axis = replace(data, done, out, to, row, axis, *block)
            if row == len(block.begins):
                break
            is_single = block.decimals[row] == SHORTEST_SINGLE
            text = format_shortest(float(block.new[row, axis]), is_single).encode()
            out[to : to + len(text)] = np.frombuffer(text, dtype=np.uint8)
            to, axis = to + len(text), axis + 1
    size = to + len(data) - done
    out[to:size] = data[done:]
    return out[:size].data


def _room(patch: Patch) -> int:
    """Most bytes that new numbers take."""
    from msal_cli.kernels.text import fixed_width

    if not len(patch.values):
        return 0
    largest = max(float(patch.values.max()), -float(patch.values.min()))
    return 3 * len(patch.values) * fixed_width(largest, int(patch.decimals.max()))


def require_replaced(data: Bytes, result: Bytes, patches: Sequence[Patch]) -> None:
    """Raise InternalError unless ``result`` is the file with just that replaced."""
    from msal_cli.kernels import statements

    tolerances = np.append(0.5 * 10.0 ** -np.arange(18.0) * (1.0 + 1e-9), [0.0, 0.0])
    done = result_done = row = axis = 0
    for block in _blocks(patches):
        row = axis = 0
        status = statements.ASIDE
        while status == statements.ASIDE:
            status, done, result_done, row, axis = statements.compare(
                data, done, result, result_done, row, axis, *block, tolerances
            )
            if status == statements.ASIDE:
                token = result[result_done : result_done + 64].tobytes().split()[0]
                expected = float(block.new[row, axis])
                slack = tolerances[block.decimals[row]] + 4.5e-16 * abs(expected)
                if not abs(float(token) - expected) <= slack:
                    status = statements.WRONG_VALUE
                result_done, axis = result_done + len(token), axis + 1
        where = f"near byte {done}"
        if status == statements.WRONG_VALUE:
            raise InternalError("the output holds another number than it should", where=where)
        if status == statements.DIFFERENT:
            raise InternalError(
                "the output differs from the input in more than positions and normals", where=where
            )
    if not is_same(data[done:], result[result_done:]):
        raise InternalError("the output differs from the input in more than positions and normals")


def is_same(a: Bytes, b: Bytes) -> bool:
    """Whether two byte strings are equal, without a temporary as large as they are."""
    return len(a) == len(b) and all(
        np.array_equal(a[at : at + _BLOCK], b[at : at + _BLOCK]) for at in range(0, len(a), _BLOCK)
    )


def is_interleaved(patches: Sequence[Patch]) -> bool:
    """Whether statements of different patches take turns more than ``MOST_TURNS`` times."""
    if len(patches) == 1:
        return False
    n_turns, last = 0, -1
    for spans in _rows_in_order(patches):
        order = np.argsort(np.concatenate([one.slots.at[rows] for _, one, rows in spans]))
        sizes = [rows.stop - rows.start for _, _, rows in spans]
        owners = np.repeat([which for which, _, _ in spans], sizes)[order]
        n_turns += int(np.count_nonzero(np.diff(owners, prepend=last)))
        last = owners[-1]
    return n_turns > MOST_TURNS


def _rows_in_order(patches: Sequence[Patch]) -> Iterator[list[tuple[int, Patch, slice]]]:
    """The statements in the order of the file, as rows of each patch, a block at a time."""
    at = [patch.slots.at for patch in patches]
    firsts = np.unique(np.concatenate([one[::_ROWS] for one in at]))
    cuts = [np.append(np.searchsorted(one, firsts), len(one)).tolist() for one in at]
    for k in range(len(firsts)):
        rows = [slice(cut[k], cut[k + 1]) for cut in cuts]
        yield [(i, patches[i], one) for i, one in enumerate(rows) if one.start < one.stop]


def _blocks(patches: Sequence[Patch]) -> Iterator[_Block]:
    """The statements in the order of the file, a block at a time."""
    for spans in _rows_in_order(patches):
        blocks = []
        for _, (slots, values, decimals, is_changed), rows in spans:
            old = slots.values[rows]
            if is_changed is not None:
                old = np.where(is_changed[rows], np.nan, values[rows])
            blocks.append(_Block(slots.at[rows] + slots.skipped, old, values[rows], decimals[rows]))
        block = blocks[0]
        if len(blocks) > 1:
            order = np.argsort(np.concatenate([one.begins for one in blocks]), kind="stable")
            block = _Block(*(np.concatenate(parts)[order] for parts in zip(*blocks, strict=True)))
        yield block
