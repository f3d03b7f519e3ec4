"""Where a file stores an array of numbers, and the bytes that take their place.

An array of shape (n, k) lies in *units*: ranges of bytes that are replaced as a whole.  In a text
each number is a unit, in binary data each row, in encoded data (base64) the whole block.  The
module ``record_slots`` has arrays whose numbers are overwritten in place, without units, and
``text_slots`` those of a text.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.decimals import (
    SIGNIFICANT_DIGITS,
    print_numbers,
    tolerance,
    uniform_decimals,
)
from msal_cli.errors import EXPORT_AGAIN, ContentError, FormatError
from msal_cli.storage.regular import Buffer

_UNREAD = np.empty((0, 0))


class Slots:
    """An array (n, k) inside a file.

    Attributes
    ----------
    values : (n, k) float64, exactly what is stored.
    codes : numpy's type of each column where it limits what a number can be, empty where none does.
    whole_rows : where one number of a row changes, all of them are written anew.
    """

    values: Floats
    codes: tuple[str, ...] = ()
    whole_rows: bool = False

    def rounded(self, values: Floats) -> tuple[Floats, Floats | float]:
        """New values (n, k) as they will be read back, and how far off a number may be."""
        raise NotImplementedError


class UnitSlots(Slots):
    """An array whose new bytes take the place of the old ones, which may be longer or shorter.

    ``starts`` and ``stops`` (q,) int64, disjoint, are the units.
    """

    starts: Longs
    stops: Longs

    def units(self, is_changed: Flags) -> Flags:
        """Which units (q,) hold one of these numbers (n, k)."""
        raise NotImplementedError

    def encode(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        """The bytes of these units with new values (n, k), one behind the other, and their ends."""
        raise NotImplementedError


@dataclass(eq=False)
class TextSlots(UnitSlots):
    """What all numbers in a text have in common.

    Attributes
    ----------
    data : (size,) uint8, the file.
    values : (n, k) float64; read from the text where they are not given.
    unit_length : the numbers are normals.
    significant : digits that the file may ask for before the shortest text is written instead.
    """

    data: Bytes = field(repr=False)
    values: Floats = field(default_factory=lambda: _UNREAD, repr=False, kw_only=True)
    unit_length: bool = field(default=False, kw_only=True)
    significant: int = field(default=SIGNIFICANT_DIGITS, kw_only=True)
    codes: tuple[str, ...] = field(default=(), kw_only=True)
    whole_rows: bool = field(default=False, kw_only=True)

    def used_decimals(self) -> Bytes:
        """Decimals that each of the file's numbers, or the finest of a row, has."""
        from msal_cli.kernels.text import count_decimals

        return count_decimals(self.data, self.starts, self.stops)

    @functools.cached_property
    def decimals(self) -> int:
        """Decimals of new numbers, or ``SHORTEST``; see ``decimals.uniform_decimals``."""
        return uniform_decimals(
            self.used_decimals(),
            self.values,
            unit_length=self.unit_length,
            significant=self.significant,
        )

    @property
    def _is_whole(self) -> Flags:
        """Which columns hold whole numbers."""
        return np.array([code[-2] in "iu" for code in self.codes], dtype=bool)

    @property
    def has_whole_numbers(self) -> bool:
        """Whether a column holds whole numbers."""
        return bool(self._is_whole.any())

    def units(self, is_changed: Flags) -> Flags:
        return is_changed.reshape(-1)

    def encode(self, values: Floats, units: Flags) -> tuple[Bytes, Longs]:
        decimals: int | Bytes = self.decimals
        if self.has_whole_numbers:
            columns = np.where(self._is_whole, 0, self.decimals).astype(np.uint8)
            decimals = np.tile(columns, len(values))[units]
        return print_numbers(values.reshape(-1)[units], decimals)

    def rounded(self, values: Floats) -> tuple[Floats, Floats | float]:
        if self.has_whole_numbers:
            values = np.where(self._is_whole, np.rint(values), values)
        return values, tolerance(self.decimals)


@dataclass(eq=False)
class Tokens(TextSlots):
    """Numbers that are tokens: ``starts`` and ``stops`` (n * width,), row by row."""

    starts: Longs = field(repr=False)
    stops: Longs = field(repr=False)
    width: int = 3

    def __post_init__(self) -> None:
        if self.values is _UNREAD:
            self.values = parse_floats(self.data, self.starts, self.stops).reshape(-1, self.width)


def to_type(values: Floats, code: str) -> NDArray[np.generic]:
    """Values (n, k) as a file of that number type stores them: rounded to the nearest.

    A half goes to the even neighbour.  A value beyond the type's range becomes infinite (float)
    or is wrapped (integer): ``require_range`` refuses it.
    """
    dtype = np.dtype(code)
    with np.errstate(over="ignore", invalid="ignore"):
        return (values if dtype.kind == "f" else np.rint(values)).astype(dtype)


def as_float32(positions: Floats) -> NDArray[np.float32]:
    """Positions (m, 9) or (n, 3) as float32; ContentError (``E_RANGE``) beyond its range."""
    with np.errstate(over="ignore", under="ignore"):
        rounded = positions.astype(np.float32)
    if not np.isfinite(rounded).all():
        bad = int(np.argmin(np.isfinite(rounded).reshape(len(rounded), -1).all(axis=1)))
        raise too_large_for_float32(f"row {bad}")
    return rounded


def too_large_for_float32(where: str) -> ContentError:
    return ContentError(
        "a position is too large for float32",
        code="E_RANGE",
        where=where,
        hint="scale the mesh, or write it to a format with float64",
    )


def require_range(values: Floats, is_changed: Flags, codes: Sequence[str], first: int = 0) -> None:
    """Raise ContentError (``E_RANGE``) where a changed number (n, k) does not fit its type.

    ``codes`` are numpy's types of the columns, ``first`` the number of the file's first vertex.
    """
    dtypes = [np.dtype(code) for code in codes]
    # Where all fit, two numbers say so; NaN does not.
    largest = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
    if all(one.kind == "f" and largest <= float(np.finfo(one).max) for one in dtypes):
        return
    for k, dtype in enumerate(dtypes):
        limits = np.finfo(dtype) if dtype.kind == "f" else np.iinfo(dtype)
        low, high = float(limits.min), float(limits.max)
        if high > limits.max:
            high = float(np.nextafter(high, 0.0))
        column = values[:, k] if dtype.kind == "f" else np.rint(values[:, k])
        # Written so that NaN counts as outside.
        is_outside = is_changed[:, k] & ~((column >= low) & (column <= high))
        if is_outside.any():
            vertex = int(np.argmax(is_outside)) + first
            raise ContentError(
                f"the new {'xyz'[k]} of vertex {vertex} does not fit the file's number type",
                where=f"vertex {vertex}",
                hint="write the positions as doubles (--precision float64, --to ply), or scale "
                "the mesh",
                code="E_RANGE",
            )


def parse_floats(data: Bytes, starts: Longs, stops: Longs) -> Floats:
    """The values (q,) of words; the exponent may be written with D, as Fortran does.

    Raises FormatError with the line of a word that is no number.
    """
    from msal_cli.kernels.text import read_numbers

    values, bad = read_numbers(data, starts, stops)
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
        f"{shown!r} is not a number", where=f"line {line_of(data, at)}", hint=number_hint(word)
    )


def number_hint(word: bytes, otherwise: str = EXPORT_AGAIN) -> str:
    """What to do about a word that is no number: it may have the comma of another language."""
    return "numbers need a decimal point, not a comma" if b"," in word else otherwise


def line_of(data: Buffer | Bytes, at: int) -> int:
    """The line, from one, that byte ``at`` is in; lines may end with LF, CR LF or CR."""
    from msal_cli.kernels.text import as_bytes

    before = as_bytes(data)[:at].tobytes()
    # A CR LF that is cut in two by ``at`` has been counted by its CR.
    return 1 + before.count(b"\n") + before.count(b"\r") - before.count(b"\r\n")


def splice(data: Bytes, edits: Sequence[tuple[Longs, Longs, Bytes, Longs]]) -> memoryview:
    """A file with units replaced: their starts, stops, new bytes and the ends of these."""
    from msal_cli.kernels import text

    starts = np.concatenate([edit[0] for edit in edits])
    if len(edits) == 1 and (starts[1:] > starts[:-1]).all():
        return text.splice(data, *edits[0]).data
    stops = np.concatenate([edit[1] for edit in edits])
    sizes = np.concatenate([np.diff(edit[3], prepend=0) for edit in edits])
    words = np.concatenate([edit[2] for edit in edits])
    order = np.argsort(starts, kind="stable")
    if not (order[1:] > order[:-1]).all():
        first = (np.cumsum(sizes) - sizes)[order]
        sizes = sizes[order]
        inside = np.arange(int(sizes.sum())) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        words = words[np.repeat(first, sizes) + inside]
    return text.splice(data, starts[order], stops[order], words, np.cumsum(sizes)).data
