"""Walks over the bytes of a text file that put new numbers in, or look whether others did.

A *run* is some numbers one behind the other with blanks between them, such as the position or the
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
"""All runs are dealt with."""
DIFFERENT = 1
"""A byte differs that must be the same."""
WRONG_VALUE = 2
"""A number is not the expected one."""
ASIDE = 3
"""Python has to write or read one number; then the walk goes on behind it."""


@compiled
def _skip_blanks(buf, at):
    """The next byte that is no blank; in an OBJ file a continued line goes on behind its end."""
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
        # No byte below 43, the plus, is a part of a number.
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
    most decimals (q,) of each run, at most 255; ``1.5e-3`` has four.  Either may be empty."""
    for i in range(len(begins)):
        end = begins[i]
        most = np.int64(0)
        for axis in range(width):
            start = _skip_blanks(buf, end)
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
    begins : (n,) int64, ascending, where the runs begin, behind their keywords.
    old, new : (n, width) float64; a number is replaced where they differ.
    decimals : (n,) uint8, of new numbers, see ``numbers.write_number``.

    Returns the end of what was copied, in both, and the run and the number that Python has to
    write next; (n, 0) where all are written: the rest of the file is yet to be copied.
    """
    for i in range(first, len(begins)):
        if _is_kept(old, new, i):
            continue
        start = begins[i]
        if i == first:
            start = max(start, done)
        for axis in range(first_axis if i == first else 0, new.shape[1]):
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
def compare(a, a_done, b, b_done, first, first_axis, begins, old, new, decimals, tolerances):
    """Whether ``b`` is ``a`` with only numbers of the runs replaced, as expected.

    A number that did not change keeps its bytes; one that did is within ``tolerances[decimals[i]]``
    of its new value, and 2 units in the last place of a double.  Other parameters as in
    ``replace``.  Returns DONE, what is wrong, or ASIDE for the number at ``b_done``; how far both
    files are dealt with; the run and the number in it.
    """
    for i in range(first, len(begins)):
        if _is_kept(old, new, i):
            continue
        start = begins[i]
        if i == first:
            start = max(start, a_done)
        tolerance = tolerances[decimals[i]]
        for axis in range(first_axis if i == first else 0, new.shape[1]):
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
