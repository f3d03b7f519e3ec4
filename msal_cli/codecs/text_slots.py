"""Numbers in a text: its words, the digits that new ones get, and the bytes that take the place of
the old.

In nearly all text meshes three numbers are one behind the other: no place per number is kept, and
one walk over the file replaces or compares them.
"""

from __future__ import annotations

import functools
import itertools
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import KW_ONLY
from typing import Any, AnyStr, NamedTuple, TypeVar

import numpy as np

from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs.slots import Change, Slots, is_same
from msal_cli.errors import (
    EXPORT_AGAIN,
    FormatError,
    InternalError,
    bad_index,
    cut_short,
    damaged,
    format_count,
)
from msal_cli.light_dataclass import dataclass
from msal_cli.storage.regular import Buffer

SHORTEST = 18
"""In place of a number of decimals: the shortest text that is read back as the same double."""

NORMAL_DECIMALS = 6
"""Decimals that a recomputed unit normal has at the least."""

SIGNIFICANT_DIGITS = 15
"""Decimal digits that float64 keeps whatever they are."""

_FAR_FINER = 1e-7
"""Of the bounding box's diagonal: positions are written at least this finely."""

_NUMBER = re.compile(rb"[^\s\"'\\]*")


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


@dataclass(eq=False)
class TextSlots(Slots):
    """Numbers in a text, in runs: the three of a row one behind the other with blanks between, or
    each for itself."""

    data: Bytes  # (size,) uint8, the file
    at: Longs  # (q,) int64, ascending, first byte of each run, or of its keyword
    _: KW_ONLY
    values: Floats  # (n, k) float64
    skipped: int = 0  # bytes of the keyword
    unit_length: bool = False  # the numbers are normals
    # digits that the file may ask for before the shortest text is written instead
    significant: int = SIGNIFICANT_DIGITS
    codes: tuple[str, ...] = ()
    whole_rows: bool = False

    @property
    def width(self) -> int:
        """Numbers of a run: those of a row, or 1."""
        return self.values.size // max(len(self.at), 1)

    @functools.cached_property
    def used(self) -> Bytes:
        """The most decimals (q,) of the numbers of each run."""
        from msal_cli.kernels.text import find_numbers

        used = np.empty(len(self.at), dtype=np.uint8)
        find_numbers(self.data, self.at + self.skipped, self.width, _NONE, used)
        return used

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
        decimals = max(min(usual_decimals(self.used), SHORTEST - 1), needed)
        before = max(0, math.ceil(math.log10(largest))) if largest > 0.0 else 0
        return SHORTEST if decimals + before > self.significant else min(decimals, SHORTEST)

    def own_decimals(self, values: Floats) -> Bytes | None:
        """Decimals (q,) for new ``values`` (n, k) where each run keeps its own; else None."""
        return None

    @property
    def is_whole(self) -> Flags:
        """Which columns hold whole numbers."""
        return np.array([code[-2] in "iu" for code in self.codes], dtype=bool)

    def rounded(self, values: Floats) -> Floats:
        is_whole = self.is_whole
        return np.where(is_whole, np.rint(values), values) if is_whole.any() else values

    def make_patch(
        self, values: Floats, is_changed: Flags, decimals: Bytes, *, is_single: bool = False
    ) -> Patch:
        """What writes new ``values`` (n, k) where they changed, with ``decimals`` (q,); with a run
        for each number if ``is_single``."""
        from msal_cli.kernels.text import find_numbers

        starts, width = self.at + self.skipped, self.width
        is_whole = self.is_whole
        if width > 1 and (is_single or is_whole.any()):
            starts = np.empty(values.size, dtype=np.int64)
            find_numbers(self.data, self.at + self.skipped, width, starts, _NO_BYTES)
            decimals, width = np.repeat(decimals, width), 1
        if is_whole.any():
            decimals = np.where(is_whole, 0, decimals.reshape(values.shape)).astype(np.uint8)
        rows = np.ascontiguousarray(values).reshape(-1, width)
        flags = np.ascontiguousarray(is_changed).reshape(-1, width)
        decimals = decimals.reshape(-1)
        if width == 1 and not (starts[1:] > starts[:-1]).all():
            # The file has the columns in another order.
            order = np.argsort(starts, kind="stable")
            starts, rows, flags, decimals = (
                starts[order],
                rows[order],
                flags[order],
                decimals[order],
            )
        return Patch(starts, rows, flags, decimals)


def parse_floats(data: Bytes, starts: Longs, stops: Longs) -> Floats:
    """The values (q,) of words; FormatError with the line of one that is no number."""
    from msal_cli.kernels.text import read_numbers

    values, bad = read_numbers(data, starts, stops)
    if bad >= 0:
        at = int(starts[bad])
        word = data[at : stops[bad]].tobytes()
        raise FormatError(
            f"{word[:40].decode('ascii', 'backslashreplace')!r} is not a number",
            where=f"line {line_of(data, at)}",
            hint=number_hint(word),
        )
    return values


def number_hint(word: bytes, otherwise: str = EXPORT_AGAIN) -> str:
    """What to do about a word that is no number: it may have the comma of another language, or
    one that separates it from the next."""
    if word.endswith(b","):
        return "numbers are separated by blanks, not by commas"
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
"""Runs of one kind that are replaced or compared at a time."""


@dataclass(eq=False)
class Statements(TextSlots):
    """Runs of three numbers that keep the decimals of their own lines."""

    def own_decimals(self, values: Floats) -> Bytes | None:
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
    """Runs of numbers at bytes ``at`` (q,), their new ``values`` (q, width), which of these
    ``is_changed``, and the ``decimals`` (q,) of each run's."""

    at: Longs
    values: Floats
    is_changed: Flags
    decimals: Bytes


def plan_patches(changes: Sequence[Change], *, have_own: bool = True) -> list[Patch]:
    """What is to be written for changes of texts.

    New numbers have the decimals of their own lines where that is possible for all arrays, and
    ``have_own`` is set, else the same ones in each array.
    """
    own = [slots.own_decimals(values) for slots, values, _ in changes]
    has_own = have_own and all(decimals is not None for decimals in own)
    if has_own and len(changes) > 1:
        places = [slots.at for slots, _, _ in changes]
        owners = np.repeat(np.arange(len(places)), [len(at) for at in places])
        turns = np.diff(owners[np.argsort(np.concatenate(places), kind="stable")])
        has_own = 1 + int(np.count_nonzero(turns)) <= MAX_TURNS
    is_single = any(slots.width == 1 or slots.is_whole.any() for slots, _, _ in changes)
    patches = []
    for (slots, values, is_changed), decimals in zip(changes, own, strict=True):
        if decimals is None or not has_own:
            decimals = np.full(len(slots.at), slots.decimals, dtype=np.uint8)
        patches.append(slots.make_patch(values, is_changed, decimals, is_single=is_single))
    return patches


class _Block(NamedTuple):
    """Runs one behind the other: see ``kernels.text.replace``."""

    begins: Longs
    old: Floats
    new: Floats
    decimals: Bytes


def replace_statements(data: Bytes, patches: Sequence[Patch]) -> memoryview:
    """The file with its runs' changed numbers replaced."""
    from msal_cli.kernels.parallel import at_once

    pieces = _cut(data, patches)
    # A piece has room for all that it may become; then the pieces move together.
    places = np.cumsum([0, *[piece.stop - piece.start + piece.room for piece in pieces]]).tolist()
    out = np.empty(places[-1], dtype=np.uint8)
    tasks = [
        functools.partial(_replace_piece, data, piece, out, place)
        for piece, place in zip(pieces, places, strict=False)
    ]
    ends = at_once(sum(len(patch.at) for patch in patches), *tasks)
    if None in ends:
        # A run goes on behind a cut.
        ends = [_replace_piece(data, _whole(data, patches), out, 0)]
    view, size = out.data, ends[0]
    for place, end in zip(places[1:], ends[1:], strict=False):
        # Bytes that overlap are moved as they should be.
        view[size : size + end - place] = view[place:end]
        size += end - place
    return view[:size]


def _replace_piece(data: Bytes, piece: _Piece, out: Bytes, to: int) -> int | None:
    """Write a piece to ``out`` from byte ``to`` on; returns its end, or None where a number that
    is replaced lies behind the piece."""
    from msal_cli.kernels.text import format_shortest, replace

    done = piece.start
    for block in _blocks(piece.patches):
        row = axis = 0
        while True:
            done, to, row, axis = replace(data, done, out, to, row, axis, *block)
            if row == len(block.begins):
                break
            text = format_shortest(float(block.new[row, axis]), False).encode()
            out[to : to + len(text)] = np.frombuffer(text, dtype=np.uint8)
            to, axis = to + len(text), axis + 1
    if done > piece.stop:
        return None
    end = to + piece.stop - done
    out[to:end] = data[done : piece.stop]
    return end


def require_replaced(data: Bytes, result: Bytes, patches: Sequence[Patch]) -> None:
    """Raise InternalError unless ``result`` is the file with just that replaced."""
    from msal_cli.kernels.parallel import at_once

    pieces = _cut(data, patches)
    # No number has a line end, so that a line of the result is the same line of the file.
    places = [0]
    for piece in pieces[:-1]:
        places.append(_skip_lines(result, places[-1], _count_lines(data[piece.start : piece.stop])))
    places.append(len(result))
    tasks = [
        functools.partial(_find_fault, data, piece, result[:stop], start)
        for piece, (start, stop) in zip(pieces, itertools.pairwise(places), strict=True)
    ]
    faults = at_once(sum(len(patch.at) for patch in patches), *tasks)
    if len(pieces) > 1 and any(faults):
        # Or a run goes on behind a cut; without cuts it is known.
        faults = [_find_fault(data, _whole(data, patches), result, 0)]
    for fault in faults:
        if fault is not None:
            raise fault


def _find_fault(data: Bytes, piece: _Piece, result: Bytes, start: int) -> InternalError | None:
    """What is wrong with ``result`` from byte ``start`` on, where a piece should be."""
    from msal_cli.kernels import text

    tolerances = np.append(0.5 * 10.0 ** -np.arange(18.0) * (1.0 + 1e-9), 0.0)
    more = "the output differs from the input in more than positions and normals"
    done, result_done = piece.start, start
    for block in _blocks(piece.patches):
        row = axis = 0
        status = text.ASIDE
        while status == text.ASIDE:
            status, done, result_done, row, axis = text.compare(
                data, done, result, result_done, row, axis, *block, tolerances
            )
            if status == text.ASIDE:
                token = _NUMBER.findall(result[result_done : result_done + 64].tobytes())[0]
                expected = float(block.new[row, axis])
                slack = tolerances[block.decimals[row]] + 4.5e-16 * abs(expected)
                if not abs(float(token) - expected) <= slack:
                    status = text.WRONG_VALUE
                result_done, axis = result_done + len(token), axis + 1
        where = f"near byte {done}"
        if status == text.WRONG_VALUE:
            return InternalError("the output holds another number than it should", where=where)
        if status == text.DIFFERENT:
            return InternalError(more, where=where)
    if done > piece.stop or not is_same(data[done : piece.stop], result[result_done:]):
        return InternalError(more)
    return None


class _Piece(NamedTuple):
    """Bytes of a file from ``start`` to ``stop``, and the patches of the runs that begin there."""

    start: int
    stop: int
    patches: list[Patch]

    @property
    def room(self) -> int:
        """Most bytes that new numbers take, and those that are written beyond an end."""
        from msal_cli.kernels.text import fixed_width

        room = 8
        for _, values, _, decimals in self.patches:
            largest = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
            room += values.size * fixed_width(largest, int(decimals.max(initial=0)))
        return room


def _whole(data: Bytes, patches: Sequence[Patch]) -> _Piece:
    return _Piece(0, len(data), list(patches))


def _cut(data: Bytes, patches: Sequence[Patch]) -> list[_Piece]:
    """The file in pieces of whole lines, one for each thread; one where it has few runs."""
    from msal_cli.kernels.parallel import is_worth_it, threads

    if not is_worth_it(sum(len(patch.at) for patch in patches)):
        return [_whole(data, patches)]
    longest = max((patch.at for patch in patches), key=len)
    cuts = [0]
    for part in range(1, threads()):
        begin = int(longest[len(longest) * part // threads()])
        first = max(begin - MAX_LINE, cuts[-1])
        line = data[first:begin].tobytes().rfind(b"\n") + 1
        if line:
            cuts.append(first + line)
    pieces = []
    for start, stop in itertools.pairwise([*cuts, len(data)]):
        rows = [slice(*np.searchsorted(patch.at, (start, stop))) for patch in patches]
        own = [
            Patch(at[some], values[some], is_changed[some], decimals[some])
            for (at, values, is_changed, decimals), some in zip(patches, rows, strict=True)
        ]
        pieces.append(_Piece(start, stop, own))
    return pieces


MAX_LINE = 4096
"""Bytes before a run in which a line end is looked for."""

_LINES = 1 << 20
"""Bytes in which line ends are counted at a time."""


def _count_lines(text: Bytes) -> int:
    return sum(
        int(np.count_nonzero(text[at : at + _LINES] == 10)) for at in range(0, len(text), _LINES)
    )


def _skip_lines(text: Bytes, at: int, n_lines: int) -> int:
    """The byte behind so many line ends from ``at`` on; the end of the text where it has fewer."""
    for begin in range(at, len(text), _LINES):
        ends = np.flatnonzero(text[begin : begin + _LINES] == 10)
        if len(ends) >= n_lines:
            return begin + int(ends[n_lines - 1]) + 1 if n_lines else begin
        n_lines -= len(ends)
    return len(text)


def _blocks(patches: Sequence[Patch]) -> Iterator[_Block]:
    """The runs in the order of the file, a block at a time."""
    patches = sorted((p for p in patches if len(p.at)), key=lambda patch: int(patch.at[0]))
    if any(second.at[0] < first.at[-1] for first, second in itertools.pairwise(patches)):
        # Their runs take turns.
        order = np.argsort(np.concatenate([patch.at for patch in patches]), kind="stable")
        patches = [Patch(*(np.concatenate(part)[order] for part in zip(*patches, strict=True)))]
    for at, values, is_changed, decimals in patches:
        for first in range(0, len(at), _ROWS):
            rows = slice(first, first + _ROWS)
            # Zeros, since a stored number that is none would differ from itself.
            new = np.where(is_changed[rows], values[rows], 0.0)
            old = np.where(is_changed[rows], np.nan, 0.0)
            yield _Block(at[rows], old, new, decimals[rows])


Span = tuple[int, int]
"""The place of a piece of text: its first character, and the one behind its last."""


def replace_spans(text: AnyStr, edits: Iterable[tuple[Span, AnyStr]]) -> AnyStr:
    """``text`` with other text at some places."""
    pieces: list[AnyStr] = []
    done = 0
    for (start, stop), new in sorted(edits):
        pieces += [text[done:start], new]
        done = stop
    pieces.append(text[done:])
    return text[:0].join(pieces)


_Slots = TypeVar("_Slots", bound=TextSlots)


class Words:
    """The words of ``data[start:stop]``, comments left out: ``starts`` and ``stops`` (q,) in
    ``data``, and ``lines`` (q,), ascending, equal for words of one line."""

    def __init__(
        self, data: Buffer | Bytes, start: int = 0, stop: int | None = None, *, comment: bytes = b""
    ) -> None:
        from msal_cli.kernels.text import as_bytes, find_words

        self.data = as_bytes(data)
        stop = len(self.data) if stop is None else stop
        sign = comment[0] if comment else -1
        count = find_words(self.data, start, stop, sign, _NONE, _NONE, _NONE)
        self.starts, self.stops, self.lines = (np.empty(count, dtype=np.int64) for _ in range(3))
        find_words(self.data, start, stop, sign, self.starts, self.stops, self.lines)

    def __len__(self) -> int:
        return len(self.starts)

    def word(self, i: int) -> bytes:
        return self.data[int(self.starts[i]) : int(self.stops[i])].tobytes()

    def where(self, i: int) -> str:
        """The line of a word, or of the end for one behind the last."""
        at = int(self.starts[i]) if i < len(self) else len(self.data)
        return f"line {line_of(self.data, at)}"

    def require(self, stop: int, what: str) -> None:
        """Raise TruncatedError unless there are ``stop`` words."""
        if stop > len(self):
            raise cut_short(f"the file ends before all {what} are there", self.where(len(self)))

    def count(self, i: int, what: str) -> int:
        """The word as a number of things, at least 0."""
        self.require(i + 1, what)
        word = self.word(i)
        if not word.isdigit() or len(word) > 18:
            shown = word[:40].decode("ascii", "backslashreplace")
            raise damaged(f"{shown!r} is not the number of {what}", self.where(i))
        return int(word)

    def integers(self, chosen: slice | Longs) -> Longs:
        """Whole numbers; FormatError for a word that is none."""
        starts = self.starts[chosen]
        values = parse_floats(self.data, starts, self.stops[chosen])
        wrong = ~(np.abs(values) < 2.0**53) | (values != np.rint(values))
        if wrong.any():
            at = int(starts[int(np.argmax(wrong))])
            raise damaged("a whole number is expected", f"line {line_of(self.data, at)}")
        return values.astype(np.int64)

    def float_rows(self, first: Longs, kind: type[_Slots], **more: Any) -> _Slots:
        """Rows of three numbers, ``first`` (n,) being the first word of each; ``more`` are other
        fields of the ``kind`` of slots."""
        chosen = (first[:, None] + np.arange(3)).reshape(-1)
        values = parse_floats(self.data, self.starts[chosen], self.stops[chosen]).reshape(-1, 3)
        return kind(self.data, self.starts[first], values=values, **more)


_NONE, _NO_BYTES = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint8)


def require_indices(
    indices: Longs, count: int, where: Callable[[int], str] = "corner {} of all faces".format
) -> None:
    """Raise ContentError (``E_INDEX``) for an index that is not from 0 to ``count`` - 1; ``where``
    says where one is, by its number."""
    wrong = (indices < 0) | (indices >= count)
    if wrong.any():
        first = int(np.argmax(wrong))
        message = f"a face names vertex {indices[first]} of {format_count(count, 'vertex')}"
        raise bad_index(message, where(first))
