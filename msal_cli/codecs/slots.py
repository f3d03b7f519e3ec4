"""Where a file stores an array of numbers, and the bytes that take their place.

An array of shape (n, k) lies in *units*: ranges of bytes that are replaced as a whole.  In a text
each number is a unit, in binary data each row, in encoded data (base64) the whole block.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.text_slots import usual_decimals
from msal_cli.errors import EXPORT_AGAIN, ContentError, FormatError
from msal_cli.storage.buffers import Buffer

SHORTEST = 18
"""In place of a number of decimals: the shortest text that is read back as the same double."""

NORMAL_DECIMALS = 6
"""Decimals that a recomputed unit normal has at the least."""

_FAR_FINER = 1e-7
"""Of the bounding box's diagonal: positions are written at least this finely."""

_MOST_SIGNIFICANT = 15
"""Decimal digits that float64 keeps whatever they are; beyond them the shortest text is used."""


class Numbers(Protocol):
    """An array (n, k) inside a file.

    Attributes
    ----------
    starts, stops : (q,) int64, ascending and disjoint, the units.
    values : (n, k) float64, exactly what is stored.
    """

    starts: Longs
    stops: Longs
    values: Floats

    def units(self, is_changed: Flags) -> Flags:
        """Which units (q,) hold one of these numbers (n, k)."""
        ...

    def texts(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        """The bytes of these units with new values (n, k), one behind the other, and their ends."""
        ...

    def stored(self, values: Floats) -> tuple[Floats, float]:
        """New values (n, k) as they will be read back, and how far off a number may be."""
        ...


@dataclass(eq=False)
class TextNumbers:
    """Numbers that are words of a text; ``unit_length`` is True for normals."""

    data: Bytes = field(repr=False)
    starts: Longs = field(repr=False)
    stops: Longs = field(repr=False)
    width: int = 3
    unit_length: bool = False
    values: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.values = parse_floats(self.data, self.starts, self.stops).reshape(-1, self.width)

    def units(self, is_changed: Flags) -> Flags:
        return is_changed.reshape(-1)

    def decimals(self) -> int:
        """Digits behind the point of new numbers: as many as are usual in the file, or as 1e-7 of
        the extent asks for, whichever is more."""
        from msal_cli.kernels.text import decimals_used

        used = usual_decimals(decimals_used(self.data, self.starts, self.stops))
        if self.unit_length:
            needed, largest = NORMAL_DECIMALS, 1.0
        else:
            extent = self.values.max(axis=0) * 0.5 - self.values.min(axis=0) * 0.5
            step = 2.0 * math.hypot(*extent.tolist()) * _FAR_FINER
            if not 0.0 < step < math.inf:
                return SHORTEST
            needed = math.ceil(-math.log10(step))
            largest = float(np.abs(self.values).max())
        decimals = max(used, needed, 0)
        before = max(0, math.ceil(math.log10(largest))) if largest > 0.0 else 0
        return SHORTEST if decimals + before > _MOST_SIGNIFICANT else decimals

    def texts(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        from msal_cli.kernels.text import printed, printed_shortest

        decimals = self.decimals()
        new = values.reshape(-1)[units]
        return printed_shortest(new, False) if decimals == SHORTEST else printed(new, decimals)

    def stored(self, values: Floats) -> tuple[Floats, float]:
        decimals = self.decimals()
        return values, 0.0 if decimals == SHORTEST else 0.5 * 10.0**-decimals * (1.0 + 1e-9)


@dataclass(eq=False)
class BinaryNumbers:
    """Rows of binary numbers: ``at`` (n,) is the first byte of each, ``code`` numpy's type."""

    data: Bytes = field(repr=False)
    at: Longs = field(repr=False)
    code: str = "<f4"
    width: int = 3
    starts: Longs = field(init=False, repr=False)
    stops: Longs = field(init=False, repr=False)
    values: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        size = np.dtype(self.code).itemsize * self.width
        self.starts, self.stops = self.at, self.at + size
        rows = np.empty((len(self.at), size), dtype=np.uint8)
        for k in range(size):
            rows[:, k] = self.data[self.at + k]
        self.values = rows.view(self.code).astype(np.float64)

    def units(self, is_changed: Flags) -> Flags:
        return np.asarray(is_changed.any(axis=1))

    def texts(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        rows = to_type(values[units], self.code, np.flatnonzero(units))
        text = np.ascontiguousarray(rows).view(np.uint8).reshape(-1)
        size = np.dtype(self.code).itemsize * self.width
        return text, np.arange(1, len(rows) + 1, dtype=np.int64) * size

    def stored(self, values: Floats) -> tuple[Floats, float]:
        return to_type(values, self.code, np.arange(len(values))).astype(np.float64), 0.0


@dataclass(eq=False)
class ColumnNumbers:
    """Binary numbers stored column by column: ``count`` x, then as many y, then z, from ``at``."""

    data: Bytes = field(repr=False)
    at: int
    count: int
    code: str
    starts: Longs = field(init=False, repr=False)
    stops: Longs = field(init=False, repr=False)
    values: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        size = np.dtype(self.code).itemsize
        self.starts = self.at + size * np.arange(3 * self.count, dtype=np.int64)
        self.stops = self.starts + size
        stored = self.data[self.at : self.at + 3 * self.count * size].view(self.code)
        self.values = np.ascontiguousarray(stored.reshape(3, -1).T.astype(np.float64))

    def units(self, is_changed: Flags) -> Flags:
        return is_changed.T.reshape(-1)

    def texts(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        new = values.T.reshape(-1)[units].astype(self.code)
        size = np.dtype(self.code).itemsize
        return new.view(np.uint8), size * np.arange(1, len(new) + 1, dtype=np.int64)

    def stored(self, values: Floats) -> tuple[Floats, float]:
        return values, 0.0


def to_type(values: Floats, code: str, rows: NDArray[np.int64]) -> NDArray[np.floating]:
    """Values (n, k) in a type of floating-point numbers; ``rows`` (n,) are their vertices.

    Raises ContentError (``E_RANGE``) for a number beyond float32.
    """
    if np.dtype(code).itemsize == 4:
        finite = np.abs(values).max(axis=1, initial=0.0) <= float(np.finfo(np.float32).max)
        first = int(rows[int(np.argmin(finite))]) if len(values) and not finite.all() else 0
        return as_float32(values, first).astype(code)
    return values.astype(code)


def as_float32(positions: Floats, first: int = 0) -> NDArray[np.float32]:
    """Positions (m, 9) or (n, 3) rounded to float32; ``first`` is the number of the first row.

    Raises
    ------
    ContentError
        with code ``E_RANGE`` if one is beyond float32's range.
    """
    with np.errstate(over="ignore", under="ignore"):
        rounded = positions.astype(np.float32)
    if not np.isfinite(rounded).all():
        bad = int(np.argmin(np.isfinite(rounded).reshape(len(rounded), -1).all(axis=1)))
        raise too_large_for_float32(f"row {first + bad}")
    return rounded


def too_large_for_float32(where: str) -> ContentError:
    return ContentError(
        "a position is too large for float32",
        code="E_RANGE",
        where=where,
        hint="scale the mesh, or write it to a format with float64",
    )


def parse_floats(data: Bytes, starts: Longs, stops: Longs) -> Floats:
    """The values (q,) of words; the exponent may be written with D, as Fortran does.

    Raises FormatError with the line of a word that is no number.
    """
    from msal_cli.kernels.text import numbers_at

    values, bad = numbers_at(data, starts, stops)
    while bad >= 0:
        word = data[starts[bad] : stops[bad]].tobytes()
        if len(starts) > 1 and not _has_fortran_exponents(data, starts, stops, bad):
            raise _no_number(data, int(starts[bad]), word)
        values = _fortran_floats(data, starts, stops)
        bad = -1
    return values


def _has_fortran_exponents(data: Bytes, starts: Longs, stops: Longs, bad: int) -> bool:
    word = data[starts[bad] : stops[bad]].tobytes()
    return b"d" in word.lower()


def _fortran_floats(data: Bytes, starts: Longs, stops: Longs) -> Floats:
    values = np.empty(len(starts))
    for i, (start, stop) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
        word = data[start:stop].tobytes()
        try:
            values[i] = float(word.replace(b"d", b"e").replace(b"D", b"e"))
        except ValueError:
            raise _no_number(data, start, word) from None
    return values


def _no_number(data: Bytes, at: int, word: bytes) -> FormatError:
    shown = word[:40].decode("ascii", "backslashreplace")
    return FormatError(
        f"{shown!r} is not a number", where=line_of(data, at), hint=number_hint(word)
    )


def number_hint(word: bytes, otherwise: str = EXPORT_AGAIN) -> str:
    """What to do about a word that is no number: it may have the comma of another language."""
    return "numbers need a decimal point, not a comma" if b"," in word else otherwise


def line_of(data: Buffer | Bytes, at: int) -> str:
    """The line of a byte, for messages."""
    from msal_cli.kernels.text import as_bytes

    return f"line {int(np.count_nonzero(as_bytes(data)[:at] == 10)) + 1}"


def spliced(data: Bytes, edits: Sequence[tuple[Longs, Longs, Bytes, Longs]]) -> memoryview:
    """A file with units replaced: their starts, stops, new bytes and the ends of these."""
    from msal_cli.kernels import text

    if len(edits) == 1:
        return text.spliced(data, *edits[0]).data
    starts = np.concatenate([edit[0] for edit in edits])
    stops = np.concatenate([edit[1] for edit in edits])
    sizes = np.concatenate([np.diff(edit[3], prepend=0) for edit in edits])
    words = np.concatenate([edit[2] for edit in edits])
    order = np.argsort(starts, kind="stable")
    if not (order[1:] > order[:-1]).all():
        first = (np.cumsum(sizes) - sizes)[order]
        sizes = sizes[order]
        inside = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        words = words[np.repeat(first, sizes) + inside]
    return text.spliced(data, starts[order], stops[order], words, np.cumsum(sizes)).data


def float_rows(values: Floats, *, single: bool) -> str:
    """Numbers (n, 3) as lines of the shortest text that is read back as the same numbers."""
    from msal_cli.kernels import text
    from msal_cli.kernels import text_rows as rows

    digits, stops = text.printed_shortest(values.reshape(-1), single)
    ends = values.shape[1] * np.arange(1, len(values) + 1, dtype=np.int64)
    return rows.lines(digits, stops, ends, b"").tobytes().decode()


def integer_rows(values: NDArray[np.int32]) -> str:
    """Whole numbers (n, 3) as lines of text."""
    from msal_cli.kernels import text
    from msal_cli.kernels import text_rows as rows

    digits, stops = text.printed(values.reshape(-1).astype(np.float64), 0)
    ends = values.shape[1] * np.arange(1, len(values) + 1, dtype=np.int64)
    return rows.lines(digits, stops, ends, b"").tobytes().decode()
