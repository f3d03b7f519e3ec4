"""The JSON of a glTF scene: read with care, and where its values lie, to replace a few of them.

All other text stays as it is: spaces, the order of keys, how numbers and letters are written.
Text is Latin-1 here, whatever it is, so that each character is one byte.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any

from msal_cli.errors import EXPORT_AGAIN, FormatError, TooLargeError

Span = tuple[int, int]
"""The first character of a value, and the one behind its last."""

_LONGEST = 64 << 20
"""Longest description that is read; those of very large scenes have a few megabytes, and in memory
it may take thirty times its size."""

_SPACE = re.compile(r"[ \t\n\r]*")
_decoder = json.JSONDecoder()


def parse_json(data: bytes, where: str) -> dict[str, Any]:
    """What a description says.

    Raises
    ------
    FormatError
    """
    try:
        content = json.loads(data.decode().removeprefix("\ufeff"))
        json.dumps(content)  # what is nested too deeply to be written is refused at once
    except (ValueError, RecursionError) as failure:
        said = str(failure)[:200]
        raise FormatError(
            f"the description is not JSON: {said}", where=where, hint=EXPORT_AGAIN
        ) from None
    if not isinstance(content, dict):
        raise FormatError("the description is not a JSON object", where=where, hint=EXPORT_AGAIN)
    return content


def require_short(size: int, where: str = "") -> None:
    """Raise TooLargeError for a description of ``size`` bytes that is too long."""
    if size > _LONGEST:
        raise TooLargeError(
            f"the description has {size:,} bytes, more than the {_LONGEST:,} that are read",
            where=where,
            hint="it holds more than a mesh; export the mesh alone",
        )


def as_dict(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def as_list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _skip_space(text: str, at: int) -> int:
    match = _SPACE.match(text, at)
    return match.end() if match else at


def _find_members(text: str, at: int) -> Iterator[tuple[str, Span]]:
    """The keys of the object that begins at ``at``, and where their values lie."""
    at = _skip_space(text, at + 1)
    while text[at] != "}":
        key, at = _decoder.raw_decode(text, at)
        start = _skip_space(text, _skip_space(text, at) + 1)
        at = _decoder.raw_decode(text, start)[1]
        yield key, (start, at)
        at = _skip_space(text, at)
        if text[at] == ",":
            at = _skip_space(text, at + 1)


def find_elements(text: str, at: int) -> Iterator[Span]:
    """Where the elements lie of the list that begins at ``at``."""
    at = _skip_space(text, at + 1)
    while text[at] != "]":
        start, at = at, _decoder.raw_decode(text, at)[1]
        yield start, at
        at = _skip_space(text, at)
        if text[at] == ",":
            at = _skip_space(text, at + 1)


def find_entries(text: str, kind: str) -> list[dict[str, Span]]:
    """Where the values of each entry of the list ``kind`` lie in a description, by their keys.

    ``text`` is known to be an object of JSON, and its value of ``kind`` to be a list of objects;
    of keys that stand twice the last one counts, as for every reader.
    """
    start = _skip_space(text, 3 * text.startswith("\xef\xbb\xbf"))
    spans = dict(_find_members(text, start))
    if kind not in spans:
        return []
    entries = find_elements(text, spans[kind][0])
    return [dict(_find_members(text, at)) if text[at] == "{" else {} for at, _ in entries]


def write_bound(old: str, new: list[float]) -> str:
    """The text ``old`` of a bound with the numbers ``new``.

    Of three numbers, those that are the same as float32 keep their text.
    """
    value = json.loads(old)
    is_triple = (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    )
    if not is_triple:
        return old if value == new else json.dumps(new)
    spans = zip(find_elements(old, 0), value, new, strict=True)
    return replace_spans(
        old, ((span, json.dumps(now)) for span, was, now in spans if _as_float32(was) != now)
    )


def _as_float32(value: float) -> float:
    import numpy as np

    try:
        with np.errstate(all="ignore"):
            return float(np.float32(value))
    except OverflowError:  # an integer beyond float64
        return float("inf")


def replace_spans(text: str, edits: Iterable[tuple[Span, str]]) -> str:
    """``text`` with other text at some places."""
    pieces, done = [], 0
    for (start, stop), new in sorted(edits):
        pieces += [text[done:start], new]
        done = stop
    return "".join([*pieces, text[done:]])
