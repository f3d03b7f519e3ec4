"""Ascii PLY records that are plainly written, found and read in one walk.

Plain is one record to a line, blanks and tabs between its words, numbers that ``plain_numbers``
reads, and lists of whole numbers from 0 up with seven digits at the most.  The walks stop at what
is not; ``ply_scan`` knows everything, keeps the places of all words, and takes longer.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.byte_words import count_digits, load_eight, parse_digits
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.digits import EXACT, read_number

WHOLE = 0
"""All records are read."""
ODD = 1
"""The next record is not plain."""
FULL = 2
"""There is no room for the items of the next record."""


@compiled
def _past_blanks(data, at):  # type: ignore[no-untyped-def]
    while at < len(data) and (data[np.uint64(at)] == 32 or data[np.uint64(at)] == 9):
        at += 1
    return at


@compiled
def _past_line_ends(data, at):  # type: ignore[no-untyped-def]
    """The first word of the next line that has one."""
    at = _past_blanks(data, at)
    while at < len(data) and (data[np.uint64(at)] == 10 or data[np.uint64(at)] == 13):
        at = _past_blanks(data, at + 1)
    return at


@compiled
def _past_word(data, at):  # type: ignore[no-untyped-def]
    """The end of the word at ``at``, or ``at`` where none is."""
    while at < len(data) and data[np.uint64(at)] > 32:
        at += 1
    return at


@compiled
def _is_end(data, at):  # type: ignore[no-untyped-def]
    """Whether a line ends here."""
    return at >= len(data) or data[np.uint64(at)] == 10 or data[np.uint64(at)] == 13


@compiled
def _is_word_end(data, at):  # type: ignore[no-untyped-def]
    return _is_end(data, at) or data[np.uint64(at)] == 32 or data[np.uint64(at)] == 9


@compiled
def read_scalars(data, at, start, count, columns, groups, values, word_at, decimals):  # type: ignore[no-untyped-def]
    """Read records of scalars from byte ``at`` on.

    Parameters
    ----------
    start, count : the first record to read, and the number of all.
    columns (P,) : for each property its column of ``values``, or -1 to pass over it.
    groups (P,) : the group that a property belongs to, or -1.
    values (count, C) : receives the numbers.
    word_at, decimals (G, count) : receive, for each group, where its first word stands and the
        most decimals of its numbers.

    Returns the records read, the end of the last one, and WHOLE or ODD.
    """
    for record in range(start, count):
        stop = at
        at = _past_line_ends(data, at)
        last_group = -1
        for p in range(len(columns)):
            at = _past_blanks(data, at)
            begin = at
            if columns[p] >= 0:
                value, status, at, used = read_number(data, begin, len(data))
                if status != EXACT:
                    return record, stop, ODD
                values[record, columns[p]] = value
                group = groups[p]
                if group >= 0:
                    if group != last_group:
                        word_at[group, record] = begin
                        decimals[group, record] = used
                    elif used > decimals[group, record]:
                        decimals[group, record] = used
                last_group = group
            else:
                at = _past_word(data, begin)
                last_group = -1
            if at == begin or not _is_word_end(data, at):
                return record, stop, ODD
        if not _is_end(data, _past_blanks(data, at)):
            return record, stop, ODD
    return count, at, WHOLE


@compiled
def read_lists(data, at, start, count, is_list, wanted, items, n_items, lengths):  # type: ignore[no-untyped-def]
    """Read the list that is property ``wanted`` of records from byte ``at`` on.

    is_list (P,) : which properties are lists; all but the wanted one are passed over.
    items (k,) int32 : receives the items, from ``n_items`` on; lengths (count,) int32 : how many
        each record has.

    Returns the records read, the end of the last one, the number of items, and WHOLE, ODD or FULL.
    """
    for record in range(start, count):
        stop = at
        first_item = n_items
        at = _past_line_ends(data, at)
        for p in range(len(is_list)):
            length = 0
            if is_list[p]:
                at = _past_blanks(data, at)
                word = load_eight(data, at)
                digits = count_digits(word)
                if digits == 0 or digits == 8 or not _is_word_end(data, at + digits):
                    return record, stop, first_item, ODD
                length = parse_digits(word, digits)
                at += digits
            if is_list[p] and p == wanted:
                if length > len(items) - n_items:
                    return record, stop, first_item, FULL
                for k in range(n_items, n_items + length):
                    at = _past_blanks(data, at)
                    word = load_eight(data, at)
                    digits = count_digits(word)
                    at += digits
                    if digits == 0 or digits == 8 or not _is_word_end(data, at):
                        return record, stop, first_item, ODD
                    items[k] = parse_digits(word, digits)
                n_items += length
                lengths[record] = length
            else:
                for _ in range(length if is_list[p] else 1):
                    begin = _past_blanks(data, at)
                    at = _past_word(data, begin)
                    if at == begin or not _is_word_end(data, at):
                        return record, stop, first_item, ODD
        if not _is_end(data, _past_blanks(data, at)):
            return record, stop, first_item, ODD
    return count, at, n_items, WHOLE
