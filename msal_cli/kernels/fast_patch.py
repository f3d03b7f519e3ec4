"""Walks over the bytes of a text file that put new positions in, or look whether others did.

A *statement* is three numbers one behind the other, with blanks between them: the position or the
normal of a vertex.  Here all numbers that are written can be read and printed as ``plain_numbers``
does; other files are for ``obj_patch`` and ``text``.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.byte_words import count_before, load_eight, store_eight
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.digits import EXACT, read_number, write_fixed

DONE = 0
"""All statements are dealt with."""
DIFFERENT = 1
"""A byte differs that must be the same."""
WRONG_VALUE = 2
"""A number is not the one wanted."""
ODD = 3
"""A number is not plain: another walk must look at it."""


@compiled
def _past_blanks(buf, at):  # type: ignore[no-untyped-def]
    """The next byte that is no blank; in an OBJ file a continued line goes on behind its end."""
    while at < len(buf):
        c = buf[np.uint64(at)]
        if c > 32 and c != 92:
            break
        # Only a backslash can stand before the end of a line here.
        at += 1
    return at


@compiled
def _past_number(buf, at):  # type: ignore[no-untyped-def]
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
def find_tokens(buf, at, skipped, starts, stops):  # type: ignore[no-untyped-def]
    """Where the three numbers of each statement begin and end, (3 n,) each."""
    for i in range(len(at)):
        end = at[i] + skipped
        for axis in range(3):
            begin = _past_blanks(buf, end)
            end = _past_number(buf, begin)
            starts[3 * i + axis] = begin
            stops[3 * i + axis] = end


@compiled
def patched(buf, done, start, stop, at, skipped, old, new, decimals, out, to):  # type: ignore[no-untyped-def]
    """Copy ``buf`` from byte ``done`` to ``out`` from byte ``to``, with numbers replaced.

    Parameters
    ----------
    buf : (size,) uint8, the file.
    start, stop : the statements to deal with.
    at, skipped : (n,) int64, where they begin, and the bytes of a keyword there.
    old, new : (n, 3) float64; a number is replaced where they differ.
    decimals : (n,) uint8, digits behind the point of new numbers.
    out : uint8, with room for the result and eight bytes more.

    Returns the end of what was copied, in both: the rest of the file is yet to be.
    """
    for i in range(start, stop):
        if new[i, 0] == old[i, 0] and new[i, 1] == old[i, 1] and new[i, 2] == old[i, 2]:
            continue
        begin = at[i] + skipped
        for axis in range(3):
            begin = _past_blanks(buf, begin)
            end = _past_number(buf, begin)
            if new[i, axis] != old[i, axis]:
                while done < begin:
                    store_eight(out, to, load_eight(buf, done))
                    count = min(begin - done, 8)
                    done += count
                    to += count
                to = write_fixed(new[i, axis], np.int64(decimals[i]), out, to)
                done = end
            begin = end
    return done, to


@compiled
def compared(  # type: ignore[no-untyped-def]
    a, b, a_done, b_done, start, stop, at, skipped, old, new, decimals, tolerances
):
    """Whether ``b`` is ``a`` with only numbers of the statements replaced, as wanted.

    A number that did not change keeps its bytes; one that did is within ``tolerances[decimals[i]]``
    of its new value, and 2 units in the last place of a double.  Other parameters as in
    ``patched``.  Returns DONE or what is wrong, the statement, and how far both files are dealt
    with.
    """
    for i in range(start, stop):
        if new[i, 0] == old[i, 0] and new[i, 1] == old[i, 1] and new[i, 2] == old[i, 2]:
            continue
        begin = at[i] + skipped
        tolerance = tolerances[decimals[i]]
        for axis in range(3):
            begin = _past_blanks(a, begin)
            end = _past_number(a, begin)
            wanted = new[i, axis]
            if wanted != old[i, axis]:
                count = begin - a_done
                if len(b) - b_done < count:
                    return DIFFERENT, i, a_done, b_done
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
                a_done += count
                b_done += count
                if different != 0:
                    return DIFFERENT, i, a_done, b_done
                value, status, b_end, _ = read_number(b, b_done, len(b))
                if status != EXACT:
                    return ODD, i, a_done, b_done
                if not abs(value - wanted) <= tolerance + 4.5e-16 * abs(wanted):
                    return WRONG_VALUE, i, a_done, b_done
                a_done, b_done = end, b_end
            begin = end
    return DONE, stop, a_done, b_done
