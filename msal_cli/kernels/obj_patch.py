"""Walks over the bytes of an OBJ file that put new numbers in, or look whether others did.

Both walks meet the statements v and vn in the order of the file: two ascending lists of first
bytes, merged on the way, so that nothing has to be kept per number.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.digits import NOT_A_NUMBER, UNDECIDED
from msal_cli.kernels.obj_scan import past_blanks, past_word, read_coordinate
from msal_cli.kernels.text import is_same

DONE = 0
"""The walk has come to the end of the file."""
ASIDE = 1
"""One number has to be read by Python; then the walk goes on."""
DIFFERENT = 2
"""A byte differs that must be the same."""
WRONG_VALUE = 3
"""A number is not the one wanted, or none."""

VERTEX, NORMAL, AXIS, OLD, NEW, BEGIN, END, N_WALK = range(8)
"""The state of a comparison: next v and vn, next axis of the statement, bytes of the old and of
the new file that are dealt with, and where a number set ASIDE stands in the new file."""


@compiled
def _copied(source, start, stop, target, at):  # type: ignore[no-untyped-def]
    """Copy source[start:stop] to target at ``at``; returns the end."""
    for k in range(stop - start):
        target[at + k] = source[start + k]
    return at + stop - start


@compiled
def patched(  # type: ignore[no-untyped-def]
    buf, vertex_at, is_moved, text, stops, normal_at, is_turned, normal_text, normal_stops, out
):
    """Copy ``buf`` to ``out`` with the numbers of some statements v and vn replaced.

    Parameters
    ----------
    buf : (size,) uint8, the file.
    vertex_at : (n,) int64, first bytes of the statements v.
    is_moved : (n, 3) bool, which numbers to replace.
    text, stops : the new texts one behind the other, uint8, and where each ends, int64.
    normal_at, is_turned, normal_text, normal_stops : the same for vn.
    out : uint8, as long as the result is.
    """
    i = j = 0
    text_i = text_j = 0
    done = at = begin = 0
    while i < len(vertex_at) or j < len(normal_at):
        is_vertex = j == len(normal_at) or (i < len(vertex_at) and vertex_at[i] < normal_at[j])
        if is_vertex:
            begin = vertex_at[i] + 1
            flags = (is_moved[i, 0], is_moved[i, 1], is_moved[i, 2])
            i += 1
        else:
            begin = normal_at[j] + 2
            flags = (is_turned[j, 0], is_turned[j, 1], is_turned[j, 2])
            j += 1
        if not (flags[0] or flags[1] or flags[2]):
            continue
        for axis in range(3):
            begin = past_blanks(buf, begin)
            end = past_word(buf, begin)
            if flags[axis]:
                at = _copied(buf, done, begin, out, at)
                done = end
                if is_vertex:
                    start = stops[text_i - 1] if text_i > 0 else 0
                    at = _copied(text, start, stops[text_i], out, at)
                    text_i += 1
                else:
                    start = normal_stops[text_j - 1] if text_j > 0 else 0
                    at = _copied(normal_text, start, normal_stops[text_j], out, at)
                    text_j += 1
            begin = end
    return _copied(buf, done, len(buf), out, at)


@compiled
def compared(  # type: ignore[no-untyped-def]
    a, b, walk, vertex_at, vertices, new_vertices, tolerance, normal_at, unit
):
    """Whether ``b`` is ``a`` with only numbers of v and vn replaced, as wanted.

    A position that did not move keeps its bytes; one that did is within ``tolerance`` of its new
    value, and 2 units in the last place of a double.  A vn keeps its bytes or has a length within
    ``unit`` of 1 (negative ``unit``: it keeps them).  Returns DONE, DIFFERENT, WRONG_VALUE, or
    ASIDE for the word ``walk[BEGIN]`` to ``walk[END]`` of ``b``; arrays as in ``patched``.
    """
    i, j, axis = walk[VERTEX], walk[NORMAL], walk[AXIS]
    a_done, b_done = walk[OLD], walk[NEW]
    result = DONE
    while result == DONE and (i < len(vertex_at) or j < len(normal_at)):
        if j == len(normal_at) or (i < len(vertex_at) and vertex_at[i] < normal_at[j]):
            if (
                new_vertices[i, 0] != vertices[i, 0]
                or new_vertices[i, 1] != vertices[i, 1]
                or new_vertices[i, 2] != vertices[i, 2]
            ):
                begin = max(vertex_at[i] + 1, a_done)
                while axis < 3:
                    begin = past_blanks(a, begin)
                    wanted = new_vertices[i, axis]
                    if wanted == vertices[i, axis]:
                        begin = past_word(a, begin)
                        axis += 1
                        continue
                    count = begin - a_done
                    if len(b) - b_done < count or not is_same(a, a_done, b, b_done, count):
                        result = DIFFERENT
                        break
                    b_begin = b_done + count
                    value, status, b_end, _ = read_coordinate(b, b_begin)
                    begin = a_done = past_word(a, begin)
                    b_done = b_end
                    if status == UNDECIDED:
                        walk[BEGIN], walk[END] = b_begin, b_end
                        result = ASIDE
                        break
                    slack = tolerance + 4.5e-16 * abs(wanted)
                    if status == NOT_A_NUMBER or not abs(value - wanted) <= slack:
                        result = WRONG_VALUE
                        break
                    axis += 1
                if result != DONE:
                    break
            axis = 0
            i += 1
        else:
            if unit >= 0.0:
                # What lies between is equal, so that the statement is found in the other file.
                count = normal_at[j] + 2 - a_done
                if len(b) - b_done < count or not is_same(a, a_done, b, b_done, count):
                    result = DIFFERENT
                    break
                a_at, b_at = a_done + count, b_done + count
                squares = 0.0
                is_changed = False
                for _ in range(3):
                    a_word, b_word = past_blanks(a, a_at), past_blanks(b, b_at)
                    count = a_word - a_at
                    if b_word - b_at != count or not is_same(a, a_at, b, b_at, count):
                        result = DIFFERENT
                    a_at, b_at = past_word(a, a_word), past_word(b, b_word)
                    value, status, _, _ = read_coordinate(b, b_word)
                    squares += value * value
                    count = a_at - a_word
                    is_changed |= b_at - b_word != count or not is_same(a, a_word, b, b_word, count)
                    if is_changed and status == NOT_A_NUMBER:
                        result = WRONG_VALUE
                if is_changed and not abs(np.sqrt(squares) - 1.0) <= unit:
                    result = WRONG_VALUE
                a_done, b_done = a_at, b_at
                if result != DONE:
                    break
            j += 1
    if result == DONE:
        count = len(a) - a_done
        if len(b) - b_done != count or not is_same(a, a_done, b, b_done, count):
            result = DIFFERENT
    walk[VERTEX], walk[NORMAL], walk[AXIS] = i, j, axis
    walk[OLD], walk[NEW] = a_done, b_done
    return result
