"""Glob patterns for relative paths: ``*`` and ``?`` keep within a folder, ``**`` crosses them."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable

from msal_cli.errors import UsageError

_MAGIC = re.compile(r"[*?[]")


def has_magic(text: str) -> bool:
    """Whether ``text`` holds a wildcard."""
    return _MAGIC.search(text) is not None


class Patterns:
    """Several glob patterns, matched together.

    Relative paths are written with ``/``.  A pattern matches a file when it matches its whole
    relative path, its name alone, or a folder that holds it, so ``old`` and ``old/`` match all
    that lies in a folder ``old`` anywhere, and ``left/**/*.ply`` for ``left/a.ply`` as well as for
    ``left/b/c.ply``.  As in a shell, a wildcard at the start of a name does not match a dot.
    With ``whole`` set, only the whole relative path or that of a holding folder counts.
    Case counts, but for Windows.

    Raises UsageError for an empty pattern.
    """

    def __init__(self, patterns: Iterable[str], *, whole: bool = False) -> None:
        self._whole = whole
        self._compiled = [_compiled(pattern) for pattern in patterns]

    def __bool__(self) -> bool:
        return bool(self._compiled)

    def is_exact(self, relative: str) -> bool:
        """Whether a pattern matches ``relative`` itself, not only a folder that holds it."""
        return any(one.fullmatch(relative) for one in self._compiled)

    def matches(self, relative: str) -> bool:
        """Whether a pattern matches ``relative``, its name or a folder that holds it."""
        if not self._compiled:
            return False
        parts = relative.split("/")
        for stop in range(len(parts), 0, -1):
            if self.is_exact("/".join(parts[:stop])):
                return True
            if not self._whole and self.is_exact(parts[stop - 1]):
                return True
        return False


def _compiled(pattern: str) -> re.Pattern[str]:
    text = pattern.replace(os.sep, "/")
    while text.startswith("./"):
        text = text[2:]
    text = text.rstrip("/")
    if not text:
        raise UsageError(f"the pattern {pattern!r} is empty")
    expression = ""
    segments = text.split("/")
    for place, segment in enumerate(segments):
        is_last = place == len(segments) - 1
        if segment == "**":
            expression += ".*" if is_last else "(?:.*/)?"
        else:
            expression += _segment(segment) + ("" if is_last else "/")
    flags = re.DOTALL | (re.IGNORECASE if os.name == "nt" else 0)
    try:
        return re.compile(expression, flags)
    except re.error as error:
        raise UsageError(
            f"the pattern {pattern!r} cannot be read: {error}",
            hint="write [[] for a literal bracket",
        ) from None


def _segment(segment: str) -> str:
    expression = r"(?!\.)" if segment[:1] in ("*", "?", "[") else ""
    at = 0
    while at < len(segment):
        character = segment[at]
        at += 1
        if character == "*":
            expression += "[^/]*"
        elif character == "?":
            expression += "[^/]"
        elif character == "[":
            # A ] right behind the opening bracket (or its !) is a member, not the end.
            first = at + 1 if segment[at : at + 1] == "!" else at
            stop = segment.find("]", first + 1)
            if stop < 0:
                expression += r"\["
                continue
            members = re.sub(r"([\\\[&~|^])", r"\\\1", segment[first:stop])
            expression += f"[{'^/' if first > at else ''}{members}]"
            at = stop + 1
        else:
            expression += re.escape(character)
    return expression
