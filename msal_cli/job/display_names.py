"""Names and numbers as text: reversible for programs, harmless for people.

The system gives names as text in which a byte that is not valid UTF-8 becomes a lone surrogate
(``os.fsdecode``).  Such text cannot be written as UTF-8, or as JSON that every reader accepts.
"""

import re
import unicodedata
from collections.abc import Callable
from typing import Any

# A surrogate, or a backslash that would look like the start of an escaped one.
_TO_ESCAPE = re.compile(r"[\ud800-\udfff]|\\(?=u(?:d[89a-f][0-9a-f]{2}|005c))")
_ESCAPED = re.compile(r"\\u(d[89a-f][0-9a-f]{2}|005c)")

_LOG_COMMAND = re.compile(r"\s*::")
# Build services obey these anywhere in a line.
_INNER_COMMAND = re.compile(r"#(?=#\w*\[)")

_UNSAFE_CATEGORIES = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})


def portable(text: str) -> str:
    """``text`` as valid Unicode; ``restore_name`` is the inverse.

    A byte NN that is not UTF-8 becomes the six characters ``\\udcNN``.  Where a name itself has
    such a sequence, its backslash becomes ``\\u005c``.  All other text stays as it is.
    """
    return _TO_ESCAPE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def restore_name(text: str) -> str:
    """The text that ``portable`` was called with."""
    return _ESCAPED.sub(lambda found: chr(int(found[1], 16)), text)


def map_texts(data: Any, change: Callable[[str], str]) -> Any:
    """Plain data with all its texts, keys too, as ``change`` makes them."""
    if isinstance(data, str):
        return change(data)
    if isinstance(data, list | tuple):
        return [map_texts(inner, change) for inner in data]
    if isinstance(data, dict):
        return {change(key): map_texts(inner, change) for key, inner in data.items()}
    return data


def escape_for_display(text: str) -> str:
    """``text`` for a terminal or a log: one line, with nothing that a terminal would execute.

    Control and format characters (line ends, escape sequences, changes of the writing direction)
    become ``\\xNN`` or ``\\uNNNN``, a byte that is not UTF-8 becomes ``\\xNN``.  So does the first
    character of what a build service would execute as a command in its log (``::error::``,
    ``##vso[...]``).
    """
    if _LOG_COMMAND.match(text):
        text = text.lstrip()
        return f"\\x{ord(text[0]):02x}{escape_for_display(text[1:])}"
    text = _INNER_COMMAND.sub(r"\\x23", text)
    if text.isascii() and text.isprintable():
        return text
    return "".join(_escape_character(character) for character in text)


def _escape_character(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:
        return f"\\x{code - 0xDC00:02x}"
    if unicodedata.category(character) not in _UNSAFE_CATEGORIES:
        return character
    if code < 0x100:
        return {"\n": "\\n", "\r": "\\r", "\t": "\\t"}.get(character, f"\\x{code:02x}")
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def columns(text: str) -> int:
    """The width of ``text`` on a terminal: East Asian wide characters take two columns."""
    if text.isascii():
        return len(text)
    return sum(_character_columns(character) for character in text)


def _character_columns(character: str) -> int:
    if unicodedata.combining(character):
        return 0
    return 2 if unicodedata.east_asian_width(character) in "WF" else 1


def shorten_name(text: str, width: int) -> str:
    """``text``, or its end, in at most ``width`` columns: the end of a path says most."""
    if columns(text) <= width:
        return text
    used, start = 3, len(text)
    while start and used + _character_columns(text[start - 1]) <= width:
        start -= 1
        used += _character_columns(text[start])
    return "..." + text[start:]


def pad_name(text: str, width: int, *, right: bool = False) -> str:
    """``text`` padded with spaces to ``width`` columns, aligned right if ``right``."""
    fill = " " * max(0, width - columns(text))
    return fill + text if right else text + fill


def figure(value: float | None, form: str, unit: str = "", unknown: str = "") -> str:
    """A number in a format such as ``.3g`` with its unit; ``unknown`` for None."""
    return unknown if value is None else f"{value:{form}}{unit}"
