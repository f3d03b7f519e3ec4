"""Binary glTF (GLB): positions and normals replaced inside its binary chunk.

All else is kept.  Of the JSON only the bounds change that the format demands of positions.
"""

from __future__ import annotations

import operator
import struct

from msal_cli.arrays import Floats
from msal_cli.codecs.gltf_file import SceneFile
from msal_cli.codecs.gltf_json import as_dict, as_list, parse_json, require_short
from msal_cli.codecs.gltf_scene import Scene
from msal_cli.errors import (
    EXPORT_AGAIN,
    FormatError,
    InternalError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.buffers import Buffer

_HEAD = 20
"""Bytes before the description: the header of the file and that of its first chunk."""

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_CUT = "the file was cut short; copy or export it again"


def read(data: Buffer, name: str) -> GlbFile:
    """Read the surfaces of a GLB file.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError
        if the file is not what its format says.
    UnsupportedError
        for compressed positions, version 1, and data in other files.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    return GlbFile(data)


def expected_bytes(head: memoryview, total: int) -> int:
    """The bytes that a file of ``total`` bytes that begins with ``head`` should have.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError, UnsupportedError
    """
    if total < _HEAD:
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
    if length > total or _HEAD + size > length:
        raise TruncatedError(
            f"the file should have {max(length, _HEAD + size)} bytes but has {total}",
            where=f"byte {total}",
            hint=_CUT,
        )
    require_short(size, "JSON chunk")
    return int(length)


def _split(data: Buffer) -> tuple[bytes, memoryview, int]:
    """The description, all behind it, and how much of that belongs to the file."""
    view = memoryview(data).cast("B")
    length = expected_bytes(view, len(view))
    (size,) = struct.unpack_from("<I", view, 12)
    return bytes(view[_HEAD : _HEAD + size]), view[_HEAD + size :], length - _HEAD - size


def _parse(text: bytes, rest: memoryview, length: int) -> Scene:
    from msal_cli.kernels.text import as_bytes

    content = parse_json(text, "JSON chunk")
    size = 0
    if length >= 8:
        size, kind = struct.unpack_from("<II", rest)
        size *= kind == _BINARY
        if 8 + size > length:
            end = _HEAD + len(text) + length
            raise TruncatedError(
                f"the binary chunk should have {size} bytes but has {length - 8}",
                where=f"byte {end}",
                hint=_CUT,
            )
    first = as_list(content.get("buffers"))[:1]
    is_inside = "uri" not in as_dict(first[0] if first else None)
    return Scene(content, as_bytes(rest), {0: (8 * (size > 0), size)} if is_inside else {})


class GlbFile(SceneFile):
    """An opened GLB file."""

    format = "glb"

    def __init__(self, data: Buffer) -> None:
        parts = _split(data)
        super().__init__(data, parts[0], _parse(*parts))

    def _pack(self, data: memoryview) -> bytes:
        """The file with other data behind the description, whose padding is made to fit."""
        begin = _HEAD + len(self.text)
        head = memoryview(self.data).cast("B")[:begin]
        text = self.text_of(data)
        if text != head[_HEAD:]:
            padding = len(text) - len(text.rstrip(b" "))
            text = text[: len(text) - min(padding, 3)]
            text += b" " * (-len(text) % 4)
            size = _HEAD + len(text) + len(data)
            head = memoryview(struct.pack("<4sIIII", b"glTF", 2, size, len(text), _JSON) + text)
        return b"".join([head, data])

    def _unpack(self, output: Buffer, vertices: Floats) -> tuple[bytes, Buffer]:
        text, data, length = _split(output)
        heads = (memoryview(one).cast("B")[:_HEAD] for one in (output, self.data))
        if length != len(data) and operator.ne(*heads):
            raise InternalError("the length in its header is not what it should be")
        return text, data
