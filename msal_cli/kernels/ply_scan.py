"""Passes over PLY data whose records differ in length, and the triangles of polygons.

Ascii records are read by two fast passes, ``read_scalars`` and ``read_lists``; ``walk_text`` finds
the positions of all tokens, and errors.

The bytes are untrusted: each kernel here compares with the end of the data *before* it reads, since
compiled code does not check bounds.  Offsets are bytes from the start of the file.
"""

import numpy as np

from msal_cli.kernels.library import compiled
from msal_cli.kernels.numbers import EXACT, read_number, read_plain
from msal_cli.kernels.text import (
    append_bytes,
    is_line_end,
    is_token_end,
    parse_integer,
    read_short_integer,
    skip_blanks,
    skip_token,
)

(
    WHOLE,  # all records are there
    CUT,  # the data end within, or before, a record
    BAD_COUNT,  # a list's count is negative or, in ascii, not an integer
    TOO_FEW,  # an ascii line ends before all values of its record
    TOO_MANY,  # an ascii line continues after the last value of its record
    ODD,  # the next ascii record is not one for a fast pass; ``walk_text`` says what is wrong
    FULL,  # there is no room for the items of the next record
) = range(7)


@compiled
def _whole_number(data, at, size, is_signed, big_endian):
    value = np.int64(0)
    for k in range(size):
        value = (value << 8) | np.int64(data[at + k if big_endian else at + size - 1 - k])
    # Eight bytes fill the word: their sign is already right.
    if is_signed and size < 8 and value >> (8 * size - 1):
        value -= np.int64(1) << (8 * size)
    return value


@compiled
def walk_binary(data, at, count, sizes, count_sizes, signed, big_endian, columns, starts, lengths):
    """Find the fields of ``count`` binary records that begin at byte ``at``.

    sizes (P,) : bytes of one value of each property.
    count_sizes (P,) : bytes of each list's count, 0 for a scalar; ``signed`` (P,) bool.
    columns (P,) : column of the outputs for a property, or -1.
    starts (count, C) : receives the offset of the value (of a list: of the first item).
    lengths (count, C) : receives the number of items; 1 for a scalar.

    Returns (records read, byte reached, status, property, items and item size in bytes that are
    needed there).
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
def next_record(data, at):
    """The first token of the next line that has one."""
    at = skip_blanks(data, at)
    while at < len(data) and is_line_end(data, at):
        at = skip_blanks(data, at + 1)
    return at


@compiled
def walk_text(data, at, count, is_list, columns, starts, stops, lengths):
    """Find the fields of ``count`` ascii records, one to a line; blank lines are skipped.

    Parameters as in ``walk_binary``; a list's ``starts`` and ``stops`` are those of its count.
    Returns (records read, end, status); the end is that of the last token, or the position of an
    error.
    """
    end = len(data)
    n_properties = len(is_list)
    for record in range(count):
        at = next_record(data, at)
        if at == end:
            return record, at, CUT
        for p in range(n_properties):
            start = at = skip_blanks(data, at)
            at = skip_token(data, at)
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
                    item = skip_blanks(data, at)
                    at = skip_token(data, item)
                    if at == item:
                        return record, at, TOO_FEW
            if columns[p] >= 0:
                lengths[record, columns[p]] = length
        rest = skip_blanks(data, at)
        if not is_line_end(data, rest):
            return record, rest, TOO_MANY
    return count, at, WHOLE


@compiled
def read_scalars(data, at, start, stop, columns, groups, values, first_at, decimals):
    """Read the ascii records ``start`` to ``stop`` of scalars from byte ``at`` on, one to a line.

    Parameters
    ----------
    columns (P,) : for each property its column of ``values``, or -1 to skip it.
    groups (P,) : the group that a property belongs to, or -1.
    values (count, C) : receives the numbers.
    first_at, decimals (G, count) : receive, for each group, where its first token is and the
        most decimals of its numbers.

    Returns the records with a number that is not plain, the end of the last one, and WHOLE; or ODD
    for a wrong record or a number that must be read in another way.
    """
    n_unusual = 0
    for record in range(start, stop):
        at = next_record(data, at)
        last_group = -1
        is_unusual = False
        for p in range(len(columns)):
            begin = at = skip_blanks(data, at)
            if columns[p] < 0:
                at = skip_token(data, begin)
                last_group = -1
            else:
                value, at, used = read_plain(data, begin)
                if at < 0 or not is_token_end(data, at):
                    is_unusual = True
                    value, status, at, used = read_number(data, begin, len(data))
                    if status != EXACT or not np.isfinite(value) or not is_token_end(data, at):
                        return n_unusual, at, ODD
                    used = min(used, 255)
                values[record, columns[p]] = value
                group = groups[p]
                if group >= 0:
                    if group != last_group:
                        first_at[group, record] = begin
                        decimals[group, record] = used
                    elif used > decimals[group, record]:
                        decimals[group, record] = used
                last_group = group
            if at == begin:
                return n_unusual, at, ODD
        n_unusual += is_unusual
        if not is_line_end(data, skip_blanks(data, at)):
            return n_unusual, at, ODD
    return n_unusual, at, WHOLE


@compiled
def read_lists(data, at, start, stop, is_list, wanted, items, n_items, lengths):
    """Read the list that is property ``wanted`` of records ``start`` to ``stop`` from byte ``at``.

    is_list (P,) : which properties are lists; all but the wanted one are skipped.
    items (k,) int32 : receives the items, from ``n_items`` on; lengths (count,) int32 : how many
        each record has.

    Returns the records read, the number of items, the end of the last one, and WHOLE, ODD or FULL.
    """
    for record in range(start, stop):
        last = at
        first_item = n_items
        at = next_record(data, at)
        for p in range(len(is_list)):
            length = 0
            if is_list[p]:
                at = skip_blanks(data, at)
                length, digits = read_short_integer(data, at)
                if digits == 0:
                    return record, first_item, last, ODD
                at += digits
            if is_list[p] and p == wanted:
                if length > len(items) - n_items:
                    return record, first_item, last, FULL
                for k in range(n_items, n_items + length):
                    at = skip_blanks(data, at)
                    value, digits = read_short_integer(data, at)
                    if digits == 0:
                        return record, first_item, last, ODD
                    items[k] = value
                    at += digits
                n_items += length
                lengths[record] = length
            else:
                for _ in range(length if is_list[p] else 1):
                    begin = skip_blanks(data, at)
                    at = skip_token(data, begin)
                    if at == begin:
                        return record, first_item, last, ODD
        if not is_line_end(data, skip_blanks(data, at)):
            return record, first_item, last, ODD
    return stop, n_items, at, WHOLE


@compiled
def list_tokens(data, stops, lengths, item_starts, item_stops):
    """Positions of the items of lists that ``walk_text`` found: ``stops`` of their counts (n,),
    ``lengths`` (n,) -> ``item_starts``, ``item_stops`` (sum of lengths,)."""
    k = 0
    for record in range(len(stops)):
        at = stops[record]
        for _ in range(lengths[record]):
            start = skip_blanks(data, at)
            at = skip_token(data, start)
            item_starts[k] = start
            item_stops[k] = at
            k += 1


@compiled
def read_integers(data, starts, stops, values):
    """The integers (k,) of these tokens; returns the first token that is not one, or -1."""
    for k in range(len(starts)):
        values[k], status = parse_integer(data, starts[k], stops[k])
        if status != EXACT:
            return k
    return -1


@compiled
def gather(data, starts, sizes, packed):
    """Concatenate the pieces ``data[starts[i] : starts[i] + sizes[i]]`` into ``packed``."""
    k = 0
    for i in range(len(starts)):
        k = append_bytes(data, starts[i], starts[i] + sizes[i], packed, k)


@compiled
def scatter(data, starts, sizes, packed):
    """The reverse of ``gather``: copy packed pieces to their positions in ``data``."""
    k = 0
    for i in range(len(starts)):
        for at in range(starts[i], starts[i] + sizes[i]):
            data[at] = packed[k]
            k += 1


@compiled
def fans(items, lengths, triangles):
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
