"""How many digits behind the point new numbers of a text get, and the new numbers as text."""

from __future__ import annotations

import math

import numpy as np

from msal_cli.arrays import Bytes, Floats, Longs

SHORTEST = 18
"""In place of a number of decimals: the shortest text that is read back as the same double."""

SHORTEST_SINGLE = 19
"""In place of a number of decimals: the shortest text that is read back as the same float32."""

NORMAL_DECIMALS = 6
"""Decimals that a recomputed unit normal has at the least."""

SIGNIFICANT_DIGITS = 15
"""Decimal digits that float64 keeps whatever they are."""

_FAR_FINER = 1e-7
"""Of the bounding box's diagonal: positions are written at least this finely."""

_BLOCK = 1 << 16
"""Numbers of different decimals that are printed at a time."""


def usual_decimals(used: Bytes) -> int:
    """The fewest decimals that all but one in a hundred of ``used`` (n,) do not exceed.

    A few numbers that some program wrote with all 17 digits say nothing about the others.
    """
    return usual_of_counts(np.bincount(used, minlength=256)) if len(used) else 0


def usual_of_counts(counts: Longs) -> int:
    """The same from how often each number of decimals occurs, ``counts`` (256,)."""
    n = int(counts.sum())
    return int(np.argmax((n - np.cumsum(counts)) * 100 <= n))


def extent_decimals(vertices: Floats) -> int | None:
    """Decimals with which 1e-7 of the bounding box's diagonal can be written; less than 0 for a
    large one, None where all positions (n, 3) are the same."""
    # Column by column: numpy reduces the first of two axes slowly.  Halves cannot overflow.
    halves = [float(column.max() * 0.5 - column.min() * 0.5) for column in vertices.T]
    step = min(2.0 * math.hypot(*halves), 1e300) * _FAR_FINER
    return math.ceil(-math.log10(step)) if step > 0.0 else None


def uniform_decimals(
    used: Bytes, values: Floats, *, unit_length: bool, significant: int = SIGNIFICANT_DIGITS
) -> int:
    """Decimals for new numbers of an array: as many as are usual, or as 1e-7 of the extent needs,
    whichever is more; ``SHORTEST`` where they and the digits before the point are more than
    ``significant``, or where nothing tells the scale.

    ``used`` are the decimals that the file's numbers have, ``values`` (n, 3) the numbers.
    """
    usual = usual_decimals(used)
    return decimals_for(usual, values, unit_length=unit_length, significant=significant)


def decimals_for(usual: int, values: Floats, *, unit_length: bool, significant: int) -> int:
    """``uniform_decimals`` where ``usual`` decimals are known; of ``values`` only the extremes
    count."""
    usual = min(usual, SHORTEST - 1)
    needed: int | None = NORMAL_DECIMALS
    largest = 1.0
    if not unit_length:
        needed = extent_decimals(values)
        largest = max(float(values.max()), -float(values.min()))
    if needed is None:
        return SHORTEST
    decimals = max(usual, needed)
    before = max(0, math.ceil(math.log10(largest))) if largest > 0.0 else 0
    return SHORTEST if decimals + before > significant else min(decimals, SHORTEST)


def row_decimals(used: Bytes, least: int, largest: float) -> Bytes | None:
    """Decimals (n,) for each new position: those that its line has, and at least ``least``.

    ``used`` (n,) are those that the file has, ``largest`` the largest magnitude of a new
    number.  They are cut down to what float64 tells apart, about 15 digits in all; None where
    ``least`` are more than that.
    """
    most = 16
    while most >= 0 and not largest * 10.0**most < 2.0**52:
        most -= 1
    if least > most:
        return None
    return np.clip(used, least, most).astype(np.uint8)


def tolerance(decimals: int) -> float:
    """How far a number that was printed with so many decimals is off at the most."""
    return 0.0 if decimals >= SHORTEST else 0.5 * 10.0**-decimals * (1.0 + 1e-9)


def print_numbers(values: Floats, decimals: int | Bytes) -> tuple[Bytes, Longs]:
    """The texts (size,) of numbers (k,) one behind the other, and where each ends (k,).

    ``decimals``, for all or for each (k,), are digits behind the point, ``SHORTEST`` or
    ``SHORTEST_SINGLE``.
    """
    from msal_cli.kernels.text import print_numbers

    if isinstance(decimals, int):
        return print_numbers(values, decimals)
    if not len(decimals) or (decimals == decimals[0]).all():
        return print_numbers(values, int(decimals[0]) if len(decimals) else 0)
    pieces, ends, size = [], [], 0
    for at in range(0, len(values), _BLOCK):
        text, stops = _print_mixed(values[at : at + _BLOCK], decimals[at : at + _BLOCK])
        pieces.append(text)
        ends.append(stops + size)
        size += len(text)
    return np.concatenate(pieces), np.concatenate(ends)


def _print_mixed(values: Floats, decimals: Bytes) -> tuple[Bytes, Longs]:
    lengths = np.zeros(len(values), dtype=np.int64)
    groups = []
    for count in np.unique(decimals).tolist():
        rows = np.flatnonzero(decimals == count)
        text, stops = print_numbers(values[rows], count)
        lengths[rows] = np.diff(stops, prepend=0)
        groups.append((rows, text))
    ends = np.cumsum(lengths)
    out = np.empty(int(ends[-1]), dtype=np.uint8)
    for rows, text in groups:
        sizes = lengths[rows]
        shift = ends[rows] - np.cumsum(sizes)
        out[np.arange(len(text)) + np.repeat(shift, sizes)] = text
    return out, ends
