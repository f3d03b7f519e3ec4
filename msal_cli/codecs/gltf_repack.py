"""A glTF scene from one container into the other, GLB or .gltf, with all that it has.

The buffers become one: the binary chunk of a GLB, or base64 in the text of a .gltf.
"""

from __future__ import annotations

import json
import struct
from typing import Any

from msal_cli.arrays import Floats
from msal_cli.codecs.gltf_buffers import EMPTY_URI, encode_data_uri
from msal_cli.codecs.gltf_file import SceneFile
from msal_cli.storage.buffers import Buffer


def repack(file: SceneFile, vertices: Floats, to: str) -> bytes | None:
    """The scene with ``vertices`` (n, 3) as ``glb`` or ``gltf``.

    None where that would lose something: for buffers that could not be read, and for views that
    are described a second time in an extension.
    """
    is_moved = bool((vertices != file.vertices).any())
    data = file.replace_data(vertices)
    text = file.text_of(data) if is_moved else file.text.encode("latin-1")
    content = json.loads(text.decode().removeprefix("\ufeff"))
    try:
        binary = _merge_buffers(content, file.scene.buffers, data)
    except (TypeError, ValueError, LookupError, AttributeError):
        return None
    if to == "gltf":
        content["buffers"][0]["uri"] = encode_data_uri(EMPTY_URI, binary)
        return _to_json(content)
    description = _to_json(content)
    description += b" " * (-len(description) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = [struct.pack("<I4s", len(description), b"JSON"), description]
    chunks += [struct.pack("<I4s", len(binary), b"BIN\0"), binary]
    return b"".join([struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))), *chunks])


def _merge_buffers(content: dict[str, Any], places: dict[int, Any], data: memoryview) -> bytes:
    """The content of all buffers one behind the other; the description is changed to match.

    Raises ValueError and others where it cannot be.
    """
    starts: list[int] = []
    pieces: list[Buffer] = []
    size = 0
    for number in range(len(content["buffers"])):
        at, length = places[number]
        pieces += [bytes(-size % 4), data[at : at + length]]
        size += -size % 4
        starts.append(size)
        size += length
    for entry in content["bufferViews"]:
        if "extensions" in entry:
            raise ValueError("an extension may name the buffer again")
        entry["byteOffset"] = entry.get("byteOffset", 0) + starts[entry["buffer"]]
        entry["buffer"] = 0
    first = content["buffers"][0] if len(starts) == 1 else {}
    first.pop("uri", None)
    content["buffers"] = [first | {"byteLength": size}]
    return b"".join(pieces)


def _to_json(content: dict[str, Any]) -> bytes:
    """The description as UTF-8; half a surrogate pair, which has none, stays an escape."""
    try:
        return json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return json.dumps(content, separators=(",", ":")).encode()
