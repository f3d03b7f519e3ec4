"""The text of a glTF description: where its values lie, so that a few can be replaced in it.

All other text stays as it is: spaces, the order of keys, how numbers and letters are written.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator

Span = tuple[int, int]
Edit = tuple[int, int, str]
"""First character, the one behind the last, and what comes in their place."""

_SPACE = re.compile(r"[ \t\n\r]*")
_decoder = json.JSONDecoder()


def _skip_space(text: str, at: int) -> int:
    match = _SPACE.match(text, at)
    return match.end() if match else at


def _end_of(text: str, at: int) -> int:
    """The character behind the value that begins at ``at``."""
    return _decoder.raw_decode(text, at)[1]


def _members(text: str, at: int) -> Iterator[tuple[str, Span]]:
    """The keys of the object that begins at ``at``, and where their values lie."""
    at = _skip_space(text, at + 1)
    while text[at] != "}":
        key, at = _decoder.raw_decode(text, at)
        start = _skip_space(text, _skip_space(text, at) + 1)
        at = _end_of(text, start)
        yield key, (start, at)
        at = _skip_space(text, at)
        if text[at] == ",":
            at = _skip_space(text, at + 1)


def _elements(text: str, at: int) -> Iterator[Span]:
    """Where the elements lie of the list that begins at ``at``."""
    at = _skip_space(text, at + 1)
    while text[at] != "]":
        start, at = at, _end_of(text, at)
        yield start, at
        at = _skip_space(text, at)
        if text[at] == ",":
            at = _skip_space(text, at + 1)


def entry_spans(text: str, kind: str) -> list[dict[str, Span]]:
    """Where the values of each entry of the list ``kind`` lie in a description, by their keys.

    ``text`` is known to be an object of JSON, and its value of ``kind`` to be a list of objects;
    of keys that stand twice the last one counts, as for every reader.
    """
    start = _skip_space(text, text.startswith("\ufeff"))
    spans = dict(_members(text, start))
    if kind not in spans:
        return []
    entries = _elements(text, spans[kind][0])
    return [dict(_members(text, at)) if text[at] == "{" else {} for at, _ in entries]


def bound_edits(text: str, span: Span, old: object, new: list[float]) -> Iterator[Edit]:
    """Edits that make the bound at ``span`` of a description ``new``, number by number.

    A number of ``old`` that is the same as float32 keeps its text.
    """
    kept = kept_bound(old, new)
    if isinstance(old, list) and is_triple(old):
        for (start, stop), was, now in zip(_elements(text, span[0]), old, kept, strict=True):
            if now != was:
                yield start, stop, json.dumps(now)
    elif old != new:
        yield *span, json.dumps(new)


def is_triple(bound: object) -> bool:
    """Whether a bound has the form that it should have."""
    return (
        isinstance(bound, list)
        and len(bound) == 3
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in bound)
    )


def kept_bound(old: object, new: list[float]) -> list[object]:
    """The bound that is written: ``new``, but old numbers that are the same as float32."""
    import numpy as np

    if not isinstance(old, list) or not is_triple(old):
        return list(new)
    with np.errstate(all="ignore"):
        return [was if _as_float32(was) == now else now for was, now in zip(old, new, strict=True)]


def _as_float32(value: float) -> float:
    import numpy as np

    try:
        return float(np.float32(value))
    except OverflowError:  # an integer beyond float64
        return float("inf")


def edited(text: str, edits: Iterable[Edit]) -> str:
    """``text`` with pieces of it replaced."""
    pieces, done = [], 0
    for start, stop, new in sorted(edits):
        pieces += [text[done:start], new]
        done = stop
    return "".join([*pieces, text[done:]])
