"""The facets of an ascii STL, or of a part of one: where their numbers are, and what they are."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Ints, Longs
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.codecs.slots import line_of, number_hint
from msal_cli.codecs.stl_facets import check_countable, check_not_empty, not_finite
from msal_cli.errors import EXPORT_AGAIN, FormatError, InputError, TooLargeError, TruncatedError
from msal_cli.storage.buffers import Buffer

SHORTEST_FACET = len("facet outer loop vertex 0 0 0 vertex 0 0 0 vertex 0 0 0 endloop endfacet ")
"""Bytes of text that a facet takes at least."""

_SOLID = re.compile(rb"\s*solid(?:\s|\Z)", re.IGNORECASE)
_USUAL_FACET = 200


@dataclass(frozen=True, eq=False)
class Scan:
    """Facets of a text: see ``kernels.stl_facets`` for what the arrays are.

    ``n_bare`` counts facets without a normal.
    """

    facet_at: NDArray[np.int64]
    offsets: NDArray[np.int32]
    decimals: NDArray[np.int64]
    names: tuple[str, ...]
    n_solids: int
    end: int
    n_bare: int


def read_numbers(data: Buffer, *, is_part: bool = False) -> tuple[Scan, Floats]:
    """All facets of a text and their numbers (m, 12), positions finite; raises as ``read``.

    A text that ``is_part`` of a file holds whole facets, and may begin and end within a solid.
    """
    scan, numbers = _scan_text(data, is_part)
    if not is_part:
        check_not_empty(len(numbers))
        check_countable(len(numbers))
    decide_numbers(data, scan.facet_at, scan.offsets, numbers)
    return scan, numbers


def decide_numbers(
    data: Buffer,
    facet_at: Longs,
    offsets: Ints,
    numbers: Floats,
    first_facet: int = 0,
    n_lines: int = 0,
) -> None:
    """Read numbers (m, 12) that are in doubt; raises for a position that is not finite.

    ``first_facet`` is the number of the first one in the file, ``n_lines`` the lines before it.
    """
    doubtful = np.argwhere(~np.isfinite(numbers[:, 3:]))
    view = memoryview(data).cast("B")
    for facet, token in doubtful:
        start = int(facet_at[facet] + offsets[facet, token + 3])
        value = _read_number(view, start)
        if not np.isfinite(value):
            line = n_lines + line_of(data, start)
            raise not_finite(first_facet + int(facet), int(token) // 3, line)
        numbers[facet, token + 3] = value
    for facet, token in np.argwhere(np.isinf(numbers[:, :3])):
        start = int(facet_at[facet] + offsets[facet, token])
        numbers[facet, token] = _read_number(view, start)


def _read_number(view: memoryview, start: int) -> float:
    token = bytes(view[start : start + 4096]).split(None, 1)[0]
    try:
        return float(token)
    except ValueError:
        return float("nan")


def _scan_text(data: Buffer, is_part: bool) -> tuple[Scan, Floats]:
    """All facets of a text and their numbers (m, 12), infinite where they are in doubt."""
    from msal_cli.kernels import stl_facets
    from msal_cli.kernels.text import as_bytes

    buf = without_end_mark(as_bytes(data))
    state = np.zeros(stl_facets.N_STATE, dtype=np.int64)
    if bytes(buf[:3]) == BYTE_ORDER_MARK:
        state[stl_facets.AT] = len(BYTE_ORDER_MARK)
    elif is_part:
        state[stl_facets.INSIDE] = _SOLID.match(buf.data) is None
    facets = scan_facets(buf, state, np.zeros(4, dtype=np.int64))
    status, at, word = facets.status
    is_open = is_part and status == stl_facets.CUT and state[stl_facets.AT] == len(buf)
    if status != stl_facets.WHOLE and not is_open:
        raise scan_error(buf, status, at, word, len(facets.facet_at))
    n_solids, n_bare = int(state[stl_facets.SOLIDS]), int(state[stl_facets.WITHOUT_NORMAL])
    return Scan(
        facets.facet_at,
        facets.offsets,
        facets.decimals,
        facets.names,
        n_solids,
        len(buf),
        n_bare,
    ), facets.numbers


def without_end_mark(buf: Bytes) -> Bytes:
    """A text without what some editors end it with: a NUL, or the end-of-file mark of old
    systems."""
    n_last = min(len(buf), 4096)
    return buf[: len(bytes(buf[-4096:]).rstrip(b"\0\x1a")) - n_last + len(buf)]


class Facets(NamedTuple):
    """What ``kernels.stl_facets.scan`` finds, and its last answer: status, byte, expected word."""

    facet_at: Longs
    offsets: Ints
    numbers: Floats
    decimals: Longs
    names: tuple[str, ...]
    status: tuple[int, int, int]


def scan_facets(buf: Bytes, state: Longs, decimals: Longs) -> Facets:
    """All facets of a text, from ``state`` on; ``decimals`` (4,) are carried on, too.

    The arrays grow with what is scanned, never with what is claimed.
    """
    from msal_cli.kernels import stl_facets

    room = min(len(buf) // _USUAL_FACET, len(buf) // SHORTEST_FACET) + 1
    facet_at = np.empty(room, dtype=np.int64)
    offsets = np.empty((room, 12), dtype=np.int32)
    numbers = np.empty((room, 12))
    solid_at = np.zeros(stl_facets.MOST_SOLIDS, dtype=np.int64)
    while True:
        status, stop, word = stl_facets.scan(
            buf, state, facet_at, offsets, numbers, solid_at, decimals
        )
        n = int(state[stl_facets.FACETS])
        if status != stl_facets.FULL:
            break
        room = min(len(buf) // SHORTEST_FACET + 1, n + n // 2 + 16)
        for array in (facet_at, offsets, numbers):
            array.resize((room, *array.shape[1:]), refcheck=False)
    for array in (facet_at, offsets, numbers):
        array.resize((n, *array.shape[1:]), refcheck=False)
    names = tuple(
        bytes(buf[at : at + 256]).splitlines()[0].decode("utf-8", "replace").strip()
        if at < len(buf)
        else ""
        for at in (int(one) for one in solid_at[: state[stl_facets.SOLIDS]])
    )
    answer = int(status), int(stop), int(word)
    return Facets(facet_at, offsets, numbers, decimals, names, answer)


def scan_error(
    buf: Bytes, status: int, at: int, word: int, facet: int, n_lines: int = 0
) -> InputError:
    """The error for a text that ``stl_facets.scan`` does not accept; ``n_lines`` are before it."""
    from msal_cli.kernels import stl_facets

    token = (bytes(buf[at : at + 60]).split(None, 1) or [b""])[0]
    touches_end = at + len(token) == len(buf)
    where = f"facet {facet}, line {n_lines + line_of(buf, at)}"
    wanted = stl_facets.WORDS[word]
    others = {stl_facets.FACET: ("endsolid",), stl_facets.NORMAL: ("outer",)}
    known = (wanted, *others.get(word, ()))
    cut = status == stl_facets.CUT or (
        touches_end
        and (
            status == stl_facets.BAD_NUMBER
            or (
                status == stl_facets.WRONG
                and any(w.encode().startswith(token.lower()) for w in known)
            )
        )
    )
    if cut:
        return TruncatedError(
            f"the text ends within a solid, after {facet} whole facets",
            where=where,
            hint="the file was cut short; copy or export it again",
        )
    text = token.decode("ascii", "backslashreplace")
    if status == stl_facets.OUTSIDE:
        return FormatError(
            f"expected 'solid', found {text!r}",
            where=where,
            hint="ascii STL is a list of solids; is this another format?",
        )
    if status == stl_facets.BAD_NUMBER:
        return FormatError(
            f"{text!r} is not a number",
            where=where,
            hint=number_hint(token),
        )
    if status == stl_facets.TOO_LONG:
        return TooLargeError("a single facet takes more than 2 GiB of text", where=where)
    hint = EXPORT_AGAIN
    if word == stl_facets.ENDLOOP and token.lower() == b"vertex":
        hint = "a facet of STL has three corners; triangulate the mesh first"
    return FormatError(f"expected '{wanted}', found {text!r}", where=where, hint=hint)
