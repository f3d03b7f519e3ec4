"""Numbers in text: finding words, choosing the digits of new numbers, and replacing old ones.

In nearly all text meshes three numbers follow one another.  Then no place is stored per number, and
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

SHORTEST = 18  # instead of a number of decimals: the shortest text that is read as the same double
NORMAL_DECIMALS = 6  # least decimals of a recomputed unit normal
SIGNIFICANT_DIGITS = 15  # decimal digits that float64 can always keep

_NUMBER = re.compile(rb"[^\s\"'\\]*")


def usual_decimals(used: Bytes) -> int:
    """The fewest decimals that all but one in a hundred of ``used`` (n,) do not exceed.

    A few numbers that some program wrote with all 17 digits do not matter.
    """
    n_above = len(used) - np.cumsum(np.bincount(used, minlength=1))
    return int(np.argmax(n_above * 100 <= len(used)))


def extent_decimals(vertices: Floats) -> int | None:
    """Decimals for a step of 1e-7 of the bounding box's diagonal; less than 0 for a large box, None
    if all positions (n, 3) are the same."""
    # Column by column: numpy reduces the first of two axes slowly.  Halves cannot overflow.
    halves = [float(column.max() * 0.5 - column.min() * 0.5) for column in vertices.T]
    step = min(2.0 * math.hypot(*halves), 1e300) * 1e-7
    return math.ceil(-math.log10(step)) if step > 0.0 else None


@dataclass(eq=False)
class TextSlots(Slots):
    """Numbers in text, in runs: the three of a row with blanks between them, or each number by
    itself."""

    data: Bytes  # (size,) uint8, the file
    at: Longs  # (q,) int64, ascending, first byte of each run, or of the keyword before it
    _: KW_ONLY
    values: Floats  # (n, k) float64
    skipped: int = 0  # bytes of the keyword
    unit_length: bool = False  # the numbers are normals
    # most digits of a number; if the file needs more, the shortest text is written
    significant: float = SIGNIFICANT_DIGITS
    codes: tuple[str, ...] = ()
    whole_rows: bool = False

    @property
    def width(self) -> int:
        """Numbers in a run: those of a row, or 1."""
        return self.values.size // max(len(self.at), 1)

    @functools.cached_property
    def used(self) -> Bytes:
        """The most decimals of the numbers in each run (q,)."""
        from msal_cli.kernels.text import find_numbers

        used = np.empty(len(self.at), dtype=np.uint8)
        find_numbers(self.data, self.at + self.skipped, self.width, _NONE, used)
        return used

    @functools.cached_property
    def decimals(self) -> int:
        """Decimals of new numbers: the usual ones, or as many as 1e-7 of the extent needs,
        whichever is more; ``SHORTEST`` if these and the digits before the point exceed
        ``significant``, or if the extent is 0."""
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
        """Decimals (q,) for new ``values`` (n, k) if each run keeps its own; else None."""
        return None

    @property
    def is_whole(self) -> Flags:
        """Which columns are whole numbers."""
        return np.array([code[-2] in "iu" for code in self.codes], dtype=bool)

    def rounded(self, values: Floats) -> Floats:
        is_whole = self.is_whole
        return np.where(is_whole, np.rint(values), values) if is_whole.any() else values

    def make_patch(
        self, values: Floats, is_changed: Flags, decimals: Bytes, *, is_single: bool = False
    ) -> Patch:
        """The patch for new ``values`` (n, k) where they changed, with ``decimals`` (q,); with a
        run for each number if ``is_single``."""
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
            # The columns are in another order in the file.
            order = np.argsort(starts, kind="stable")
            return Patch(starts[order], rows[order], flags[order], decimals[order])
        return Patch(starts, rows, flags, decimals)


def number_hint(word: bytes, otherwise: str = EXPORT_AGAIN) -> str:
    """The hint for a word that is not a number: it may have a decimal comma, or a comma that
    separates it from the next."""
    if word.endswith(b","):
        return "numbers are separated by blanks, not by commas"
    return "numbers need a decimal point, not a comma" if b"," in word else otherwise


def line_of(data: Buffer | Bytes, at: int) -> int:
    """The line, from 1, of byte ``at``; lines may end with LF, CR LF or CR."""
    from msal_cli.kernels.text import as_bytes

    before = as_bytes(data)[:at].tobytes()
    # If ``at`` is within a CR LF, its CR has been counted.
    return 1 + before.count(b"\n") + before.count(b"\r") - before.count(b"\r\n")


MAX_TURNS = 4096
"""If the order of a file alternates more often between positions and normals, all new numbers have
the same decimals."""

_ROWS = 1 << 16  # runs of an array that are replaced or compared at a time


@dataclass(eq=False)
class Statements(TextSlots):
    """Runs of three numbers that keep the decimals of their own lines."""

    def own_decimals(self, values: Floats) -> Bytes | None:
        """Decimals (n,) for new ``values`` (n, 3): those of the line, and at least those of the
        file, but no more than float64 can distinguish, about 15 digits in all; for normals those
        of the file.  None if the file has more than that."""
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
    ``is_changed``, and the ``decimals`` (q,) of each run."""

    at: Longs
    values: Floats
    is_changed: Flags
    decimals: Bytes


def plan_patches(changes: Sequence[Change], *, have_own: bool = True) -> list[Patch]:
    """The patches for changes of text.

    New numbers have the decimals of their own lines if that is possible for all arrays and
    ``have_own`` is set; else all numbers of an array have the same.
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
    """Consecutive runs: see ``kernels.text.replace``."""

    begins: Longs
    old: Floats
    new: Floats
    decimals: Bytes


def replace_statements(data: Bytes, patches: Sequence[Patch]) -> memoryview:
    """The file with the changed numbers of its runs replaced."""
    from msal_cli.kernels.parallel import at_once

    pieces = _cut(data, patches)
    # Each piece has room for its longest result; then the pieces are moved together.
    places = np.cumsum([0, *[piece.stop - piece.start + piece.room for piece in pieces]]).tolist()
    out = np.empty(places[-1], dtype=np.uint8)
    tasks = [
        functools.partial(_replace_piece, data, piece, out, place)
        for piece, place in zip(pieces, places, strict=False)
    ]
    ends = at_once(sum(len(patch.at) for patch in patches), *tasks)
    if None in ends:
        # A run extends beyond a cut.
        ends = [_replace_piece(data, _whole(data, patches), out, 0)]
    view, size = out.data, ends[0]
    for place, end in zip(places[1:], ends[1:], strict=False):
        # memoryview moves overlapping bytes correctly.
        view[size : size + end - place] = view[place:end]
        size += end - place
    return view[:size]


def _replace_piece(data: Bytes, piece: _Piece, out: Bytes, to: int) -> int | None:
    """Write a piece to ``out`` from byte ``to`` on; returns its end, or None if a replaced number
    extends beyond the piece."""
    from msal_cli.kernels.text import replace

    done = piece.start
    for block in _blocks(piece.patches):
        row = axis = 0
        while True:
            done, to, row, axis = replace(data, done, out, to, row, axis, *block)
            if row == len(block.begins):
                break
            text = repr(float(block.new[row, axis])).encode()
            out[to : to + len(text)] = np.frombuffer(text, dtype=np.uint8)
            to, axis = to + len(text), axis + 1
    if done > piece.stop:
        return None
    end = to + piece.stop - done
    out[to:end] = data[done : piece.stop]
    return end


def require_replaced(data: Bytes, result: Bytes, patches: Sequence[Patch]) -> None:
    """Raise InternalError unless ``result`` is the file with only these runs replaced."""
    from msal_cli.kernels.parallel import at_once

    pieces = _cut(data, patches)
    # Numbers contain no line ends, so lines of the result and of the file correspond.
    places = [0]
    for piece in pieces[:-1]:
        places.append(skip_lines(result, places[-1], _count_lines(data[piece.start : piece.stop])))
    places.append(len(result))
    tasks = [
        functools.partial(_find_fault, data, piece, result[:stop], start)
        for piece, (start, stop) in zip(pieces, itertools.pairwise(places), strict=True)
    ]
    faults = at_once(sum(len(patch.at) for patch in patches), *tasks)
    if len(pieces) > 1 and any(faults):
        # A run may extend beyond a cut: compare without cuts.
        faults = [_find_fault(data, _whole(data, patches), result, 0)]
    for fault in faults:
        if fault is not None:
            raise fault


def _find_fault(data: Bytes, piece: _Piece, result: Bytes, start: int) -> InternalError | None:
    """The error in ``result`` from byte ``start`` on, compared with a piece; None if right."""
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
    """Bytes of a file from ``start`` to ``stop``, and the patches of runs that begin there."""

    start: int
    stop: int
    patches: list[Patch]

    @property
    def room(self) -> int:
        """The most bytes of new numbers, and of those that are written beyond an end."""
        from msal_cli.kernels.text import fixed_width

        room = 8
        for _, values, _, decimals in self.patches:
            largest = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
            room += values.size * fixed_width(largest, int(decimals.max(initial=0)))
        return room


def _whole(data: Bytes, patches: Sequence[Patch]) -> _Piece:
    return _Piece(0, len(data), list(patches))


def _cut(data: Bytes, patches: Sequence[Patch]) -> list[_Piece]:
    """The file in pieces of whole lines, one per thread; a single piece if it has few runs."""
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


MAX_LINE = 4096  # bytes before a run in which a line end is searched
_LINES = 1 << 20  # bytes in which line ends are counted at a time


def _count_lines(text: Bytes) -> int:
    return sum(
        int(np.count_nonzero(text[at : at + _LINES] == 10)) for at in range(0, len(text), _LINES)
    )


def skip_lines(text: Bytes, at: int, n_lines: int) -> int:
    """The byte after ``n_lines`` line ends from ``at`` on; the end of the text if it has fewer."""
    for begin in range(at, len(text), _LINES):
        ends = np.flatnonzero(text[begin : begin + _LINES] == 10)
        if len(ends) >= n_lines:
            return begin + int(ends[n_lines - 1]) + 1 if n_lines else begin
        n_lines -= len(ends)
    return len(text)


def _blocks(patches: Sequence[Patch]) -> Iterator[_Block]:
    """The runs in the order of the file, in blocks."""
    patches = sorted((p for p in patches if len(p.at)), key=lambda patch: int(patch.at[0]))
    if any(second.at[0] < first.at[-1] for first, second in itertools.pairwise(patches)):
        # Runs of several arrays alternate.
        order = np.argsort(np.concatenate([patch.at for patch in patches]), kind="stable")
        patches = [Patch(*(np.concatenate(part)[order] for part in zip(*patches, strict=True)))]
    for at, values, is_changed, decimals in patches:
        for first in range(0, len(at), _ROWS):
            rows = slice(first, first + _ROWS)
            # Zeros, because a stored NaN would differ from itself.
            new = np.where(is_changed[rows], values[rows], 0.0)
            old = np.where(is_changed[rows], np.nan, 0.0)
            yield _Block(at[rows], old, new, decimals[rows])


Span = tuple[int, int]
"""The place of a piece of text: its first character, and the one after its last."""


def replace_spans(text: AnyStr, edits: Iterable[tuple[Span, AnyStr]]) -> AnyStr:
    """``text`` with the text at some places replaced."""
    pieces: list[AnyStr] = []
    done = 0
    for (start, stop), new in sorted(edits):
        pieces += [text[done:start], new]
        done = stop
    pieces.append(text[done:])
    return text[:0].join(pieces)


_Slots = TypeVar("_Slots", bound=TextSlots)


_BLOCK = 1 << 20  # bytes that are searched at a time, so that they stay in the cache


def has_comments(data: Buffer) -> bool:
    """Whether a ``#`` begins a word."""
    codes = np.frombuffer(data, dtype=np.uint8)
    for start in range(0, len(codes), _BLOCK):
        places = np.flatnonzero(codes[start : start + _BLOCK] == ord("#")) + start
        if ((codes[places - 1] <= ord(" ")) | (places == 0)).any():
            return True
    return False


class Words:
    """The words of ``data[start:stop]`` without comments: ``starts`` and ``stops`` (q,) in
    ``data``, and ``lines`` (q,), ascending, equal for words on one line."""

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
        """The line of a word; for an index after the last word, the line of the end."""
        at = int(self.starts[i]) if i < len(self) else len(self.data)
        return f"line {line_of(self.data, at)}"

    def require(self, stop: int, what: str) -> None:
        """Raise TruncatedError unless there are ``stop`` words."""
        if stop > len(self):
            raise cut_short(f"the file ends before all {what} are there", self.where(len(self)))

    def count(self, i: int, what: str) -> int:
        """A word as a count, at least 0; ``what`` names the things that it counts."""
        self.require(i + 1, what)
        word = self.word(i)
        if not word.isdigit() or len(word) > 18:
            shown = word[:40].decode("ascii", "backslashreplace")
            raise damaged(f"{shown!r} is not the number of {what}", self.where(i))
        return int(word)

    def floats(self, chosen: slice | Longs) -> Floats:
        """The values (q,) of words; FormatError, with the line, for one that is not a number."""
        from msal_cli.kernels.text import read_numbers

        values, bad = read_numbers(self.data, self.starts[chosen], self.stops[chosen])
        if bad >= 0:
            i = np.arange(len(self))[chosen][bad]
            word = self.word(i)
            shown = word[:40].decode("ascii", "backslashreplace")
            raise FormatError(
                f"{shown!r} is not a number", where=self.where(i), hint=number_hint(word)
            )
        return values

    def integers(self, chosen: slice | Longs) -> Longs:
        """Words as whole numbers; FormatError for a word that is not one."""
        values = self.floats(chosen)
        wrong = ~(np.abs(values) < 2.0**53) | (values != np.rint(values))
        if wrong.any():
            first = np.arange(len(self))[chosen][int(np.argmax(wrong))]
            raise damaged("a whole number is expected", self.where(first))
        return values.astype(np.int64)

    def float_rows(self, first: Longs, kind: type[_Slots], **more: Any) -> _Slots:
        """Rows of three numbers; ``first`` (n,) are the indices of their first words, ``more``
        other fields of the ``kind`` of slots."""
        chosen = (first[:, None] + np.arange(3)).reshape(-1)
        values = self.floats(chosen).reshape(-1, 3)
        return kind(self.data, self.starts[first], values=values, **more)


_NONE, _NO_BYTES = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.uint8)


def require_indices(
    indices: Longs, count: int, where: Callable[[int], str] = "corner {} of all faces".format
) -> None:
    """Raise ContentError (``E_INDEX``) for an index outside 0 to ``count`` - 1; ``where`` gives the
    place of an index by its number."""
    wrong = (indices < 0) | (indices >= count)
    if wrong.any():
        first = int(np.argmax(wrong))
        message = f"a face names vertex {indices[first]} of {format_count(count, 'vertex')}"
        raise bad_index(message, where(first))
