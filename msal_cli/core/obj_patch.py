"""Walks over the bytes of an OBJ file that put new numbers in, or look whether others did.

Both walks meet the statements v and vn in the order of the file: two ascending lists of first
bytes, merged on the way, so that nothing has to be kept per number.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from msal_cli.core.digits import NOT_A_NUMBER, UNDECIDED, write_fixed, write_shortest
from msal_cli.core.obj_scan import past_blanks, past_word, read_coordinate
from msal_cli.core.text import is_same

SHORTEST_DOUBLE, SHORTEST_SINGLE = 18, 19
"""In place of a number of decimals: the shortest text that is read back as the same number."""

DONE = 0
"""The walk has come to the end of the file."""
ASIDE = 1
"""One number has to be written, or read, by Python; then the walk goes on."""
DIFFERENT = 2
"""A byte differs that must be the same."""
WRONG_VALUE = 3
"""A number is not the one wanted, or none."""

VERTEX, NORMAL, AXIS, OLD, NEW, BEGIN, END, IS_NORMAL, N_WALK = range(9)
"""The state of a walk: next v and vn, next axis of the statement, bytes of the old and of the new
file that are dealt with; of a number set ASIDE, where it stands in the new file (to be read) or
whether it belongs to a normal (to be written)."""


@njit(cache=True, nogil=True)
def _copied(source, start, stop, target, at):  # type: ignore[no-untyped-def]
    """Copy source[start:stop] to target at ``at``; returns the end."""
    for k in range(stop - start):
        target[at + k] = source[start + k]
    return at + stop - start


@njit(cache=True, nogil=True)
def _written(value, decimals, out, at):  # type: ignore[no-untyped-def]
    """Write one number; the end, or -1 where Python must write it."""
    if decimals == SHORTEST_SINGLE:
        return write_shortest(np.float64(np.float32(value)), True, out, at)
    if decimals == SHORTEST_DOUBLE:
        return write_shortest(value, False, out, at)
    return write_fixed(value, decimals, out, at)


@njit(cache=True, nogil=True)
def _patched_statement(  # type: ignore[no-untyped-def]
    buf, begin, axis, old, new, is_forced, decimals, out, done, at
):
    """Copy up to the last number of one statement that is replaced, from ``axis`` on.

    ``old`` and ``new`` are the three numbers: as tuples, because an array that is handed on for
    every statement costs more than the work itself.  Returns the axis that Python must write (3
    for none), and the bytes of ``buf`` and ``out`` that are dealt with.
    """
    while axis < 3:
        begin = past_blanks(buf, begin)
        end = past_word(buf, begin)
        if is_forced or new[axis] != old[axis]:
            at = _copied(buf, done, begin, out, at)
            done = end
            stop = _written(new[axis], decimals, out, at)
            if stop < 0:
                break
            at = stop
        begin = end
        axis += 1
    return axis, done, at


@njit(cache=True, nogil=True)
def patched(  # type: ignore[no-untyped-def]
    buf, walk, vertex_at, vertices, new_vertices, normal_at, normals, new_normals, style, out
):
    """Copy ``buf`` to ``out`` with numbers replaced where old and new differ; DONE or ASIDE.

    Parameters
    ----------
    buf : (size,) uint8, the file.
    walk : (N_WALK,) int64, zeros at the start.
    vertex_at, vertices, new_vertices : (n,) int64 first bytes of the statements v; (n, 3) float64.
    normal_at, normals, new_normals : the same for vn.
    style : (3,) int64: decimals of positions, decimals of normals, and 1 to write every position,
        be it moved or not.
    out : uint8, long enough; holds ``walk[NEW]`` bytes in the end.
    """
    i, j, axis = walk[VERTEX], walk[NORMAL], walk[AXIS]
    done, at = walk[OLD], walk[NEW]
    is_forced = style[2] == 1
    result = DONE
    while i < len(vertex_at) or j < len(normal_at):
        is_vertex = j == len(normal_at) or (i < len(vertex_at) and vertex_at[i] < normal_at[j])
        # ``done`` lies within the statement where the walk was interrupted in it.
        if is_vertex:
            begin, decimals, forced = vertex_at[i] + 1, style[0], is_forced
            old = (vertices[i, 0], vertices[i, 1], vertices[i, 2])
            new = (new_vertices[i, 0], new_vertices[i, 1], new_vertices[i, 2])
        else:
            begin, decimals, forced = normal_at[j] + 2, style[1], False
            old = (normals[j, 0], normals[j, 1], normals[j, 2])
            new = (new_normals[j, 0], new_normals[j, 1], new_normals[j, 2])
        if forced or new[0] != old[0] or new[1] != old[1] or new[2] != old[2]:
            begin = max(begin, done)
            axis, done, at = _patched_statement(
                buf, begin, axis, old, new, forced, decimals, out, done, at
            )
            if axis < 3:
                result = ASIDE
        if result == ASIDE:
            walk[IS_NORMAL] = not is_vertex
            break
        axis = 0
        if is_vertex:
            i += 1
        else:
            j += 1
    if result == DONE:
        at = _copied(buf, done, len(buf), out, at)
        done = len(buf)
    walk[VERTEX], walk[NORMAL], walk[AXIS] = i, j, axis
    walk[OLD], walk[NEW] = done, at
    return result


@njit(cache=True, nogil=True)
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
