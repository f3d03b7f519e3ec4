"""Ascii PLY elements whose records do not stand one to a line, read as a stream of words.

Some programs write several records on a line, or break a record over several, and most readers do
not look at line ends.  Without them a missing word shows only at the end: a stream is read if its
elements take all words and leave none, each element beginning on a line of its own where there are
several lines.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Longs
from msal_cli.codecs.ply_ascii import Lines, Places, can_hold, kept_names
from msal_cli.codecs.ply_header import Element, Header

_IS_SPACE = np.zeros(256, dtype=bool)
_IS_SPACE[[9, 10, 11, 12, 13, 32]] = True

_LONGEST_COUNT = 10
"""Digits of a list's count: more are more than a file holds."""


_Record = tuple[list[int], list[int], int]
"""First words and lengths of a record's properties, and the word behind it."""


class _Words(NamedTuple):
    """Where all words of the file's body begin and end."""

    starts: Longs
    stops: Longs


@dataclass(frozen=True)
class Stream(Lines):
    """Ascii records, on whatever lines.

    ``words`` are those of all elements, and ``first_words`` says which of them is the first of a
    property (of a list: its count), (count,), for the properties ``kept``.
    """

    words: _Words
    first_words: dict[str, Longs]

    def items(self, name: str) -> tuple[NDArray[np.integer[Any]], NDArray[np.integer[Any]]]:
        """All items of a list of whole numbers, and each record's number (count,)."""
        from msal_cli.kernels.text import numbers_at

        starts, stops, lengths = self.item_spans(name)
        values, bad = numbers_at(self.data, starts, stops)
        if bad < 0:
            # Beyond this a double does not tell whole numbers apart.
            is_whole = (np.rint(values) == values) & (np.abs(values) < 2.0**53)
            bad = -1 if is_whole.all() else int(np.argmin(is_whole))
        if bad >= 0:
            raise self.not_a_number(int(starts[bad]), "a whole number")
        return values.astype(np.int64), lengths

    def item_spans(self, name: str) -> tuple[Longs, Longs, Longs]:
        """First bytes and ends of all items of a list, and each record's number (count,)."""
        lengths = np.ascontiguousarray(self.tokens.lengths[:, self.tokens.columns[name]])
        items = np.repeat(self.first_words[name] + 1 - (np.cumsum(lengths) - lengths), lengths)
        items += np.arange(len(items))
        return self.words.starts[items], self.words.stops[items], lengths


def read_stream(
    data: Bytes, header: Header, wanted: Callable[[Element], Sequence[str]]
) -> tuple[dict[str, Stream], int] | None:
    """The sections of all elements of an ascii file by name, and the byte behind the last one;
    None if its words are not those that the header declares.

    ``wanted`` gives the properties of an element whose places are to be kept.
    """
    filled = [one for one in header.elements if one.count and one.properties]
    if not filled or not all(can_hold(data, one, header.size) for one in filled):
        return None
    words = _find_words(data, header.size)
    if words is None:
        return None
    is_on_one_line = not _has_line_end(data, int(words.starts[0]), int(words.stops[-1]))
    sections: dict[str, Stream] = {}
    first, stop = 0, header.size
    for element in header.elements:
        found = _find_records(data, words, element, first)
        if found is None:
            return None
        places, lengths, after = found
        start = stop
        if after > first:
            is_apart = first == 0 or _has_line_end(data, start, int(words.starts[first]))
            if not is_apart and not is_on_one_line:
                return None
            stop = int(words.stops[after - 1])
        first = after
        sections[element.name] = _section(
            data, header, element, (start, stop), words, places, lengths, wanted(element)
        )
    return (sections, stop) if first == len(words.starts) else None


def _section(
    data: Bytes,
    header: Header,
    element: Element,
    span: tuple[int, int],
    words: _Words,
    places: Longs,
    lengths: Longs,
    wanted: Sequence[str],
) -> Stream:
    """The section of an element from what ``_find_records`` returns."""
    kept = kept_names(element, wanted)
    pick = [element.index(name) for name in kept]
    chosen = np.ascontiguousarray(places[:, pick])
    columns = {name: k for k, name in enumerate(kept)}
    section = Stream(
        data,
        header,
        element,
        *span,
        kept,
        None,
        words,
        {name: chosen[:, k] for name, k in columns.items()},
    )
    section.__dict__["tokens"] = Places(
        columns, words.starts[chosen], words.stops[chosen], lengths[:, pick]
    )
    return section


def _find_words(data: Bytes, at: int) -> _Words | None:
    """All words from byte ``at`` on; None if there are none, or if the bytes are not text."""
    body = data[at:]
    if not len(body) or not body.all():
        return None
    is_space = _IS_SPACE[body]
    changes = np.flatnonzero(is_space[1:] != is_space[:-1]) + (at + 1)
    starts = changes[::2] if is_space[0] else np.concatenate([[at], changes[1::2]])
    stops = changes[1::2] if is_space[0] else changes[::2]
    if len(stops) < len(starts):
        stops = np.concatenate([stops, [len(data)]])
    return _Words(starts, stops) if len(starts) else None


def _has_line_end(data: Bytes, start: int, stop: int) -> bool:
    between = data[start:stop]
    return bool(((between == 10) | (between == 13)).any())


def _find_records(
    data: Bytes, words: _Words, element: Element, first: int
) -> tuple[Longs, Longs, int] | None:
    """The records of an element whose first word is number ``first``.

    Returns the number of each property's first word (count, P), its items (count, P), 1 for a
    scalar, and the number of the word behind the last record; None if words are missing, or if the
    count of a list is no whole number.
    """
    listed = element.properties
    count = element.count if listed else 0
    if not count or not any(one.is_list for one in listed):
        after = first + count * len(listed)
        if after > len(words.starts):
            return None
        places = np.arange(first, after, dtype=np.int64).reshape(count, len(listed))
        return places, np.ones_like(places), after
    is_list = [one.is_list for one in listed]
    record = _find_record(data, words, is_list, first)
    if record is None:
        return None
    alike = _repeat(data, words, is_list, record, count)
    if alike is not None:
        return alike
    places = np.empty((count, len(listed)), dtype=np.int64)
    lengths = np.empty((count, len(listed)), dtype=np.int64)
    at = first
    for k in range(count):
        record = _find_record(data, words, is_list, at)
        if record is None:
            return None
        places[k], lengths[k], at = record
    return places, lengths, at


def _find_record(data: Bytes, words: _Words, is_list: Sequence[bool], at: int) -> _Record | None:
    """The record whose first word is number ``at``, as ``_find_records`` returns several."""
    places, lengths = [], []
    for one in is_list:
        length = _read_count(data, words, at) if one else 1
        if length < 0:
            return None
        places.append(at)
        lengths.append(length)
        at += 1 + length * one
    return (places, lengths, at) if at <= len(words.starts) else None


def _repeat(
    data: Bytes, words: _Words, is_list: Sequence[bool], record: _Record, count: int
) -> tuple[Longs, Longs, int] | None:
    """The records of an element where the lists of all have the counts of the first one, as the
    triangles of most files have; None where they do not."""
    places, lengths, after = record
    stride = after - places[0]
    if places[0] + count * stride > len(words.starts):
        return None
    later = np.arange(count, dtype=np.int64) * stride
    for place, one in zip(places, is_list, strict=True):
        if one and not _are_alike(data, words, place + later):
            return None
    found = np.array(places, dtype=np.int64) + later[:, None]
    return found, np.broadcast_to(np.array(lengths), found.shape), after + (count - 1) * stride


def _are_alike(data: Bytes, words: _Words, which: Longs) -> bool:
    """Whether these words have the same bytes."""
    starts = words.starts[which]
    sizes = words.stops[which] - starts
    return bool((sizes == sizes[0]).all()) and all(
        bool((data[starts + k] == data[starts[0] + k]).all()) for k in range(int(sizes[0]))
    )


def _read_count(data: Bytes, words: _Words, at: int) -> int:
    """The count of a list at word ``at``; -1 if there is none."""
    if at >= len(words.starts):
        return -1
    word = data[words.starts[at] : words.stops[at]].tobytes()
    return int(word) if word.isdigit() and len(word) <= _LONGEST_COUNT else -1
