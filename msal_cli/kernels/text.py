"""Exact conversion between decimal text and numbers, for the text forms of mesh files.

A *token* is a run of bytes ``buf[start:stop]``; lists of tokens are two (k,) int64 arrays,
ascending and disjoint.  ``buf`` is a (size,) uint8 array; ``as_bytes`` makes one that has the type
for all kernels here.  All values are exact: see ``numbers``.
"""

from collections.abc import Sequence

import numpy as np

from msal_cli.arrays import Bytes, Floats, Longs
from msal_cli.kernels.library import compiled
from msal_cli.kernels.numbers import (
    EXACT,
    FIXED_BELOW,
    MAX_DECIMALS,
    MAX_SHORTEST_WIDTH,
    NOT_A_NUMBER,
    SHORTEST,
    SHORTEST_SINGLE,
    UNDECIDED,
    count_before,
    count_digits,
    load_eight,
    parse_digits,
    read_number,
    store_eight,
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
    """A signed integer: its value, its end (``at`` without digits), whether it fits int64."""
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
    """The int64 value of a whole token and its status; UNDECIDED if it does not fit."""
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
    """The values (k,) of k tokens, correctly rounded, and the first that is not a number, or -1.

    Numbers have a sign, digits, point, exponent (e or E), or are ``nan`` or ``inf`` in any case.
    After a token that is not a number the values are undefined.
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
    """Find the words of ``buf[start:stop]``; a byte ``comment`` (-1 for none) begins a comment.

    starts, stops, lines (q,) int64 : receive the positions of the first q words, and the numbers of
        their lines.  Returns the number of words.
    """
    n_words = line = 0
    at = start
    while at < stop:
        c = buf[np.uint64(at)]
        if c == 32 or 9 <= c <= 13:
            line += c == 10 or c == 13
            at += 1
        elif c == comment:
            while at < stop and not is_line_end(buf, at):
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
    """Largest number of bytes that ``print_numbers`` needs for a number up to ``largest``."""
    if decimals > MAX_DECIMALS:
        return MAX_SHORTEST_WIDTH
    if largest < FIXED_BELOW:
        return len(str(int(largest))) + decimals + 3
    return max(decimals + 22, MAX_SHORTEST_WIDTH)


def print_numbers(values: Floats, decimals: int) -> tuple[Bytes, Longs]:
    """Text of k numbers: fixed-point with ``decimals`` (0 to 17) digits after the point, or the
    shortest that is read back as the same number (SHORTEST) or the same float32 (SHORTEST_SINGLE).

    Returns the concatenated texts, (size,) uint8, and where each ends, (k,) int64. Correctly
    rounded from the double, so the same on every machine; ``-0.000`` is printed ``0.000``.  A
    fixed-point number of magnitude 2**63 or more, or one that is not finite, is printed as by
    ``repr``.
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
        number = np.float32(values[done]) if decimals == SHORTEST_SINGLE else values[done]
        text = str(number).encode()
        out[at : at + len(text)] = np.frombuffer(text, dtype=np.uint8)
        at = stops[done] = at + len(text)
        done, at = _print_numbers(values, done + 1, decimals, out, at, stops)
    return out[:at], stops


def print_shortest(values: Floats, single: bool) -> tuple[Bytes, Longs]:
    """``print_numbers`` with SHORTEST_SINGLE or SHORTEST."""
    return print_numbers(values, SHORTEST_SINGLE if single else SHORTEST)


# Tokens


@compiled
def skip_blanks(buf, at):
    """The first byte from ``at`` on that is not a blank, tab, vertical tab or form feed."""
    while at < len(buf):
        c = buf[np.uint64(at)]
        if c != 32 and c != 9 and c != 11 and c != 12:
            break
        at += 1
    return at


@compiled
def is_token_end(buf, at):
    """Whether a token ends before ``at``: the next byte is a blank or a line end."""
    return at >= len(buf) or buf[np.uint64(at)] == 32 or 9 <= buf[np.uint64(at)] <= 13


@compiled
def skip_token(buf, at):
    """The end of the token at ``at``: the next blank or line end, or ``at`` itself."""
    while not is_token_end(buf, at):
        at += 1
    return at


@compiled
def read_short_integer(data, at):
    """The integer of at most nine digits at ``at``, and its digits; 0 for other tokens."""
    word = load_eight(data, at)
    digits = count_digits(word)
    if digits == 0:
        return 0, 0
    value = parse_digits(word, digits)
    if digits == 8 and at + 8 < len(data) and 48 <= data[np.uint64(at + 8)] <= 57:
        value = 10 * value + np.int64(data[np.uint64(at + 8)]) - 48
        digits = 9
    if not is_token_end(data, at + digits):
        return 0, 0
    return value, digits


@compiled
def is_line_end(buf, at):
    """Whether the line ends at ``at``."""
    return at >= len(buf) or buf[np.uint64(at)] == 10 or buf[np.uint64(at)] == 13


@compiled
def skip_line(buf, at):
    """The end of the line."""
    while not is_line_end(buf, at):
        at += 1
    return at


# Rows of tokens


@compiled
def append_bytes(source, start, stop, target, at):
    """Copy source[start:stop] to target at ``at``; returns the end.

    Up to seven bytes after the end may be overwritten.
    """
    end = at + stop - start
    while at < end:
        store_eight(target, at, load_eight(source, start))
        start += 8
        at += 8
    return end


@compiled
def _fill_rows(pieces, ends, which, text, stops, is_doubled, out):
    at = start = 0
    is_first = True
    for i in range(len(stops)):
        if is_first:
            at = append_bytes(pieces, 0, ends[0], out, at)
        at = append_bytes(text, start, stops[i], out, at)
        if is_doubled:
            at = append_bytes(pieces, ends[0], ends[1], out, at)
            at = append_bytes(text, start, stops[i], out, at)
        start, k = stops[i], np.int64(which[i])
        at = append_bytes(pieces, ends[k - 1], ends[k], out, at)
        is_first = k == len(ends) - 1


def fill_rows(
    pieces: Sequence[bytes],
    text: Bytes,
    stops: Longs,
    which: Bytes | None = None,
    is_doubled: bool = False,
) -> memoryview:
    """Rows of tokens between ``pieces``, the first of which begins each row, and the last ends it.

    Parameters
    ----------
    text, stops : (size,) and (k,), the tokens of all rows, as of ``print_numbers``.
    which : (k,), the piece after each token; None for all pieces in each row.
    is_doubled : write each token twice, with the second piece between.
    """
    if which is None:
        once = np.arange(1, len(pieces), dtype=np.uint8)
        which = np.tile(once, len(stops) // len(once))
    sizes, counts = np.array(list(map(len, pieces))), np.bincount(which, minlength=len(pieces))
    counts[0] = counts[-1]
    size = len(text) + int((counts * sizes).sum())
    size += is_doubled * (len(text) + len(stops) * len(pieces[1]))
    out = np.empty(size, dtype=np.uint8)
    separators = as_bytes(b"".join(pieces)), np.cumsum(sizes)
    _fill_rows(*separators, which, as_bytes(text), stops, is_doubled, out)
    return out.data


# Numbers replaced inside a text
#
# A *run* is some consecutive numbers separated by blanks, such as the position of a vertex.

(
    DONE,  # all runs are processed
    DIFFERENT,  # a byte differs that must be equal
    WRONG_VALUE,  # a number is not the expected one
    ASIDE,  # Python has to write or read one number; the pass continues after it
) = range(4)


@compiled
def _skip_to_number(buf, at):
    """The next byte that is not a blank; in an OBJ file a continued line goes on after its end."""
    while at < len(buf):
        c = buf[np.uint64(at)]
        if c > 32 and c != 92:
            break
        # Only a backslash can precede the end of a line here.
        at += 1
    return at


@compiled
def _skip_number(buf, at):
    """The end of the number at ``at``: a blank, the end of a line, a quote or a backslash."""
    while at < len(buf):
        word = load_eight(buf, at)
        slashes = word ^ np.uint64(0x5C5C5C5C5C5C5C5C)
        # Bytes below 43, the plus sign, are not part of a number.
        found = (word - np.uint64(0x2B2B2B2B2B2B2B2B)) & ~word
        found |= (slashes - np.uint64(0x0101010101010101)) & ~slashes
        found &= np.uint64(0x8080808080808080)
        if found != 0:
            return min(at + count_before(found), len(buf))
        at += 8
    return len(buf)


@compiled
def find_numbers(buf, begins, width, starts, used):
    """Where each number of the runs that begin at ``begins`` (q,) begins, (q * width,), and the
    largest number of decimals (q,) of each run, at most 255; ``1.5e-3`` has four.  Either may be
    empty."""
    for i in range(len(begins)):
        end = begins[i]
        most = np.int64(0)
        for axis in range(width):
            start = _skip_to_number(buf, end)
            end = _skip_number(buf, start)
            if len(starts):
                starts[width * i + axis] = start
            if len(used):
                _, _, _, decimals = read_number(buf, start, end)
                most = max(most, min(decimals, np.int64(255)))
        if len(used):
            used[i] = most


@compiled
def _is_kept(old, new, i):
    is_kept = True
    for axis in range(new.shape[1]):
        is_kept = is_kept and new[i, axis] == old[i, axis]
    return is_kept


@compiled
def replace(buf, done, out, to, first, first_axis, begins, old, new, decimals):
    """Copy ``buf`` from byte ``done`` to ``out`` from byte ``to``, with numbers replaced.

    Parameters
    ----------
    buf : (size,) uint8, the file.
    out : uint8, with room for the result and eight bytes more.
    first, first_axis : the run and the number in it to begin with.
    begins : (n,) int64, ascending, where the runs begin, after their keywords.
    old, new : (n, width) float64; a number is replaced where they differ.
    decimals : (n,) uint8, of new numbers, see ``numbers.write_number``.

    Returns the end of the copied bytes, in both, and the run and the number that Python has to
    write next; (n, 0) if all are written.  The rest of the file is not copied.
    """
    for i in range(first, len(begins)):
        if _is_kept(old, new, i):
            continue
        start = begins[i]
        if i == first:
            start = max(start, done)
        for axis in range(first_axis if i == first else 0, new.shape[1]):
            start = _skip_to_number(buf, start)
            stop = _skip_number(buf, start)
            if new[i, axis] != old[i, axis]:
                to = append_bytes(buf, done, start, out, to)
                done = stop
                end = write_number(new[i, axis], np.int64(decimals[i]), out, to)
                if end < 0:
                    return done, to, i, axis
                to = end
            start = stop
    return done, to, len(begins), 0


@compiled
def compare(a, a_done, b, b_done, first, first_axis, begins, old, new, decimals, tolerances):
    """Whether ``b`` is ``a`` with only numbers of the runs replaced, as expected.

    A number that did not change keeps its bytes; one that did is within ``tolerances[decimals[i]]``
    of its new value, and 2 units in the last place of a double.  Other parameters as in
    ``replace``.  Returns DONE, the error, or ASIDE for the number at ``b_done``; the compared bytes
    of both files; the run and the number in it.
    """
    for i in range(first, len(begins)):
        if _is_kept(old, new, i):
            continue
        start = begins[i]
        if i == first:
            start = max(start, a_done)
        tolerance = tolerances[decimals[i]]
        for axis in range(first_axis if i == first else 0, new.shape[1]):
            start = _skip_to_number(a, start)
            stop = _skip_number(a, start)
            expected = new[i, axis]
            if expected != old[i, axis]:
                count = start - a_done
                if len(b) - b_done < count:
                    return DIFFERENT, a_done, b_done, i, axis
                different = np.uint64(0)
                while count > 8:
                    different |= load_eight(a, a_done) ^ load_eight(b, b_done)
                    a_done += 8
                    b_done += 8
                    count -= 8
                if count > 0:
                    # Shifted to the top, the last bytes are left without those behind them.
                    different |= (load_eight(a, a_done) ^ load_eight(b, b_done)) << np.uint64(
                        64 - 8 * count
                    )
                a_done = stop
                b_done += count
                if different != 0:
                    return DIFFERENT, a_done, b_done, i, axis
                value, status, end, _ = read_number(b, b_done, len(b))
                if status == UNDECIDED:
                    return ASIDE, a_done, b_done, i, axis
                if status == NOT_A_NUMBER or not (
                    abs(value - expected) <= tolerance + 4.5e-16 * abs(expected)
                ):
                    return WRONG_VALUE, a_done, b_done, i, axis
                b_done = end
            start = stop
    return DONE, a_done, b_done, len(begins), 0
