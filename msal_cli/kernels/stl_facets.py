"""Passes over STL: facets from text, new numbers into text and records, and their check.

A facet of ascii STL is four *runs* of three numbers: its normal and its corners.  It may have no
normal, and a normal's words need not be numbers: their values are NaN, and nothing is ever written
there.  The bytes are untrusted and compiled code does not check bounds, so each pass here compares
with the end of the data before it reads.
"""

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.geometry import doubled_area_normal
from msal_cli.kernels.library import compiled
from msal_cli.kernels.numbers import EXACT, UNDECIDED, read_number
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.text import is_line_end, is_token_end, skip_line, skip_token

(
    WHOLE,  # all of the text is read
    FULL,  # the output arrays are full; call again with larger ones
    CUT,  # the text ends within a solid
    WRONG,  # a word is not the expected one
    BAD_NUMBER,  # a word that must be a number is not
    OUTSIDE,  # after a solid there is something that is not another solid
) = range(6)

FACET, NORMAL, OUTER, LOOP, VERTEX, ENDLOOP, ENDFACET, SOLID, ENDSOLID = range(9)
WORDS = ("facet", "normal", "outer", "loop", "vertex", "endloop", "endfacet", "solid", "endsolid")
_LETTERS = np.array([list(word.encode().ljust(8, b"\0")) for word in WORDS], dtype=np.uint8)
_LENGTHS = np.array([len(word) for word in WORDS])

AT, FACETS, SOLIDS, INSIDE, WITHOUT_NORMAL, N_STATE = range(6)
"""Indices in the state of a pass, see ``scan``."""

MAX_SOLIDS = 16
"""Number of solids whose names are read."""


@compiled
def _skip_spaces(buf, at):
    while at < len(buf) and is_token_end(buf, at):
        at += 1
    return at


@compiled
def _skip_word(buf, at, word):
    """The end of ``word``, in any case, if the whole word is at ``at``; else -1."""
    stop = at + _LENGTHS[word]
    if stop > len(buf):
        return -1
    for k in range(_LENGTHS[word]):
        if (buf[at + k] | np.uint8(32)) != _LETTERS[word, k]:
            return -1
    return stop if is_token_end(buf, stop) else -1


@compiled
def _skip_two_words(buf, at, word):
    """The end of ``word`` if it is written as two words, as in ``end facet``; else -1."""
    middle = skip_token(buf, at)
    tail = _skip_spaces(buf, middle)
    stop = tail + _LENGTHS[word] - 3
    if middle - at != 3 or stop > len(buf) or skip_token(buf, tail) != stop:
        return -1
    for k in range(_LENGTHS[word]):
        c = buf[at + k] if k < 3 else buf[tail + k - 3]
        if (c | np.uint8(32)) != _LETTERS[word, k]:
            return -1
    return stop


@compiled
def _is_bare(buf, at, word):
    """Whether the outer loop begins at ``at``, where ``word`` or its numbers should be: a facet
    without a normal."""
    return word == NORMAL and _skip_word(buf, at, OUTER) >= 0


@compiled
def _match(buf, at, word):
    """The end of ``word`` at ``at``, as it may be written; -1 for another word."""
    stop = _skip_word(buf, at, word)
    if stop < 0 and word >= ENDLOOP:
        return _skip_two_words(buf, at, word)
    if stop < 0 and _is_bare(buf, at, word):
        return at
    return stop


@compiled
def _skip_remark(buf, end, at):
    """The first word after additional words on the line of a statement, which ends at ``end``.

    That is ``at``, the next word, if it is on another line, or is a number or a keyword, because
    additional ones of these are damage.
    """
    for k in range(end, at):
        if is_line_end(buf, k):
            return at
    if at < len(buf) and (buf[at] == 43 or 45 <= buf[at] <= 46 or 48 <= buf[at] <= 57):
        return at
    for word in range(len(_LENGTHS)):
        if _skip_word(buf, at, word) >= 0:
            return at
    return _skip_spaces(buf, skip_line(buf, at))


@compiled
def _number(buf, at):
    """The number at ``at``: value, end (-1 for none), decimals.

    NaN also for the words that old run-time libraries print (``1.#QNAN``); infinity marks a
    number that ``float`` has to decide.
    """
    value, status, stop, decimals = read_number(buf, at, len(buf))
    if status == EXACT and is_token_end(buf, stop):
        return value, stop, decimals
    end = skip_token(buf, at)
    if status == UNDECIDED and stop == end:
        return np.inf, end, decimals
    first = at
    if first < end and (buf[first] == 45 or buf[first] == 43):
        first += 1
    if first + 3 <= end:
        a, b, c = buf[first] | 32, buf[first + 1] | 32, buf[first + 2] | 32
        if (a == 110 and b == 97 and c == 110) or (a == 105 and b == 110 and c == 102):
            return np.nan, end, 0
        # 1.#QNAN, 1.#INF, 1.#IND
        if buf[first] == 49 and buf[first + 1] == 46 and buf[first + 2] == 35:
            return np.nan, end, 0
    return 0.0, -1, 0


@compiled
def scan(buf, state, run_at, numbers, solid_at, decimals):
    """Read facets from ``buf`` (size,) uint8 until the arrays are full or the text ends.

    state (N_STATE,) int64 : next byte, facets read, solids read, 1 within a solid, and facets
        without a normal; carried on.
    run_at (n, 4) int64 : first byte of each run.
    numbers (n, 12) float64 : their values; see ``_number``.
    solid_at (MAX_SOLIDS,) int64 : where the first solids' names begin.
    decimals (4,) int64 : most decimals of normals and of corners, in plain numbers, and in
        numbers with an exponent.

    Returns (status, byte, word that was expected).
    """
    at, n, n_solids = state[AT], state[FACETS], state[SOLIDS]
    inside = state[INSIDE] != 0
    behind = -1
    while True:
        at = _skip_spaces(buf, at)
        if behind >= 0 and _match(buf, at, ENDSOLID) < 0:
            at = _skip_remark(buf, behind, at)
        state[AT], state[FACETS], state[SOLIDS], state[INSIDE] = at, n, n_solids, inside
        if at >= len(buf):
            return (CUT if inside else WHOLE), at, FACET
        behind = -1
        stop = _match(buf, at, ENDSOLID) if inside else _skip_word(buf, at, SOLID)
        if stop >= 0:
            if not inside:
                if n_solids < len(solid_at):
                    solid_at[n_solids] = stop
                n_solids += 1
            inside = not inside
            at = skip_line(buf, stop)
            continue
        if not inside:
            return OUTSIDE, at, SOLID
        if n == len(run_at) and _skip_word(buf, at, FACET) >= 0:
            return FULL, at, FACET
        token = 0
        for word in (FACET, NORMAL, OUTER, LOOP, VERTEX, VERTEX, VERTEX, ENDLOOP, ENDFACET):
            end = at
            at = _skip_spaces(buf, at)
            stop = _match(buf, at, word)
            if stop < 0 and word >= OUTER and word != LOOP:
                at = _skip_remark(buf, end, at)
                stop = _match(buf, at, word)
            if at >= len(buf):
                return CUT, at, word
            if stop < 0:
                return WRONG, at, word
            at = stop
            if word != NORMAL and word != VERTEX:
                continue
            for _ in range(3):
                at = _skip_spaces(buf, at)
                if at >= len(buf):
                    return CUT, at, word
                value, stop, used = _number(buf, at)
                if stop < 0:
                    if _is_bare(buf, at, word) and token == 0:
                        run_at[n, 0] = at
                        numbers[n, :3] = np.nan
                        token = 3
                        state[WITHOUT_NORMAL] += 1
                        break
                    if word != NORMAL or _is_bare(buf, at, word):
                        return BAD_NUMBER, at, word
                    value, stop, used = np.nan, skip_token(buf, at), 0
                if token % 3 == 0:
                    run_at[n, token // 3] = at
                numbers[n, token] = value
                kind = 0 if word == NORMAL else 1
                if used > decimals[kind]:
                    exponent = False
                    for k in range(at, stop):
                        exponent = exponent or (buf[k] | 32) == 101
                    if exponent:
                        decimals[kind + 2] = max(decimals[kind + 2], used)
                    else:
                        decimals[kind] = used
                token += 1
                at = stop
        n += 1
        behind = at


RIGHT, WRONG_CORNER, WRONG_NORMAL, WRONG_ATTRIBUTE = range(4)
"""What ``check_facets`` found wrong with a facet."""

_CORNERS, _ATTRIBUTE = 6, 24
_LENGTH_ERROR = 1e-5
"""Largest difference of the squared length of a float32 unit normal from 1."""


@compiled
def check_facets(
    start, stop, old, new, faces, words_before, words, corners_before, normals, corners
):
    """The first facet that is not as ``replace_facets`` must write it, and what is wrong.

    old, new (n, 3) float64 : vertices; ``faces`` (m, 3) are the facets' corners among them.
    normals (m, 3), corners (m, 9) float32 : views into the file, after and before.
    words (m, 25) uint16 : whole facets, before and after: six of the normal, eighteen of the
        corners, and the attribute.
    """
    for f in range(start, stop):
        if words[f, _ATTRIBUTE] != words_before[f, _ATTRIBUTE]:
            return f, WRONG_ATTRIBUTE
        moved = False
        for at in range(9):
            i, k, word = faces[f, at // 3], at % 3, _CORNERS + 2 * at
            if old[i, k] != corners_before[f, at]:
                return f, WRONG_CORNER
            is_same = words[f, word] == words_before[f, word]
            is_same = is_same and words[f, word + 1] == words_before[f, word + 1]
            if new[i, k] != old[i, k]:
                moved = True
                is_same = corners[f, at] == np.float32(new[i, k])
            if not is_same:
                return f, WRONG_CORNER
        changed = False
        for word in range(_CORNERS):
            changed = changed or words[f, word] != words_before[f, word]
        if changed:
            normal = vec.times(1.0, vec.load(normals, f))
            if not moved or not abs(vec.dot(normal, normal) - 1.0) < _LENGTH_ERROR:
                return f, WRONG_NORMAL
    return stop, RIGHT


# Facets of binary STL, and stored normals after vertices moved.


@compiled
def replace_facets(start, stop, old, new, faces, normals, corners, changed):
    """Write changed normals and corners into facets.

    normals (m, 3) : as stored; those that ``renew_facet_normals`` says are replaced.
    corners (m, 9) : each coordinate that moved is replaced.  Not filled if empty.
    changed (m,) bool : set for normals that are replaced.  Not filled if empty.
    """
    for f in range(start, stop):
        a, b, c = vec.load(faces, f)
        is_kept = vec.load(old, a) == vec.load(new, a) and vec.load(old, b) == vec.load(new, b)
        if is_kept and vec.load(old, c) == vec.load(new, c):
            continue
        if len(corners):
            for corner in range(3):
                i = faces[f, corner]
                for k in range(3):
                    if old[i, k] != new[i, k]:
                        corners[f, 3 * corner + k] = new[i, k]
        x, y, z = np.float64(normals[f, 0]), np.float64(normals[f, 1]), np.float64(normals[f, 2])
        largest = max(abs(x), abs(y), abs(z))
        normal, length = doubled_area_normal(new, a, b, c)
        # A sum, because a maximum may drop NaN.
        is_stored = largest > 0.0 and abs(x) + abs(y) + abs(z) < np.inf
        if not (is_stored and length < np.inf) or vec.is_zero(normal):
            continue
        before, _ = doubled_area_normal(old, a, b, c)
        # Scaled, so that tiny and huge stored normals do not affect the sign.
        along = vec.dot(vec.divide((x, y, z), largest), before)
        # The sum turns a negative zero into a positive one.
        vec.store(normals, f, vec.add(vec.times(-1.0 if along < 0.0 else 1.0, normal), vec.ORIGIN))
        if len(changed):
            changed[f] = True


def renew_facet_normals(
    old: Floats, new: Floats, faces: Ints, normals: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Stored facet normals after vertices moved.

    Parameters
    ----------
    old, new : (n, 3), the vertices before and after, file units.
    faces : (m, 3), the corners of each facet.
    normals : (m, 3) as stored, of any length, not finite where the file has no number.

    Returns
    -------
    normals : (m, 3).  A facet with a corner that moved gets the unit normal of its new corners by
        the right-hand rule, reversed if the stored one opposed the old corners.  A facet whose
        stored normal is zero (exporters leave the choice to the reader) or not finite, and one
        that became degenerate, keeps its normal.
    changed : (m,) bool, which normals are new.
    """
    result = np.array(normals, dtype=np.float64)
    changed = np.zeros(len(result), dtype=np.bool_)
    over_ranges(replace_facets, len(result), old, new, faces, result, np.empty((0, 9)), changed)
    return result, changed
