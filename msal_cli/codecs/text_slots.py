"""Numbers in a text: the digits that new ones get, and the bytes that take the place of the old.

In nearly all text meshes three numbers are one behind the other (``Statements``): no place per
number is kept, and one walk over the file replaces or compares them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import NamedTuple

import numpy as np

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.slots import UnitSlots, is_same
from msal_cli.errors import EXPORT_AGAIN, FormatError, InternalError
from msal_cli.storage.regular import Buffer

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
    n_above = len(used) - np.cumsum(np.bincount(used, minlength=1))
    return int(np.argmax(n_above * 100 <= len(used)))


def extent_decimals(vertices: Floats) -> int | None:
    """Decimals with which 1e-7 of the bounding box's diagonal can be written; less than 0 for a
    large one, None where all positions (n, 3) are the same."""
    # Column by column: numpy reduces the first of two axes slowly.  Halves cannot overflow.
    halves = [float(column.max() * 0.5 - column.min() * 0.5) for column in vertices.T]
    step = min(2.0 * math.hypot(*halves), 1e300) * _FAR_FINER
    return math.ceil(-math.log10(step)) if step > 0.0 else None


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


_UNREAD = np.empty((0, 0))


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

    data: Bytes
    _: KW_ONLY
    values: Floats = field(default_factory=lambda: _UNREAD)
    unit_length: bool = False
    significant: int = SIGNIFICANT_DIGITS
    codes: tuple[str, ...] = ()
    whole_rows: bool = False

    def used_decimals(self) -> Bytes:
        """Decimals that each of the file's numbers, or the finest of a row, has."""
        from msal_cli.kernels.text import count_decimals

        return count_decimals(self.data, self.starts, self.stops)

    @functools.cached_property
    def decimals(self) -> int:
        """Decimals of new numbers: as many as are usual, or as 1e-7 of the extent needs, whichever
        is more; ``SHORTEST`` where they and the digits before the point are more than
        ``significant``, or where nothing tells the scale."""
        needed: int | None = NORMAL_DECIMALS
        largest = 1.0
        if not self.unit_length:
            needed = extent_decimals(self.values)
            largest = max(float(self.values.max()), -float(self.values.min()))
        if needed is None:
            return SHORTEST
        decimals = max(min(usual_decimals(self.used_decimals()), SHORTEST - 1), needed)
        before = max(0, math.ceil(math.log10(largest))) if largest > 0.0 else 0
        return SHORTEST if decimals + before > self.significant else min(decimals, SHORTEST)

    @property
    def _is_whole(self) -> Flags:
        """Which columns hold whole numbers."""
        return np.array([code[-2] in "iu" for code in self.codes], dtype=bool)

    @property
    def has_whole_numbers(self) -> bool:
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
        is_exact = self.decimals >= SHORTEST
        return values, 0.0 if is_exact else 0.5 * 10.0**-self.decimals * (1.0 + 1e-9)


@dataclass(eq=False)
class Tokens(TextSlots):
    """Numbers that are tokens: ``starts`` and ``stops`` (n * width,), row by row."""

    starts: Longs
    stops: Longs
    width: int = 3

    def __post_init__(self) -> None:
        if self.values is _UNREAD:
            self.values = parse_floats(self.data, self.starts, self.stops).reshape(-1, self.width)


def parse_floats(data: Bytes, starts: Longs, stops: Longs) -> Floats:
    """The values (q,) of words; the exponent may be written with D, as Fortran does.

    Raises FormatError with the line of a word that is no number.
    """
    from msal_cli.kernels.text import read_numbers

    values, bad = read_numbers(data, starts, stops)
    if bad >= 0:
        word = data[starts[bad] : stops[bad]].tobytes()
        if len(starts) > 1 and b"d" not in word.lower():
            raise _no_number(data, int(starts[bad]), word)
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


MAX_TURNS = 4096
"""Changes between positions and normals, on the way through a file, from which on all of its new
numbers have the same decimals."""

_ROWS = 1 << 16
"""Statements of one kind that are replaced or compared at a time."""


@dataclass(eq=False)
class Statements(TextSlots):
    """Three numbers each, with blanks between them.

    Attributes
    ----------
    at : (n,) int64, ascending, first byte of each; ``skipped`` bytes of it are a keyword.
    used : (n,) uint8, the most decimals of each one's numbers.
    """

    at: Longs
    used: Bytes
    skipped: int = 0

    def used_decimals(self) -> Bytes:
        return self.used

    @functools.cached_property
    def _spans(self) -> tuple[Longs, Longs]:
        from msal_cli.kernels.statements import find_tokens

        starts = np.empty(3 * len(self.at), dtype=np.int64)
        stops = np.empty_like(starts)
        find_tokens(self.data, self.at + self.skipped, starts, stops)
        return starts, stops

    @property
    def starts(self) -> Longs:  # type: ignore[override]
        return self._spans[0]

    @property
    def stops(self) -> Longs:  # type: ignore[override]
        return self._spans[1]

    def row_decimals(self, values: Floats) -> Bytes | None:
        """Decimals (n,) for new ``values`` (n, 3): those that the line has, and at least those of
        the file, cut down to what float64 tells apart, about 15 digits in all; normals have the
        file's.  None where the file's are more than that."""
        used, largest = self.used, max(float(values.max()), -float(values.min()))
        if self.unit_length:
            used, largest = np.zeros_like(used), 1.0
        most = 16
        while most >= 0 and not largest * 10.0**most < 2.0**52:
            most -= 1
        if self.decimals > most:
            return None
        return np.clip(used, self.decimals, most).astype(np.uint8)


class Patch(NamedTuple):
    """Statements, their new ``values`` (n, 3), and the ``decimals`` (n,) of each one's.

    ``is_changed`` (n, 3) are the numbers to write, None for those that differ.
    """

    slots: Statements
    values: Floats
    decimals: Bytes
    is_changed: Flags | None = None


class _Block(NamedTuple):
    """Statements one behind the other: see ``kernels.statements.replace``."""

    begins: Longs
    old: Floats
    new: Floats
    decimals: Bytes


def replace_statements(data: Bytes, patches: Sequence[Patch]) -> memoryview:
    """The file with its statements' changed numbers replaced."""
    from msal_cli.kernels.statements import replace
    from msal_cli.kernels.text import format_shortest

    out = np.empty(len(data) + sum(map(_room, patches)) + 8, dtype=np.uint8)
    done = to = 0
    for block in _blocks(patches):
        row = axis = 0
        while True:
            done, to, row, axis = replace(data, done, out, to, row, axis, *block)
            if row == len(block.begins):
                break
            is_single = block.decimals[row] == SHORTEST_SINGLE
            text = format_shortest(float(block.new[row, axis]), is_single).encode()
            out[to : to + len(text)] = np.frombuffer(text, dtype=np.uint8)
            to, axis = to + len(text), axis + 1
    size = to + len(data) - done
    out[to:size] = data[done:]
    return out[:size].data


def _room(patch: Patch) -> int:
    """Most bytes that new numbers take."""
    from msal_cli.kernels.text import fixed_width

    if not len(patch.values):
        return 0
    largest = max(float(patch.values.max()), -float(patch.values.min()))
    return 3 * len(patch.values) * fixed_width(largest, int(patch.decimals.max()))


def require_replaced(data: Bytes, result: Bytes, patches: Sequence[Patch]) -> None:
    """Raise InternalError unless ``result`` is the file with just that replaced."""
    from msal_cli.kernels import statements

    tolerances = np.append(0.5 * 10.0 ** -np.arange(18.0) * (1.0 + 1e-9), [0.0, 0.0])
    done = result_done = row = axis = 0
    for block in _blocks(patches):
        row = axis = 0
        status = statements.ASIDE
        while status == statements.ASIDE:
            status, done, result_done, row, axis = statements.compare(
                data, done, result, result_done, row, axis, *block, tolerances
            )
            if status == statements.ASIDE:
                token = result[result_done : result_done + 64].tobytes().split()[0]
                expected = float(block.new[row, axis])
                slack = tolerances[block.decimals[row]] + 4.5e-16 * abs(expected)
                if not abs(float(token) - expected) <= slack:
                    status = statements.WRONG_VALUE
                result_done, axis = result_done + len(token), axis + 1
        where = f"near byte {done}"
        if status == statements.WRONG_VALUE:
            raise InternalError("the output holds another number than it should", where=where)
        if status == statements.DIFFERENT:
            raise InternalError(
                "the output differs from the input in more than positions and normals", where=where
            )
    if not is_same(data[done:], result[result_done:]):
        raise InternalError("the output differs from the input in more than positions and normals")


def is_interleaved(patches: Sequence[Patch]) -> bool:
    """Whether statements of different patches take turns more than ``MAX_TURNS`` times."""
    if len(patches) == 1:
        return False
    at = [patch.slots.at for patch in patches]
    owners = np.repeat(np.arange(len(at)), [len(starts) for starts in at])
    order = np.argsort(np.concatenate(at), kind="stable")
    return 1 + int(np.count_nonzero(np.diff(owners[order]))) > MAX_TURNS


def _blocks(patches: Sequence[Patch]) -> Iterator[_Block]:
    """The statements in the order of the file, a block at a time."""
    at = [patch.slots.at for patch in patches]
    firsts = np.unique(np.concatenate([starts[::_ROWS] for starts in at]))
    cuts = [np.append(np.searchsorted(starts, firsts), len(starts)).tolist() for starts in at]
    for k in range(len(firsts)):
        blocks = []
        for (slots, values, decimals, is_changed), cut in zip(patches, cuts, strict=True):
            rows = slice(cut[k], cut[k + 1])
            old = slots.values[rows]
            if is_changed is not None:
                old = np.where(is_changed[rows], np.nan, values[rows])
            if len(old):
                begins = slots.at[rows] + slots.skipped
                blocks.append(_Block(begins, old, values[rows], decimals[rows]))
        block = blocks[0]
        if len(blocks) > 1:
            order = np.argsort(np.concatenate([block.begins for block in blocks]), kind="stable")
            block = _Block(*(np.concatenate(parts)[order] for parts in zip(*blocks, strict=True)))
        yield block
