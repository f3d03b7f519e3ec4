"""A glTF scene from one container into the other, GLB or .gltf, with all that it has.

The buffers become one: the binary chunk of a GLB, or base64 in the text of a .gltf.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.codecs.gltf_buffers import EMPTY_URI, as_embedded
from msal_cli.codecs.gltf_file import SceneFile
from msal_cli.storage.buffers import Buffer

_HEAD = struct.Struct("<4sII")


def repacked(file: SceneFile, vertices: NDArray[np.float64], to: str) -> bytes | None:
    """The scene with ``vertices`` (n, 3) as ``glb`` or ``gltf``.

    None where that would lose something: for buffers that could not be read, and for views that
    are described a second time in an extension.
    """
    document = file.document
    is_moved = bool((vertices != file.vertices).any())
    data: Buffer = file.patched(vertices) if is_moved else document.data
    text = document.text
    if is_moved:
        text = document.bounded(data, [part.positions for part in file.parts])
    content = json.loads(text.removeprefix("\ufeff"))
    try:
        binary = _merge_buffers(content, document.places, data)
    except (TypeError, ValueError, LookupError, AttributeError):
        return None
    if to == "gltf":
        content["buffers"][0]["uri"] = as_embedded(EMPTY_URI, binary)
        return _as_json(content)
    encoded = _as_json(content)
    encoded += b" " * (-len(encoded) % 4)
    binary += bytes(-len(binary) % 4)
    chunks = [struct.pack("<I4s", len(encoded), b"JSON"), encoded]
    chunks += [struct.pack("<I4s", len(binary), b"BIN\0"), binary]
    return b"".join([_HEAD.pack(b"glTF", 2, 12 + sum(map(len, chunks))), *chunks])


def _merge_buffers(
    content: dict[str, Any], places: dict[int, tuple[int, int]], data: Buffer
) -> bytes:
    """The content of all buffers one behind the other; the description is changed to match.

    Raises ValueError and others where it cannot be.
    """
    view = memoryview(data).cast("B")
    starts: list[int] = []
    pieces: list[Buffer] = []
    size = 0
    for number in range(len(content["buffers"])):
        at, length = places[number]
        pieces += [bytes(-size % 4), view[at : at + length]]
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


def _as_json(content: dict[str, Any]) -> bytes:
    """The description as UTF-8; half a surrogate pair, which has none, stays an escape."""
    try:
        return json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return json.dumps(content, separators=(",", ":")).encode()
