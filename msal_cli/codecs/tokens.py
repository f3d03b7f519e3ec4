"""The words of a text file of numbers: where each begins and ends, and on which line it stands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from msal_cli.arrays import Bytes, Flags, Longs
from msal_cli.codecs.text_slots import Tokens, line_of, parse_floats
from msal_cli.errors import CUT_SHORT, EXPORT_AGAIN, ContentError, TruncatedError, damaged
from msal_cli.storage.regular import Buffer

_BLOCK = 1 << 22
"""Bytes looked at in one step, so that the temporaries stay small."""


class Words:
    """The words of ``data[start:stop]``, comments left out.

    Attributes
    ----------
    data : (size,) uint8, the whole file.
    starts, stops : (q,) int64, offsets into the file.
    lines : (q,) int64, ascending, equal for words of one line.
    """

    def __init__(
        self,
        data: Buffer | Bytes,
        start: int = 0,
        stop: int | None = None,
        *,
        comment: bytes = b"",
    ) -> None:
        from msal_cli.kernels.text import as_bytes

        self.data = as_bytes(data)
        stop = len(self.data) if stop is None else stop
        table = np.zeros(256, dtype=bool)
        table[list(b" \t\r\n\v\f")] = True
        pieces = list(_pieces(self.data, start, stop, table, comment))
        self.starts: Longs = np.concatenate([piece[0] for piece in pieces] or [_NONE])
        self.stops: Longs = np.concatenate([piece[1] for piece in pieces] or [_NONE])
        ends: Longs = np.concatenate([piece[2] for piece in pieces] or [_NONE])
        self.lines: Longs = np.searchsorted(ends, self.starts)

    def __len__(self) -> int:
        return len(self.starts)

    def word(self, i: int) -> bytes:
        return self.data[int(self.starts[i]) : int(self.stops[i])].tobytes()

    def where(self, i: int) -> str:
        """The line of a word, or of the end for one behind the last."""
        at = int(self.starts[i]) if i < len(self) else len(self.data)
        return f"line {line_of(self.data, at)}"

    def require(self, stop: int, what: str) -> None:
        """Raise TruncatedError unless there are ``stop`` words."""
        if stop > len(self):
            raise TruncatedError(
                f"the file ends before all {what} are there",
                where=self.where(len(self)),
                hint=CUT_SHORT,
            )

    def count(self, i: int, what: str) -> int:
        """The word as a number of things, at least 0."""
        self.require(i + 1, what)
        word = self.word(i)
        if not word.isdigit() or len(word) > 18:
            shown = word[:40].decode("ascii", "backslashreplace")
            raise damaged(f"{shown!r} is not the number of {what}", self.where(i))
        return int(word)

    def integers(self, chosen: slice | Longs) -> Longs:
        """Whole numbers; FormatError for a word that is none."""
        starts = self.starts[chosen]
        values = parse_floats(self.data, starts, self.stops[chosen])
        wrong = ~(np.abs(values) < 2.0**53) | (values != np.rint(values))
        if wrong.any():
            at = int(starts[int(np.argmax(wrong))])
            raise damaged("a whole number is expected", f"line {line_of(self.data, at)}")
        return values.astype(np.int64)

    def float_rows(self, first: Longs, *, unit_length: bool = False) -> Tokens:
        """Rows of three numbers, ``first`` (n,) being the first word of each."""
        chosen = (first[:, None] + np.arange(3)).reshape(-1)
        starts, stops = self.starts[chosen], self.stops[chosen]
        return Tokens(self.data, starts, stops, unit_length=unit_length)

    def first_of_lines(self) -> Longs:
        """The first word of each line that has one."""
        first = np.ones(len(self), dtype=bool)
        first[1:] = self.lines[1:] != self.lines[:-1]
        return np.flatnonzero(first)


_NONE = np.zeros(0, dtype=np.int64)


def _pieces(
    data: Bytes, start: int, stop: int, table: Flags, comment: bytes
) -> Iterator[tuple[Longs, Longs, Longs]]:
    """Starts and stops of words and ends of lines, a block at a time.

    A block ends with a line where it can, so that a word cut in two is a very long line's alone.
    """
    while start < stop:
        end = min(stop, start + _BLOCK)
        if end < stop:
            breaks = np.flatnonzero(_is_break(data[start:end]))
            while not len(breaks) and end < stop:
                start_of_more, end = end, min(stop, end + _BLOCK)
                breaks = np.flatnonzero(_is_break(data[start_of_more:end])) + start_of_more - start
            if len(breaks) and end < stop:
                end = start + int(breaks[-1]) + 1
        part = data[start:end]
        is_blank = table[part]
        is_end = _is_break(part)
        if comment:
            is_blank |= _is_comment(part, is_end, comment)
        edges = np.diff(is_blank.view(np.int8), prepend=np.int8(1), append=np.int8(1))
        yield (
            np.flatnonzero(edges == -1) + start,
            np.flatnonzero(edges == 1) + start,
            np.flatnonzero(is_end) + start,
        )
        start = end


def _is_break(part: Bytes) -> Flags:
    is_break: Flags = (part == 10) | (part == 13)
    return is_break


def _is_comment(part: Bytes, is_end: Flags, comment: bytes) -> Flags:
    """Which bytes stand between a comment's first letter and the end of its line."""
    is_first: Flags = part == comment[0]
    if not is_first.any():
        return is_first
    place = np.arange(len(part))
    last_end = np.maximum.accumulate(np.where(is_end, place, -1))
    last_first = np.maximum.accumulate(np.where(is_first, place, -1))
    is_inside: Flags = last_first > last_end
    return is_inside


def require_indices(indices: Longs, count: int) -> None:
    """Raise ContentError (``E_INDEX``) for an index that is not from 0 to ``count`` - 1."""
    wrong = (indices < 0) | (indices >= count)
    if wrong.any():
        raise ContentError(
            f"a face names a vertex that is not among the {count}",
            code="E_INDEX",
            where=f"corner {int(np.argmax(wrong))} of all faces",
            hint=EXPORT_AGAIN,
        )
