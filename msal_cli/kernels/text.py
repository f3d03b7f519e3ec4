"""Decimal text to numbers and back, exactly, for the text forms of mesh files.

A *token* is a run of bytes ``buf[start:stop]``; lists of tokens are two (k,) int64 arrays,
ascending and disjoint.  ``buf`` is a (size,) uint8 array; ``as_bytes`` makes one that every kernel
here takes without being compiled a second time.  Every value is exact: see ``digits``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Longs
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.numbers import (
    EXACT,
    FIXED_BELOW,
    MAX_DECIMALS,
    MAX_SHORTEST_WIDTH,
    NOT_A_NUMBER,
    SHORTEST,
    SHORTEST_SINGLE,
    UNDECIDED,
    read_number,
    write_number,
)


def as_bytes(buffer: bytes | bytearray | memoryview | Bytes) -> Bytes:
    """A read-only (size,) uint8 view of a buffer, not a copy."""
    if isinstance(buffer, np.ndarray):
        view = buffer.view()
    else:
        view = np.frombuffer(buffer, dtype=np.uint8)
    view.flags.writeable = False
    return view


# Reading


@compiled
def read_integer(buf, at, stop):
    """A signed whole number: its value, where it ends (``at`` without digits), whether it fits."""
    first = at
    negative = False
    if at < stop and (buf[at] == 45 or buf[at] == 43):
        negative = buf[at] == 45
        at += 1
    digits = at
    value = np.int64(0)
    fits = True
    while at < stop:
        digit = np.int64(buf[at]) - 48
        if digit < 0 or digit > 9:
            break
        fits = bool(value <= 922_337_203_685_477_579)
        if fits:
            value = value * 10 + digit
        at += 1
    return -value if negative else value, at if at > digits else first, fits


@compiled
def parse_integer(buf, start, stop):
    """The int64 value of a whole token and its status; UNDECIDED where it does not fit."""
    value, end, fits = read_integer(buf, start, stop)
    if end == start or end < stop:
        return np.int64(0), NOT_A_NUMBER
    return value, EXACT if fits else UNDECIDED


@compiled
def _read_numbers(buf, starts, stops, values, undecided):
    n_undecided = 0
    for i in range(len(starts)):
        value, status, end, _ = read_number(buf, starts[i], stops[i])
        if end != stops[i] or status == NOT_A_NUMBER:
            return i, n_undecided
        values[i] = value
        undecided[i] = status == UNDECIDED
        n_undecided += undecided[i]
    return -1, n_undecided


def read_numbers(buf: Bytes, starts: Longs, stops: Longs) -> tuple[Floats, int]:
    """The values (k,) of k tokens, correctly rounded, and the first that is no number, or -1.

    Numbers have a sign, digits, point, exponent (e or E), or are ``nan`` or ``inf`` in any case.
    Behind a token that is none the values are undefined.
    """
    values = np.empty(len(starts))
    undecided = np.zeros(len(starts), dtype=np.bool_)
    starts, stops = np.ascontiguousarray(starts), np.ascontiguousarray(stops)
    bad, n_undecided = _read_numbers(as_bytes(buf), starts, stops, values, undecided)
    if n_undecided:
        for i in np.flatnonzero(undecided):
            values[i] = float(buf[starts[i] : stops[i]].tobytes())
    return values, int(bad)


@compiled
def find_words(buf, start, stop, comment, starts, stops, lines):
    """Find the words of ``buf[start:stop]``; a byte ``comment`` (-1 for none) hides the rest of its
    line.

    starts, stops, lines (q,) int64 : receive the places of the first q words, and numbers of their
        lines, which ascend.  Returns how many words there are.
    """
    n_words = line = 0
    at = start
    while at < stop:
        c = buf[np.uint64(at)]
        if c == 32 or 9 <= c <= 13:
            line += c == 10 or c == 13
            at += 1
        elif c == comment:
            while at < stop and buf[np.uint64(at)] != 10 and buf[np.uint64(at)] != 13:
                at += 1
        else:
            begin = at
            while at < stop and not (c == 32 or 9 <= c <= 13 or c == comment):
                at += 1
                c = buf[np.uint64(min(at, stop - 1))]
            if n_words < len(starts):
                starts[n_words] = begin
                stops[n_words] = at
                lines[n_words] = line
            n_words += 1
    return n_words


# Writing


@compiled
def _print_numbers(values, first, decimals, out, at, stops):
    for i in range(first, len(values)):
        end = write_number(values[i], decimals, out, at)
        if end < 0:
            return i, at
        stops[i] = at = end
    return len(values), at


def fixed_width(largest: float, decimals: int) -> int:
    """Most bytes that ``print_numbers`` takes for any number up to ``largest``."""
    if decimals > MAX_DECIMALS:
        return MAX_SHORTEST_WIDTH
    if largest < FIXED_BELOW:
        return len(str(int(largest))) + decimals + 3
    return max(decimals + 22, MAX_SHORTEST_WIDTH)


def print_numbers(values: Floats, decimals: int) -> tuple[Bytes, Longs]:
    """Text of k numbers: fixed-point with ``decimals`` (0 to 17) digits behind the point, or the
    shortest that is read back as the same number (SHORTEST) or the same float32 (SHORTEST_SINGLE).

    Returns the texts one behind the other, (size,) uint8, and where each ends, (k,) int64.
    Correctly rounded from the double, so the same on every machine; ``-0.000`` is printed
    ``0.000``.  A fixed-point number of magnitude 2**63 or more, or one that is not finite, is
    printed as Python's ``repr`` does.
    """
    if decimals == SHORTEST_SINGLE:
        with np.errstate(over="ignore"):
            values = np.asarray(values).astype(np.float32)
    values = np.ascontiguousarray(values, dtype=np.float64)
    stops = np.empty(len(values), dtype=np.int64)
    largest = max(float(values.max(initial=0.0)), -float(values.min(initial=0.0)))
    out = np.empty(len(values) * fixed_width(largest, decimals), dtype=np.uint8)
    done, at = _print_numbers(values, 0, decimals, out, 0, stops)
    while done < len(values):
        text = format_shortest(values[done], decimals == SHORTEST_SINGLE).encode()
        out[at : at + len(text)] = np.frombuffer(text, dtype=np.uint8)
        at = stops[done] = at + len(text)
        done, at = _print_numbers(values, done + 1, decimals, out, at, stops)
    return out[:at], stops


def format_shortest(value: float, single: bool) -> str:
    """The shortest decimal that is read back as the same float64 (or float32)."""
    return str(np.float32(value)) if single else repr(float(value))


def print_shortest(values: Floats, single: bool) -> tuple[Bytes, Longs]:
    """``print_numbers`` with SHORTEST_SINGLE or SHORTEST."""
    return print_numbers(values, SHORTEST_SINGLE if single else SHORTEST)


# Tokens


@compiled
def skip_blanks(buf, at):
    """The first byte from ``at`` on that is no blank, tab, vertical tab or form feed."""
    while at < len(buf):
        c = buf[np.uint64(at)]
        if c != 32 and c != 9 and c != 11 and c != 12:
            break
        at += 1
    return at


@compiled
def skip_token(buf, at):
    """The end of the token at ``at``: the next blank or line end, or ``at`` itself."""
    while at < len(buf):
        c = buf[np.uint64(at)]
        if c == 32 or 9 <= c <= 13:
            break
        at += 1
    return at


# Tokens replaced inside a text


@compiled
def _copy(source, start, stop, target, at):
    """Copy source[start:stop] to target at ``at``; returns the end."""
    for k in range(stop - start):
        target[at + k] = source[start + k]
    return at + stop - start


@compiled
def _splice(buf, starts, stops, text, text_stops, out):
    done = at = text_start = 0
    for i in range(len(starts)):
        at = _copy(buf, done, starts[i], out, at)
        at = _copy(text, text_start, text_stops[i], out, at)
        text_start = text_stops[i]
        done = stops[i]
    _copy(buf, done, len(buf), out, at)


def splice(buf: Bytes, starts: Longs, stops: Longs, text: Bytes, text_stops: Longs) -> Bytes:
    """``buf`` with k tokens replaced by k texts that lie one behind the other in ``text``."""
    starts, stops = np.ascontiguousarray(starts), np.ascontiguousarray(stops)
    size = len(buf) - int((stops - starts).sum()) + (int(text_stops[-1]) if len(text_stops) else 0)
    out = np.empty(size, dtype=np.uint8)
    _splice(as_bytes(buf), starts, stops, as_bytes(text), text_stops, out)
    return out


@compiled
def is_same(a, a_start, b, b_start, count):
    """Whether ``count`` bytes of a and b are equal."""
    done = 0
    while done < count:
        # Slices and a plain sum without a branch in the block, so that it becomes vector code.
        size = min(4096, count - done)
        a_block = a[a_start + done : a_start + done + size]
        b_block = b[b_start + done : b_start + done + size]
        different = 0
        for k in range(size):
            different += a_block[k] != b_block[k]
        if different:
            return False
        done += size
    return True


_BLOCK = 1 << 14
"""Rows that are made at a time."""


@compiled
def _format_lines(text, stops, row_stops, prefix, doubled, out):
    to = 0
    start = 0
    token = 0
    for row_stop in row_stops:
        for k in range(len(prefix)):
            out[to] = prefix[k]
            to += 1
        while token < row_stop:
            for copy in range(2 if doubled else 1):
                for k in range(2 * copy):
                    out[to + k] = 47
                to += 2 * copy
                for k in range(start, stops[token]):
                    out[to] = text[k]
                    to += 1
            start = stops[token]
            token += 1
            out[to] = 32 if token < row_stop else 10
            to += 1
    return to


def format_lines(
    text: Bytes,
    stops: NDArray[np.int64],
    row_stops: NDArray[np.int64],
    prefix: bytes = b"",
    doubled: bool = False,
) -> Bytes:
    """One line for each row: ``prefix``, then the row's tokens with a blank between.

    Parameters
    ----------
    text, stops : (size,) and (k,), k tokens one behind the other, as of ``print_numbers``.
    row_stops : (r,), ascending, the tokens up to and with each row; no row is empty.
    doubled : write each token as ``t//t``, as OBJ names a corner with a normal.
    """
    size = len(text) * (2 if doubled else 1) + len(stops) * (3 if doubled else 1)
    out = np.empty(size + len(row_stops) * len(prefix), dtype=np.uint8)
    fixed = np.frombuffer(prefix, dtype=np.uint8)
    return out[: _format_lines(as_bytes(text), stops, row_stops, as_bytes(fixed), doubled, out)]


def fill_rows(
    pieces: Sequence[bytes], text: Bytes, stops: NDArray[np.int64]
) -> Iterator[memoryview]:
    """Rows of tokens between ``pieces``, of which there is one more than tokens in a row.

    ``text`` (size,) and ``stops`` (k,) are the tokens of all rows, as of ``print_numbers``.
    """
    row = b"".join(pieces)
    places = np.cumsum([len(piece) for piece in pieces[:-1]])
    begin = 0
    for first in range(0, len(stops), _BLOCK * len(places)):
        ends = stops[first : first + _BLOCK * len(places)]
        count = len(ends) // len(places)
        at = (len(row) * np.arange(count)[:, None] + places).reshape(-1)
        tokens = text[begin : ends[-1]]
        yield splice(as_bytes(row * count), at, at, tokens, ends - begin).data
        begin = int(ends[-1])
