"""New numbers in the lines of an ascii PLY file, every other byte kept."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.decimals import usual_decimals
from msal_cli.codecs.ply_ascii import Lines

NORMAL_DECIMALS = 6
"""Decimals that a recomputed unit normal has at the least."""

SHORTEST = 18
"""In place of a number of decimals: the shortest text that reads back as the same double."""


WHOLE = -1
"""In place of a number of decimals: rounded to a whole number, a half to the even one."""


@dataclass(frozen=True)
class Edit:
    """New ``values`` (count, k) for the scalars ``names`` of a section, written where ``where``
    (count, k), with ``decimals`` (k,) digits behind the point, or ``SHORTEST`` or ``WHOLE``."""

    section: Lines
    names: Sequence[str]
    values: Floats
    where: Flags
    decimals: Sequence[int]


def position_decimals(section: Lines, names: Sequence[str], vertices: Floats) -> int:
    """Decimals for coordinates: as many as are usual, or enough for 1e-7 of the extent.

    ``vertices`` (n, 3) gives the extent, the diagonal of the bounding box.  Where more than 17
    decimals were needed, or nothing tells the scale, the answer is ``SHORTEST``.
    """
    used = _usual_decimals(section, names)
    with np.errstate(over="ignore"):
        extent = math.hypot(*(vertices.max(axis=0) - vertices.min(axis=0)).tolist())
    needed = SHORTEST
    if extent > 0.0:
        needed = math.ceil(-math.log10(min(extent, 1e300) * 1e-7))
    return max(used, min(needed, SHORTEST))


def normal_decimals(section: Lines, names: Sequence[str]) -> int:
    """Decimals for normals: as many as are usual, and at least ``NORMAL_DECIMALS``."""
    return max(_usual_decimals(section, names), NORMAL_DECIMALS)


def _usual_decimals(section: Lines, names: Sequence[str]) -> int:
    """The decimals that numbers of these properties usually have, at most 17."""
    from msal_cli.kernels.digits import MOST_DECIMALS
    from msal_cli.kernels.text import decimals_used

    if section.read is not None and tuple(names) in section.read.decimals:
        decimals = section.read.decimals[tuple(names)]
    else:
        decimals = decimals_used(section.data, *section.spans(_in_file_order(section, names)))
    return min(usual_decimals(decimals), MOST_DECIMALS)


def edited(data: Bytes, edits: Sequence[Edit]) -> memoryview:
    """The file with the edits' tokens replaced."""
    from msal_cli.kernels.text import printed, printed_shortest, spliced

    pieces: list[tuple[Longs, Longs, Bytes, Longs]] = []
    for edit in edits:
        section = edit.section
        for decimals in sorted(set(edit.decimals)):
            names = [n for n, d in zip(edit.names, edit.decimals, strict=True) if d == decimals]
            names = _in_file_order(section, names)
            pick = [list(edit.names).index(name) for name in names]
            values, chosen = edit.values, edit.where
            if pick != list(range(values.shape[1])):
                values, chosen = values[:, pick], chosen[:, pick]
            if decimals == WHOLE:
                values = np.rint(values)
                chosen = chosen & (values != section.numbers(names))
            starts, stops = section.spans(names)
            flat = chosen.reshape(-1)
            new = values.reshape(-1)[flat]
            text = (
                printed_shortest(new, False)
                if decimals == SHORTEST
                else printed(new, max(decimals, 0))
            )
            pieces.append((starts[flat], stops[flat], *text))
    return spliced(data, *_merged(pieces)).data


def _merged(
    pieces: Sequence[tuple[Longs, Longs, Bytes, Longs]],
) -> tuple[Longs, Longs, Bytes, Longs]:
    """Several sets of (starts, stops, text, ends of the texts) as one with ascending starts."""
    if len(pieces) == 1:
        return pieces[0]
    starts = np.concatenate([one[0] for one in pieces])
    order = np.argsort(starts)
    sizes = np.concatenate([np.diff(one[3], prepend=0) for one in pieces])
    text = np.concatenate([one[2] for one in pieces])
    begins = np.cumsum(sizes) - sizes
    ends = np.cumsum(sizes[order])
    # Byte j of the sorted text comes from its piece's beginning plus its distance from there.
    source = np.repeat(begins[order] - (ends - sizes[order]), sizes[order])
    source += np.arange(len(source))
    return starts[order], np.concatenate([one[1] for one in pieces])[order], text[source], ends


def is_same_but_for(
    data: Bytes, result: Bytes, kept: Sequence[tuple[Lines, Lines, Sequence[str], Flags]]
) -> bool:
    """Whether two files agree outside tokens: (old section, new section, names, where)."""
    from msal_cli.kernels.text import same_outside

    spans: list[list[Longs]] = []
    for old, new, names, where in kept:
        ordered = _in_file_order(old, names)
        chosen = where[:, [list(names).index(name) for name in ordered]].reshape(-1)
        spans.append([one[chosen] for one in (*old.spans(ordered), *new.spans(ordered))])
    ranges = spans[0]
    if len(spans) > 1:
        joined = [np.concatenate(parts) for parts in zip(*spans, strict=True)]
        order = np.argsort(joined[0])
        ranges = [one[order] for one in joined]
    a_starts, a_stops, b_starts, b_stops = ranges
    return same_outside(data, a_starts, a_stops, result, b_starts, b_stops)


def _in_file_order(section: Lines, names: Sequence[str]) -> list[str]:
    return sorted(names, key=section.element.index)
