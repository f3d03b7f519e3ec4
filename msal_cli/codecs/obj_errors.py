"""What is wrong with the bytes of an OBJ file, and where: lines are counted from one."""

from __future__ import annotations

import re
from collections.abc import Collection

from msal_cli.codecs.slots import line_of
from msal_cli.errors import ContentError, FormatError, TruncatedError
from msal_cli.storage.buffers import Buffer

_LOOKED_AT = 4096
_ZEROS_LOOKED_AT = 1 << 16
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f\x7f]")


def refuse_binary(data: Buffer) -> None:
    """Raise unless the beginning of ``data`` can be the text of an OBJ file."""
    if not len(data):
        raise TruncatedError("the file is empty", hint="copy or export it again")
    head = bytes(memoryview(data)[:_LOOKED_AT])
    # Old systems end a text with this mark; it is kept as a line that is no statement.
    control = _CONTROL.search(head.rstrip(b"\x1a\r\n") if len(data) <= _LOOKED_AT else head)
    # Zeros are looked for farther on: the first pages of a file may be sound.
    found = control.start() if control else bytes(memoryview(data)[:_ZEROS_LOOKED_AT]).find(0)
    if found >= 0:
        raise binary_error(data, found)


def binary_error(data: Buffer, at: int, n_bytes: int = 0, n_lines: int = 0) -> FormatError:
    """The error for a control character at byte ``at``; the file has ``n_bytes`` and ``n_lines``
    before ``data``."""
    return FormatError(
        f"byte {n_bytes + at} is a control character: this is binary data, not OBJ text",
        where=f"byte {n_bytes + at}, line {n_lines + line_of(data, at)}",
        hint="pass --format if the suffix is wrong, or copy the file again",
    )


def no_faces_error(n_vertices: int, n_short: int, keywords: Collection[bytes]) -> ContentError:
    """The error for a file without vertices or without faces of three corners.

    ``n_short`` are its faces of one or two corners, ``keywords`` what else it has.
    """
    if not {b"V", b"F"}.isdisjoint(keywords):
        hint = "the keywords V and F are in capitals; OBJ writes them small"
    elif n_short:
        hint = "its faces have one or two corners; a face needs three"
    elif n_vertices:
        hint = "it was cut short, or is a point cloud: export it again, or make a mesh of it"
    else:
        hint = "check that this is an OBJ file"
    return ContentError(
        f"the file has {'no faces' if n_vertices else 'no vertices'}",
        hint=hint,
        code="E_NO_FACES",
    )


def bad_index_error(number: str, where: str, n_vertices: int) -> ContentError:
    """The error for a face that names the vertex ``number``, counted from one."""
    return ContentError(
        f"a face names vertex {number}, but there are {n_vertices} vertices",
        where=where,
        hint="the file is cut off or was put together wrongly; export it again",
        code="E_INDEX",
    )
