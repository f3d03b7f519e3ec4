"""Walks over the bytes of a text file that put new numbers in, or look whether others did.

A *statement* is three numbers one behind the other, with blanks between them: the position or the
normal of a vertex.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.numbers import (
    NOT_A_NUMBER,
    UNDECIDED,
    count_before,
    load_eight,
    read_number,
    store_eight,
    write_number,
)

DONE = 0
"""All statements are dealt with."""
DIFFERENT = 1
"""A byte differs that must be the same."""
WRONG_VALUE = 2
"""A number is not the expected one."""
ASIDE = 3
"""Python has to write or read one number; then the walk goes on behind it."""


@compiled
def _skip_blanks(buf, at):  # type: ignore[no-untyped-def]
    """The next byte that is no blank; in an OBJ file a continued line goes on behind its end."""
    while at < len(buf):
        c = buf[np.uint64(at)]
        if c > 32 and c != 92:
            break
        # Only a backslash can precede the end of a line here.
        at += 1
    return at


@compiled
def _skip_number(buf, at):  # type: ignore[no-untyped-def]
    """The end of the number at ``at``: a blank, the end of a line, or a backslash."""
    while at < len(buf):
        word = load_eight(buf, at)
        slashes = word ^ np.uint64(0x5C5C5C5C5C5C5C5C)
        found = (word - np.uint64(0x2121212121212121)) & ~word
        found |= (slashes - np.uint64(0x0101010101010101)) & ~slashes
        found &= np.uint64(0x8080808080808080)
        if found != 0:
            return min(at + count_before(found), len(buf))
        at += 8
    return len(buf)


@compiled
def find_tokens(buf, begins, starts, stops):  # type: ignore[no-untyped-def]
    """Where the three numbers of each statement begin and end, (3 n,) each."""
    for i in range(len(begins)):
        end = begins[i]
        for axis in range(3):
            start = _skip_blanks(buf, end)
            end = _skip_number(buf, start)
            starts[3 * i + axis] = start
            stops[3 * i + axis] = end


@compiled
def replace(buf, done, out, to, first, first_axis, begins, old, new, decimals):  # type: ignore[no-untyped-def]
    """Copy ``buf`` from byte ``done`` to ``out`` from byte ``to``, with numbers replaced.

    Parameters
    ----------
    buf : (size,) uint8, the file.
    out : uint8, with room for the result and eight bytes more.
    first, first_axis : the statement and the number in it to begin with.
    begins : (n,) int64, ascending, where the statements begin, behind their keywords.
    old, new : (n, 3) float64; a number is replaced where they differ.
    decimals : (n,) uint8, of new numbers, see ``digit_writing.write_number``.

    Returns the end of what was copied, in both, and the statement and the number that Python has to
    write next; (n, 0) where all are written: the rest of the file is yet to be copied.
    """
    for i in range(first, len(begins)):
        if new[i, 0] == old[i, 0] and new[i, 1] == old[i, 1] and new[i, 2] == old[i, 2]:
            continue
        start = begins[i]
        if i == first:
            start = max(start, done)
        for axis in range(first_axis if i == first else 0, 3):
            start = _skip_blanks(buf, start)
            stop = _skip_number(buf, start)
            if new[i, axis] != old[i, axis]:
                while done < start:
                    store_eight(out, to, load_eight(buf, done))
                    count = min(start - done, 8)
                    done += count
                    to += count
                done = stop
                end = write_number(new[i, axis], np.int64(decimals[i]), out, to)
                if end < 0:
                    return done, to, i, axis
                to = end
            start = stop
    return done, to, len(begins), 0


@compiled
def compare(  # type: ignore[no-untyped-def]
    a, a_done, b, b_done, first, first_axis, begins, old, new, decimals, tolerances
):
    """Whether ``b`` is ``a`` with only numbers of the statements replaced, as expected.

    A number that did not change keeps its bytes; one that did is within ``tolerances[decimals[i]]``
    of its new value, and 2 units in the last place of a double.  Other parameters as in
    ``replace``.  Returns DONE, what is wrong, or ASIDE for the number at ``b_done``; how far both
    files are dealt with; the statement and the number in it.
    """
    for i in range(first, len(begins)):
        if new[i, 0] == old[i, 0] and new[i, 1] == old[i, 1] and new[i, 2] == old[i, 2]:
            continue
        start = begins[i]
        if i == first:
            start = max(start, a_done)
        tolerance = tolerances[decimals[i]]
        for axis in range(first_axis if i == first else 0, 3):
            start = _skip_blanks(a, start)
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
