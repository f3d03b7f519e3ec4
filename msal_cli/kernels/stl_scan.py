"""Walks over ascii STL: facets out of text, new numbers into it, text out of facets.

The *tokens* of a facet are its twelve numbers in file order: the normal's three, then three for
each corner.  Their places are kept as the facet's first byte, ``facet_at`` (n,) int64, and the
distance of each token from it, ``offsets`` (n, 12) int32, a fifth of what two int64 per token take.
A facet may be without a normal, and a normal's words need not be numbers: their values are NaN, and
nothing is ever written there.
The bytes come from strangers: compiled code does not check bounds, so every walk here compares
with the end of the data before it reads.
"""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.digit_writing import write_fixed
from msal_cli.kernels.digits import EXACT, UNDECIDED, read_number
from msal_cli.kernels.text import is_same, skip_token

WHOLE = 0
"""All of the text is read."""
FULL = 1
"""The output arrays are full; call again with larger ones."""
CUT = 2
"""The text ends within a solid."""
WRONG = 3
"""A word is not the one that must be there."""
BAD_NUMBER = 4
"""A word that must be a number is none."""
OUTSIDE = 5
"""Behind a solid there is something that is not another solid."""
TOO_LONG = 6
"""A single facet takes 2 GiB of text."""

FACET, NORMAL, OUTER, LOOP, VERTEX, ENDLOOP, ENDFACET, SOLID, ENDSOLID = range(9)
WORDS = ("facet", "normal", "outer", "loop", "vertex", "endloop", "endfacet", "solid", "endsolid")
_LETTERS = np.array([list(word.encode().ljust(8, b"\0")) for word in WORDS], dtype=np.uint8)
_LENGTHS = np.array([len(word) for word in WORDS])

AT, FACETS, SOLIDS, INSIDE, WITHOUT_NORMAL, N_STATE = range(6)
"""Places in the state of a walk, see ``scan``."""

MOST_SOLIDS = 16
"""Solids whose names are looked at."""


@compiled
def _is_space(c):  # type: ignore[no-untyped-def]
    return c == 32 or 9 <= c <= 13


@compiled
def _skip_spaces(buf, at):  # type: ignore[no-untyped-def]
    while at < len(buf) and _is_space(buf[at]):
        at += 1
    return at


@compiled
def _skip_word(buf, at, word):  # type: ignore[no-untyped-def]
    """The end of ``word``, in any case, if the whole word is at ``at``; else -1."""
    stop = at + _LENGTHS[word]
    if stop > len(buf):
        return -1
    for k in range(_LENGTHS[word]):
        if (buf[at + k] | np.uint8(32)) != _LETTERS[word, k]:
            return -1
    if stop < len(buf) and not _is_space(buf[stop]):
        return -1
    return stop


@compiled
def _skip_two_words(buf, at, word):  # type: ignore[no-untyped-def]
    """The end of ``word`` where it is written as two, as in ``end facet``; else -1."""
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
def _is_bare(buf, at, word):  # type: ignore[no-untyped-def]
    """Whether the outer loop begins at ``at``, where ``word`` or its numbers should be: a facet
    without a normal."""
    return word == NORMAL and _skip_word(buf, at, OUTER) >= 0


@compiled
def _match(buf, at, word):  # type: ignore[no-untyped-def]
    """The end of ``word`` at ``at``, as it may be written; -1 where another word is there."""
    stop = _skip_word(buf, at, word)
    if stop < 0 and word >= ENDLOOP:
        return _skip_two_words(buf, at, word)
    if stop < 0 and _is_bare(buf, at, word):
        return at
    return stop


@compiled
def _skip_remark(buf, end, at):  # type: ignore[no-untyped-def]
    """The first word behind words that stand on the line of a statement, which ends at ``end``.

    That is ``at``, the next word, where it stands on another line, or is a number or a keyword:
    one too many is damage.
    """
    for k in range(end, at):
        if buf[k] == 10 or buf[k] == 13:
            return at
    if at < len(buf) and (buf[at] == 43 or 45 <= buf[at] <= 46 or 48 <= buf[at] <= 57):
        return at
    for word in range(len(_LENGTHS)):
        if _skip_word(buf, at, word) >= 0:
            return at
    while at < len(buf) and buf[at] != 10 and buf[at] != 13:
        at += 1
    return _skip_spaces(buf, at)


@compiled
def _number(buf, at):  # type: ignore[no-untyped-def]
    """The number at ``at``: value, end (-1 for none), decimals.

    NaN also for the words that old run-time libraries print (``1.#QNAN``); infinity marks a
    number that ``float`` has to decide.
    """
    value, status, stop, decimals = read_number(buf, at, len(buf))
    if status == EXACT and (stop == len(buf) or _is_space(buf[stop])):
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
def scan(buf, state, facet_at, offsets, numbers, solid_at, decimals):  # type: ignore[no-untyped-def]
    """Read facets from ``buf`` (size,) uint8 until the arrays are full or the text ends.

    state (N_STATE,) int64 : next byte, facets read, solids read, 1 within a solid, and facets
        without a normal; carried on.
    numbers (n, 12) float64 : the tokens' values; see ``_number``.
    solid_at (MOST_SOLIDS,) int64 : where the first solids' names begin.
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
            at = stop
            while at < len(buf) and buf[at] != 10 and buf[at] != 13:
                at += 1
            continue
        if not inside:
            return OUTSIDE, at, SOLID
        if n == len(facet_at) and _skip_word(buf, at, FACET) >= 0:
            return FULL, at, FACET
        facet = at
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
                        for token in range(3):
                            offsets[n, token] = at - facet
                            numbers[n, token] = np.nan
                        token = 3
                        state[WITHOUT_NORMAL] += 1
                        break
                    if word != NORMAL or _is_bare(buf, at, word):
                        return BAD_NUMBER, at, word
                    value, stop, used = np.nan, skip_token(buf, at), 0
                if stop - facet > 0x7FFFFFFF:
                    return TOO_LONG, facet, word
                offsets[n, token] = at - facet
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
        facet_at[n] = facet
        n += 1
        behind = at


@compiled
def write_tokens(buf, facet_at, offsets, replace, numbers, decimals, out):  # type: ignore[no-untyped-def]
    """Copy ``buf`` to ``out`` with the tokens that ``replace`` (n, 12) marks printed anew.

    decimals (2,) int64 : of normals and of corners.  The numbers must fit fixed-point text and
    ``out`` must be long enough.  Returns the length of the result.
    """
    copied = 0
    to = 0
    for f in range(len(facet_at)):
        for token in range(12):
            if not replace[f, token]:
                continue
            start = facet_at[f] + offsets[f, token]
            for k in range(copied, start):
                out[to + k - copied] = buf[k]
            to += start - copied
            to = write_fixed(numbers[f, token], decimals[0 if token < 3 else 1], out, to)
            copied = skip_token(buf, start)
    for k in range(copied, len(buf)):
        out[to + k - copied] = buf[k]
    return to + len(buf) - copied


@compiled
def is_same_outside(  # type: ignore[no-untyped-def]
    buf, facet_at, offsets, other, other_facet_at, other_offsets, replace
):
    """Whether two texts of n facets each are equal outside the tokens that ``replace`` marks."""
    a = b = 0
    for f in range(len(facet_at) + 1):
        for token in range(12):
            if f == len(facet_at):
                a_stop, b_stop = len(buf), len(other)
            elif replace[f, token]:
                a_stop = facet_at[f] + offsets[f, token]
                b_stop = other_facet_at[f] + other_offsets[f, token]
            else:
                continue
            if a_stop - a != b_stop - b or not is_same(buf, a, other, b, a_stop - a):
                return False
            a = skip_token(buf, a_stop)
            b = skip_token(other, b_stop)
    return True
