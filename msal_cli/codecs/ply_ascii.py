"""Ascii elements of a PLY file: where the words of their records stand, one record to a line.

What stands otherwise is left to ``ply_stream``.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Longs
from msal_cli.codecs import ply_fast as ply_plain
from msal_cli.codecs.ply_fast import Numbers
from msal_cli.codecs.ply_header import NORMAL, Element, Header
from msal_cli.codecs.slots import TextSlots, Tokens, number_hint
from msal_cli.codecs.text_slots import Statements
from msal_cli.errors import FormatError, TruncatedError

_SAMPLE = 4_096
"""Bytes behind an ascii header that are searched for signs of binary data when a line is wrong."""

_ALL_DIGITS = 1_000
"""Significant digits of which a file has never too many for fixed-point text."""

CUT_HINT = "the file was cut short or its header counts are wrong; copy or export it again"


class Places(NamedTuple):
    """Words of ascii records: ``starts`` and ``stops`` (count, c) are those of the properties in
    ``columns`` (of a list: of its count), ``lengths`` (count, c) their items."""

    columns: dict[str, int]
    starts: Longs
    stops: Longs
    lengths: Longs


@dataclass(frozen=True)
class Lines:
    """Ascii records, one to a line.

    ``kept`` are the properties whose values or words are known.  ``read`` are their values, where
    the records are plain; then the places of words are found only when they are asked for.
    """

    data: Bytes
    header: Header
    element: Element
    start: int
    stop: int
    kept: tuple[str, ...]
    read: Numbers | None

    @functools.cached_property
    def tokens(self) -> Places:
        """The places of all words of the properties ``kept``."""
        return _tokens(self.data, self.header, self.element, self.start, self.kept)[0]

    def where(self, record: int) -> str:
        """The record in words, with its line."""
        line = line_at(self.data, int(self.tokens.starts[record, 0]), self.header.newline)
        return f"{self.element.name} {record}, line {line}"

    def spans(self, names: Sequence[str]) -> tuple[Longs, Longs]:
        """First bytes and ends (count * len(names),) of the tokens, record by record.

        They ascend when ``names`` are in file order.
        """
        columns, starts, stops, _ = self.tokens
        pick = [columns[name] for name in names]
        if pick == list(range(starts.shape[1])):
            return starts.reshape(-1), stops.reshape(-1)
        return starts[:, pick].reshape(-1), stops[:, pick].reshape(-1)

    def not_a_number(self, start: int, wanted: str) -> FormatError:
        """The error that the token at byte ``start`` is not what was ``wanted``."""
        token = self.data[start : start + 40].tobytes().split(maxsplit=1)[0]
        return FormatError(
            f"{token.decode('latin-1')!r} in element '{self.element.name}' is not {wanted}",
            where=f"line {line_at(self.data, start, self.header.newline)}",
            hint=number_hint(token),
        )

    def slots(self, names: Sequence[str]) -> TextSlots:
        """Where the scalars of ``names`` are.

        Raises FormatError with the line of one that is no number.
        """
        slots: TextSlots
        read = self.read
        if read is not None and names in read.word_at:
            values = np.require(self._read_values(names), None, ("C", "W"))
            slots = Statements(self.data, read.word_at[names], read.decimals[names], values=values)
        else:
            starts, stops = self.spans(names)
            values = self._values(names, starts, stops)
            slots = Tokens(self.data, starts, stops, len(names), values=values)
        slots.codes = tuple(one.code for one in self.element.find_all(names))
        slots.unit_length = slots.whole_rows = names == NORMAL
        slots.significant = _ALL_DIGITS
        return slots

    def _read_values(self, names: Sequence[str]) -> Floats:
        assert self.read is not None
        pick = [self.read.names.index(name) for name in names]
        if pick == list(range(len(self.read.names))):
            return self.read.values
        return self.read.values[:, pick]

    def _values(self, names: Sequence[str], starts: Longs, stops: Longs) -> Floats:
        """The scalars of ``names``, whose tokens are there, as (count, len(names))."""
        from msal_cli.kernels.text import numbers_at

        if self.read is not None and set(names) <= set(self.read.names):
            return self._read_values(names)
        values, bad = numbers_at(self.data, starts, stops)
        if bad >= 0:
            raise self.not_a_number(int(starts[bad]), "a number")
        return values.reshape(self.element.count, len(names))

    def items(self, name: str) -> tuple[NDArray[np.integer[Any]], NDArray[np.integer[Any]]]:
        """All items of a list of whole numbers, and each record's number (count,)."""
        from msal_cli.kernels.ply_scan import list_integers

        if self.read is not None and name == self.read.list_name:
            return self.read.items, self.read.lengths
        k = self.tokens.columns[name]
        lengths = np.ascontiguousarray(self.tokens.lengths[:, k])
        stops = np.ascontiguousarray(self.tokens.stops[:, k])
        items = np.empty(int(lengths.sum()), dtype=np.int64)
        bad = list_integers(self.data, stops, lengths, items)
        if bad >= 0:
            raise self.not_a_number(int(bad), "a whole number")
        return items, lengths

    def item_spans(self, name: str) -> tuple[Longs, Longs, Longs]:
        """First bytes and ends of all items of a list, and each record's number (count,)."""
        from msal_cli.kernels.ply_scan import list_tokens

        k = self.tokens.columns[name]
        lengths = np.ascontiguousarray(self.tokens.lengths[:, k])
        starts = np.empty(int(lengths.sum()), dtype=np.int64)
        stops = np.empty_like(starts)
        counts = np.ascontiguousarray(self.tokens.stops[:, k])
        list_tokens(self.data, counts, lengths, starts, stops)
        return starts, stops, lengths


def line_at(data: Bytes, at: int, newline: bytes) -> int:
    """Number, from 1, of the line on which byte ``at`` stands."""
    return 1 + int(np.count_nonzero(data[:at] == newline[-1]))


def plain_lines(
    data: Bytes, header: Header, element: Element, at: int, wanted: Sequence[str]
) -> Lines | None:
    """The section of an element whose records are plain; None for others."""
    if not can_hold(data, element, at):
        return None
    found = ply_plain.numbers(data, element, at, wanted)
    if found is None:
        return None
    return Lines(data, header, element, at, found[1], kept_names(element, wanted), found[0])


def find_lines(
    data: Bytes, header: Header, element: Element, at: int, wanted: Sequence[str]
) -> Lines:
    """The section of an element that begins at byte ``at``, its words found one by one.

    Raises TruncatedError and FormatError with the record and its line.
    """
    kept = kept_names(element, wanted)
    tokens, stop = _tokens(data, header, element, at, kept)
    lines = Lines(data, header, element, at, stop, kept, None)
    lines.__dict__["tokens"] = tokens
    return lines


def kept_names(element: Element, wanted: Sequence[str]) -> tuple[str, ...]:
    """The ``wanted`` properties that the element has, in file order."""
    return tuple(one.name for one in element.properties if one.name in wanted)


def can_hold(data: Bytes, element: Element, at: int) -> bool:
    """Whether the bytes from ``at`` on can hold the element."""
    # A value is at least one digit and one separator; only the file's last one has none.
    return 2 * len(element.properties) * element.count <= len(data) - at + 1


def _tokens(
    data: Bytes, header: Header, element: Element, at: int, kept: Sequence[str]
) -> tuple[Places, int]:
    """The places of the words of the properties ``kept``, and the end of the element."""
    names = kept if can_hold(data, element, at) else ()
    shape = (element.count if names else 0, len(names))
    tokens = Places(
        {name: k for k, name in enumerate(names)},
        np.empty(shape, dtype=np.int64),
        np.empty(shape, dtype=np.int64),
        np.empty(shape, dtype=np.int64),
    )
    stop = at
    if element.properties and element.count:
        stop = _walked(data, header, element, at, tokens)
    return tokens, stop


def _walked(
    data: Bytes,
    header: Header,
    element: Element,
    at: int,
    tokens: Places,
) -> int:
    """Fill ``tokens`` and return the end of the element's last line."""
    from msal_cli.kernels.ply_scan import BAD_COUNT, CUT, TOO_FEW, TOO_MANY, WHOLE, walk_text

    listed = element.properties
    records, stop, status = walk_text(
        data,
        at,
        min(element.count, len(data) + 1),
        np.array([one.is_list for one in listed]),
        np.array([tokens.columns.get(one.name, -1) for one in listed]),
        *tokens[1:],
    )
    if status != WHOLE and (data[header.size : header.size + _SAMPLE] == 0).any():
        raise FormatError(
            "the header says ascii, but binary data follow",
            where=f"line {header.format_line + 1}",
            hint="correct the format line, or export the file again",
        )
    place = f"{element.name} {records}, line {line_at(data, stop, header.newline)}"
    if status == CUT or (status == TOO_FEW and stop == len(data)):
        missing = element.count - records
        raise TruncatedError(
            f"the file ends within element '{element.name}': {missing} of {element.count} lines "
            "are missing or not whole",
            where=place,
            hint=CUT_HINT,
        )
    if status == BAD_COUNT:
        raise FormatError(
            f"the count of a list of {element.name} {records} is not a whole number from 0 up",
            where=place,
        )
    if status == TOO_FEW:
        raise FormatError(
            f"{element.name} {records} has fewer values than the header declares",
            where=place,
            hint="each record of an ascii PLY file stands on one line of its own",
        )
    if status == TOO_MANY:
        raise FormatError(
            f"{element.name} {records} has more values than the header declares",
            where=place,
            hint="each record of an ascii PLY file stands on one line of its own",
        )
    return int(stop)
