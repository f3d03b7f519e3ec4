"""The chunks of a GLB file: its description, and the binary data behind it."""

from __future__ import annotations

import struct

from msal_cli.codecs.gltf_document import MOST_JSON, Document, as_dict, as_list, parsed_description
from msal_cli.errors import (
    EXPORT_AGAIN,
    FormatError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.buffers import Buffer

JSON_AT = 20
_JSON, _BINARY = 0x4E4F534A, 0x004E4942


def parsed(data: Buffer) -> Document:
    """Take a GLB file apart.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError, UnsupportedError
    """
    view = memoryview(data).cast("B")
    length = wanted_bytes(view, len(view))
    (size,) = struct.unpack_from("<I", view, 12)
    text, content = parsed_description(bytes(view[JSON_AT : JSON_AT + size]), "JSON chunk")
    data_at, data_size = _binary_chunk(view, JSON_AT + size, length)
    first = as_list(content.get("buffers"))[:1]
    is_inside = "uri" not in as_dict(first[0] if first else None)
    places = {0: (data_at, data_size)} if is_inside else {}
    return Document(content, text, JSON_AT + size, places, data)


def wanted_bytes(head: memoryview, total: int) -> int:
    """The bytes that a file of ``total`` bytes that begins with ``head`` should have.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError, UnsupportedError
    """
    if total < JSON_AT:
        raise TruncatedError(f"the file has only {total} bytes", hint=EXPORT_AGAIN)
    magic, version, length, size, kind = struct.unpack_from("<4sIIII", head)
    if magic != b"glTF" or (version == 2 and kind != _JSON):
        raise FormatError(
            "the file does not begin as a GLB file does", where="byte 0", hint=EXPORT_AGAIN
        )
    if version != 2:
        raise UnsupportedError(
            f"glTF version {version} is not read", hint="convert it to version 2"
        )
    if length > total or JSON_AT + size > length:
        raise TruncatedError(
            f"the file should have {max(length, JSON_AT + size)} bytes but has {total}",
            where=f"byte {total}",
            hint="the file was cut short; copy or export it again",
        )
    if size > MOST_JSON:
        raise TooLargeError(
            f"the description has {size:,} bytes, more than the {MOST_JSON:,} that are read",
            where="JSON chunk",
            hint="it holds more than a mesh; export the mesh alone",
        )
    return int(length)


def _binary_chunk(view: memoryview, at: int, end: int) -> tuple[int, int]:
    """Where the content of the binary chunk lies, and its size; nothing if there is none."""
    if at + 8 > end:
        return at, 0
    size, kind = struct.unpack_from("<II", view, at)
    if kind != _BINARY:
        return at, 0
    if at + 8 + size > end:
        raise TruncatedError(
            f"the binary chunk should have {size} bytes but has {end - at - 8}",
            where=f"byte {end}",
            hint="the file was cut short; copy or export it again",
        )
    return at + 8, size


def with_text(document: Document, output: bytearray, text: str) -> bytes:
    """``output``, the bytes of a file, with another description; its padding is made to fit."""
    encoded = text.encode()
    if encoded == document.text.encode():
        return bytes(output)
    padding = len(encoded) - len(encoded.rstrip(b" "))
    encoded = encoded[: len(encoded) - min(padding, 3)]
    encoded += b" " * (-len(encoded) % 4)
    rest = memoryview(output)[document.binary_at :]
    head = struct.pack("<4sII", b"glTF", 2, JSON_AT + len(encoded) + len(rest))
    return b"".join([head, struct.pack("<II", len(encoded), _JSON), encoded, rest])
