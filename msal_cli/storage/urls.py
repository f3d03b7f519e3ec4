"""URLs as text: distinguishing them from paths, and their parts.

A URL is ``protocol://`` and a path whose parts are literal names: nothing is escaped, not even
``%``, ``#``, spaces and line breaks.  A URL that contains a secret (a password, the query of a
signed link) is refused.
"""

import os
import re

from msal_cli.errors import UsageError
from msal_cli.light_dataclass import dataclass, field

_URL = re.compile(r"(?P<protocol>[A-Za-z][A-Za-z0-9+.-]+)://(?P<rest>.*)", re.DOTALL)
_FILES = ("file", "local")
_ALIASES = {"s3a": "s3", "gcs": "gs", "https": "http"}
_PASSWORD = re.compile(r"(://[^/@\s:]*):[^/\s]*@")
_QUERY = re.compile(r"(https?://[^?\s]*)\?\S*", re.IGNORECASE)
_ODD = {"": "%2F", ".": "%2E", "..": "%2E%2E"}

# Windows treats these names as devices, with any suffix.
_DEVICES = re.compile(r"(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])( *\.| *$)", re.IGNORECASE)


_TAG = "entity tag, or what the store gives in its place; empty if it gives none"


@dataclass(frozen=True, slots=True)
class ObjectMark:
    """Size in bytes and entity tag of an object in a store; the tag is empty if none is given."""

    size: int = field(metadata={"description": "bytes"})
    tag: str = field(metadata={"description": _TAG})


def is_url(text: str) -> bool:
    """Whether ``text`` is the URL of an object, not of a local file."""
    match = _URL.match(text)
    return match is not None and match["protocol"].lower() not in _FILES


def normalize_url(text: str) -> str:
    """A path or URL in the form that this module expects, without ``file://``; UsageError for a URL
    with a password or a query."""
    match = _URL.match(text)
    if match is None:
        return text
    protocol, rest = match["protocol"].lower(), match["rest"]
    if protocol in _FILES:
        return rest.removeprefix("/") if os.name == "nt" and re.match("/[A-Za-z]:", rest) else rest
    if (shown := redact(text)) != text:
        raise UsageError(
            f"{shown!r}: a URL with a password or a query is not opened",
            hint="give credentials by the environment or the store's own configuration, or use a "
            "pipe: curl URL | msal denoise - -o OUT",
        )
    return f"{protocol}://{rest}"


def redact(text: str) -> str:
    """``text``, such as a word of a command line or a message, with secrets replaced by ``***``."""
    return _QUERY.sub(r"\1?***", _PASSWORD.sub(r"\1:***@", text))


def split(url: str) -> tuple[str, str]:
    protocol, _, path = url.partition("://")
    return protocol, path


def folder(url: str) -> str:
    """The URL of a folder with one slash at its end; relative names with ``/`` may follow."""
    protocol, path = split(url)
    # All the slashes of memory:// belong to it.
    path = path.rstrip("/")
    return f"{protocol}://{path}/" if path else f"{protocol}://"


def name(url: str) -> str:
    """The last part of a URL that is not empty."""
    return split(url)[1].rstrip("/").rpartition("/")[2]


def identity(url: str) -> str:
    """A key that is equal for URLs of one object with different spellings of the protocol."""
    protocol, path = split(url)
    return f"{_ALIASES.get(protocol, protocol)}://{path.lstrip('/')}"


def escape_name(relative: str, *, is_local: bool) -> str:
    """The name of an object, relative to its folder, for use below another folder.

    An object may be called ``../x`` or ``a//b``, which file systems and many servers take for
    another place.  Parts that are ``..``, ``.`` or empty are escaped as in a URL; for a file
    (``is_local``) so are characters that file names on this system cannot contain.
    """
    parts = [_ODD.get(part, part) for part in relative.split("/")]
    if is_local:
        parts = [_escape_part(part) for part in parts]
    return "/".join(parts)


def _escape_part(part: str) -> str:
    if os.name != "nt":
        return part.replace("\0", "%00")
    if _DEVICES.match(part):
        part = _escape(part[0]) + part[1:]
    # Windows drops dots and spaces at the end, so that two names could become one.
    if part[-1:] in (".", " "):
        part = part[:-1] + _escape(part[-1])
    return "".join(_escape(c) if c in '\0\\:*?"<>|' or c < " " else c for c in part)


def _escape(character: str) -> str:
    return f"%{ord(character):02X}"
