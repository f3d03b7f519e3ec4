"""Ascii PLY elements that are plainly written: read in one walk, without the place of every word.

What is not plain is left to ``ply_layout``, which also finds the words for an error.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Bytes, Floats, Ints, Longs
from msal_cli.codecs.ply_header import Element

GROUPS = (("x", "y", "z"), ("nx", "ny", "nz"))
"""Scalars that are replaced together, if they stand together in this order."""

_NUMBER = re.compile(rb"[-+]?(?:\d{1,25}(?:\.\d{0,25})?|\.\d{1,25})(?:[eE][-+]?\d{1,3})?")
_LINE = re.compile(rb"[ \t\r\n]*+([^\r\n\x00-\x08\x0b\x0c\x0e-\x1f]++)(?=[\r\n]|\Z)")

_MOST_READ = 5_000
"""Records that are read one by one: more take longer than the walk for all records."""


@dataclass(frozen=True, eq=False)
class Numbers:
    """What was read of an element.

    Attributes
    ----------
    names, values : scalars, and their values (count, len(names)).
    word_at, decimals : for each of ``GROUPS`` that is there, where its first word stands (count,),
        and the most decimals of its three numbers (count,).
    list_name, items, lengths : a list, all its items one record behind another, and the number
        of each record's (count,); an empty name for none.
    """

    names: tuple[str, ...]
    values: Floats
    word_at: dict[tuple[str, ...], Longs]
    decimals: dict[tuple[str, ...], Bytes]
    list_name: str
    items: Ints
    lengths: Ints


def numbers(
    data: Bytes, element: Element, at: int, wanted: Sequence[str]
) -> tuple[Numbers, int] | None:
    """The ``wanted`` properties of the element that begins at byte ``at``, and its end.

    Nothing where its records are not plain, or not of the kind that is read here: scalars, or one
    list among properties that are not wanted.
    """
    listed = element.properties
    lists = [one.name for one in listed if one.is_list]
    if not listed or not element.count or element.count > len(data):
        return None
    if lists:
        return _lists(data, element, at, wanted)
    return _scalars(data, element, at, wanted)


def _scalars(
    data: Bytes, element: Element, at: int, wanted: Sequence[str]
) -> tuple[Numbers, int] | None:
    from msal_cli.kernels.ply_fast import ODD, read_scalars

    all_names = [one.name for one in element.properties]
    names = tuple(name for name in all_names if name in wanted)
    columns = np.array([names.index(name) if name in names else -1 for name in all_names])
    together = [
        group
        for group in GROUPS
        if set(group) <= set(names) and tuple(all_names[all_names.index(group[0]) :][:3]) == group
    ]
    groups = np.array(
        [next((g for g, one in enumerate(together) if name in one), -1) for name in all_names]
    )
    values = np.empty((element.count, len(names)))
    word_at = np.empty((len(together), element.count), dtype=np.int64)
    decimals = np.empty((len(together), element.count), dtype=np.uint8)
    done, n_read = 0, 0
    while True:
        done, at, status = read_scalars(
            data, at, done, element.count, columns, groups, values, word_at, decimals
        )
        if status != ODD:
            break
        line = _LINE.match(data.data, at)
        n_read += 1
        if line is None or n_read > _MOST_READ:
            return None
        words = list(re.finditer(rb"[^ \t]+", line[1]))
        if len(words) != len(all_names):
            return None
        for p, word in enumerate(words):
            if columns[p] < 0:
                continue
            if not _NUMBER.fullmatch(word[0]):
                return None
            values[done, columns[p]] = float(word[0])
        for g, group in enumerate(together):
            first = all_names.index(group[0])
            word_at[g, done] = line.start(1) + words[first].start()
            decimals[g, done] = max(_decimals(one[0]) for one in words[first : first + 3])
        done += 1
        at = line.start(1) + words[-1].end()
    return Numbers(
        names,
        values,
        dict(zip(together, word_at, strict=True)),
        dict(zip(together, decimals, strict=True)),
        "",
        np.empty(0, dtype=np.int32),
        np.empty(0, dtype=np.int32),
    ), int(at)


def _decimals(number: bytes) -> int:
    """Digits behind the point, the exponent counted in: ``1.5e-3`` has four."""
    mantissa, _, exponent = number.lower().partition(b"e")
    return min(max(len(mantissa.partition(b".")[2]) - int(exponent or b"0"), 0), 255)


def _lists(
    data: Bytes, element: Element, at: int, wanted: Sequence[str]
) -> tuple[Numbers, int] | None:
    from msal_cli.kernels.ply_fast import FULL, WHOLE, read_lists

    listed = element.properties
    names = [one.name for one in listed if one.name in wanted]
    if len(names) > 1 or not all(one.is_list for one in listed if one.name in wanted):
        return None
    is_list = np.array([one.is_list for one in listed])
    which = element.index(names[0]) if names else -1
    # An item is one digit and one blank at the least.
    most = (len(data) - at) // 2 + 1
    items = np.empty(min(3 * element.count, most) if names else 0, dtype=np.int32)
    lengths = np.empty(element.count if names else 0, dtype=np.int32)
    done = n_items = 0
    while True:
        done, at, n_items, status = read_lists(
            data, at, done, element.count, is_list, which, items, n_items, lengths
        )
        if status == WHOLE:
            break
        if status != FULL or len(items) >= most:
            return None
        # As many for each record to come as those so far have.
        alike = (n_items // max(done, 1) + 1) * element.count
        larger = np.empty(min(max(alike, len(items) * 3 // 2 + 64), most), dtype=np.int32)
        larger[:n_items] = items[:n_items]
        items = larger
    if len(lengths) and (lengths == lengths[0]).all():
        # One number instead of one for each record.
        lengths = np.broadcast_to(lengths[:1].copy(), lengths.shape)
    return Numbers(
        (),
        np.empty((element.count, 0)),
        {},
        {},
        names[0] if names else "",
        items[:n_items],
        lengths,
    ), int(at)
