"""Walks over PLY data whose records differ in length, and the triangles of polygons and strips.

The bytes come from strangers: every kernel here compares with the end of the data *before* it
reads, since compiled code does not check bounds.  Offsets are bytes from the start of the file.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.text import parse_integer

WHOLE = 0
"""All records are there."""
CUT = 1
"""The data end within, or before, a record."""
BAD_COUNT = 2
"""A list's count is negative or, in ascii, not an integer."""
TOO_FEW = 3
"""An ascii line ends before all values of its record."""
TOO_MANY = 4
"""An ascii line goes on after the last value of its record."""


@compiled
def _whole_number(data, at, size, is_signed, big_endian):  # type: ignore[no-untyped-def]
    value = np.int64(0)
    for k in range(size):
        value = (value << 8) | np.int64(data[at + k if big_endian else at + size - 1 - k])
    # Eight bytes fill the word: their sign is right already.
    if is_signed and size < 8 and value >> (8 * size - 1):
        value -= np.int64(1) << (8 * size)
    return value


@compiled
def walk_binary(  # type: ignore[no-untyped-def]
    data, at, count, sizes, count_sizes, signed, big_endian, columns, starts, lengths
):
    """Find the fields of ``count`` binary records that begin at byte ``at``.

    sizes (P,) : bytes of one value of each property.
    count_sizes (P,) : bytes of each list's count, 0 for a scalar; ``signed`` (P,) bool.
    columns (P,) : column of the outputs for a property, or -1.
    starts (count, C) : receives where the value (of a list: the first item) stands.
    lengths (count, C) : receives the number of items; 1 for a scalar.

    Returns (records walked, place reached, status, property, items and item size in bytes that
    the place reached asks for).
    """
    end = len(data)
    for record in range(count):
        for p in range(len(sizes)):
            length = 1
            if count_sizes[p]:
                if count_sizes[p] > end - at:
                    return record, at, CUT, p, 1, count_sizes[p]
                length = _whole_number(data, at, count_sizes[p], signed[p], big_endian)
                if length < 0:
                    return record, at, BAD_COUNT, p, 0, 0
                at += count_sizes[p]
            # Divided, not multiplied: an eight-byte count times a size could overflow.
            if length > (end - at) // sizes[p]:
                return record, at, CUT, p, length, sizes[p]
            if columns[p] >= 0:
                starts[record, columns[p]] = at
                lengths[record, columns[p]] = length
            at += length * sizes[p]
    return count, at, WHOLE, 0, 0, 0


@compiled
def _skipped_blanks(data, at):  # type: ignore[no-untyped-def]
    """First byte from ``at`` on that is no blank; line ends are not blanks."""
    while at < len(data) and (data[at] == 32 or data[at] == 9 or data[at] == 11 or data[at] == 12):
        at += 1
    return at


@compiled
def _token_end(data, at):  # type: ignore[no-untyped-def]
    while at < len(data) and (data[at] > 32 or data[at] < 9 or 13 < data[at] < 32):
        at += 1
    return at


@compiled
def walk_text(data, at, count, is_list, columns, starts, stops, lengths):  # type: ignore[no-untyped-def]
    """Find the fields of ``count`` ascii records, one to a line; blank lines are skipped.

    Parameters as in ``walk_binary``; a list's ``starts`` and ``stops`` are those of its count.
    Returns (records walked, end, status); the end is that of the last token, and after a fault
    the place of it.
    """
    end = len(data)
    n_properties = len(is_list)
    for record in range(count):
        at = _skipped_blanks(data, at)
        while at < end and (data[at] == 10 or data[at] == 13):
            at = _skipped_blanks(data, at + 1)
        if at == end:
            return record, at, CUT
        for p in range(n_properties):
            at = _skipped_blanks(data, at)
            start = at
            at = _token_end(data, at)
            if at == start:
                return record, at, TOO_FEW
            length = 1
            if columns[p] >= 0:
                starts[record, columns[p]] = start
                stops[record, columns[p]] = at
            if is_list[p]:
                length, status = parse_integer(data, start, at)
                if status != 0 or length < 0:
                    return record, start, BAD_COUNT
                for _ in range(length):
                    item = _skipped_blanks(data, at)
                    at = _token_end(data, item)
                    if at == item:
                        return record, at, TOO_FEW
            if columns[p] >= 0:
                lengths[record, columns[p]] = length
        rest = _skipped_blanks(data, at)
        if rest < end and data[rest] != 10 and data[rest] != 13:
            return record, rest, TOO_MANY
    return count, at, WHOLE


@compiled
def list_tokens(data, stops, lengths, item_starts, item_stops):  # type: ignore[no-untyped-def]
    """Places of the items of lists that ``walk_text`` found: ``stops`` of their counts (n,),
    ``lengths`` (n,) -> ``item_starts``, ``item_stops`` (sum of lengths,)."""
    k = 0
    for record in range(len(stops)):
        at = stops[record]
        for _ in range(lengths[record]):
            start = _skipped_blanks(data, at)
            at = _token_end(data, start)
            item_starts[k] = start
            item_stops[k] = at
            k += 1


@compiled
def list_integers(data, stops, lengths, items):  # type: ignore[no-untyped-def]
    """The whole numbers of lists that ``walk_text`` found, into ``items`` (sum of lengths,).

    Returns the place of the first token that is not a whole number, or -1.
    """
    k = 0
    for record in range(len(stops)):
        at = stops[record]
        for _ in range(lengths[record]):
            start = _skipped_blanks(data, at)
            at = _token_end(data, start)
            items[k], status = parse_integer(data, start, at)
            if status != 0:
                return start
            k += 1
    return -1


@compiled
def gather(data, starts, sizes, packed):  # type: ignore[no-untyped-def]
    """Copy the pieces ``data[starts[i] : starts[i] + sizes[i]]`` one behind another."""
    k = 0
    for i in range(len(starts)):
        at = starts[i]
        for j in range(sizes[i]):
            packed[k + j] = data[at + j]
        k += sizes[i]


@compiled
def scatter(data, starts, sizes, packed):  # type: ignore[no-untyped-def]
    """The reverse of ``gather``: copy packed pieces to their places in ``data``."""
    k = 0
    for i in range(len(starts)):
        at = starts[i]
        for j in range(sizes[i]):
            data[at + j] = packed[k + j]
        k += sizes[i]


@compiled
def fans(items, lengths, triangles):  # type: ignore[no-untyped-def]
    """Cut polygons into triangles that share each polygon's first corner.

    items (sum of lengths,) -> triangles (t, 3); a polygon of fewer than three corners gives none.
    """
    first = t = 0
    for f in range(len(lengths)):
        for k in range(first + 2, first + lengths[f]):
            triangles[t, 0] = items[first]
            triangles[t, 1] = items[k - 1]
            triangles[t, 2] = items[k]
            t += 1
        first += lengths[f]


@compiled
def unrolled_strips(items, lengths, triangles):  # type: ignore[no-untyped-def]
    """Triangles of strips: -1 restarts a strip, every second triangle is turned round, and
    those that name a vertex twice are dropped.  Returns the number of triangles."""
    first = t = 0
    for s in range(len(lengths)):
        run = 0  # corners since the last restart
        for k in range(first, first + lengths[s]):
            if items[k] < 0:
                run = 0
                continue
            run += 1
            if run < 3:
                continue
            a, b, c = items[k - 2], items[k - 1], items[k]
            if a == b or b == c or a == c:
                continue
            triangles[t, 0] = a if run % 2 else b
            triangles[t, 1] = b if run % 2 else a
            triangles[t, 2] = c
            t += 1
        first += lengths[s]
    return t
