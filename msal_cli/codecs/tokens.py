"""The words of a text file of numbers: where each begins and ends, and on which line it stands."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Bytes, Longs
from msal_cli.codecs.text_slots import TextSlots, line_of, parse_floats
from msal_cli.errors import CUT_SHORT, EXPORT_AGAIN, ContentError, TruncatedError, damaged
from msal_cli.storage.regular import Buffer


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
        from msal_cli.kernels.text import as_bytes, find_words

        self.data = as_bytes(data)
        stop = len(self.data) if stop is None else stop
        sign = comment[0] if comment else -1
        count = find_words(self.data, start, stop, sign, _NONE, _NONE, _NONE)
        self.starts, self.stops, self.lines = (np.empty(count, dtype=np.int64) for _ in range(3))
        find_words(self.data, start, stop, sign, self.starts, self.stops, self.lines)

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

    def float_rows(self, first: Longs, *, unit_length: bool = False) -> TextSlots:
        """Rows of three numbers, ``first`` (n,) being the first word of each."""
        chosen = (first[:, None] + np.arange(3)).reshape(-1)
        values = parse_floats(self.data, self.starts[chosen], self.stops[chosen]).reshape(-1, 3)
        at = self.starts[first]
        return TextSlots(self.data, at, values=values, unit_length=unit_length)

    def first_of_lines(self) -> Longs:
        """The first word of each line that has one."""
        first = np.ones(len(self), dtype=bool)
        first[1:] = self.lines[1:] != self.lines[:-1]
        return np.flatnonzero(first)


_NONE = np.zeros(0, dtype=np.int64)


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
