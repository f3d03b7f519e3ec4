"""GLB files put together the plain way, independently of the codec."""

import json
import struct
from typing import Any

import numpy as np

TYPES = {"<f4": 5126, "<u1": 5121, "<u2": 5123, "<u4": 5125, "<i1": 5120, "<i2": 5122}


class Scene:
    """Collects accessors and a description; ``data()`` gives the bytes of the file."""

    def __init__(self) -> None:
        self.binary = b""
        self.content: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "plain é"},
            "accessors": [],
            "bufferViews": [],
            "meshes": [],
            "nodes": [],
            "extras": {"keep": [1, 2.5, "three", None, True]},
        }

    def accessor(self, rows: Any, code: str, kind: str, stride: int = 0, **more: Any) -> int:
        """Add rows as an accessor over a view of its own, spread by ``stride``."""
        array = np.ascontiguousarray(rows, dtype=code)
        width = array.dtype.itemsize * (array.shape[1] if array.ndim == 2 else 1)
        self.binary += b"\xaa" * (-len(self.binary) % 4)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.binary)}
        if stride:
            view["byteStride"] = stride
            content = b"".join(
                array[k].tobytes() + b"\xbb" * (stride - width) for k in range(len(array))
            )
        else:
            content = array.tobytes()
        view["byteLength"] = len(content)
        self.binary += content
        self.content["bufferViews"].append(view)
        entry = {
            "bufferView": len(self.content["bufferViews"]) - 1,
            "componentType": TYPES[code],
            "count": len(array),
            "type": kind,
            **more,
        }
        self.content["accessors"].append(entry)
        return len(self.content["accessors"]) - 1

    def positions(self, rows: Any, stride: int = 0) -> int:
        rows = np.asarray(rows, dtype=np.float32)
        bounds = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return self.accessor(rows, "<f4", "VEC3", stride, **bounds)

    def mesh(self, *primitives: dict[str, Any], **node: Any) -> None:
        self.content["meshes"].append({"primitives": list(primitives)})
        self.content["nodes"].append({"mesh": len(self.content["meshes"]) - 1, **node})

    def data(self) -> bytes:
        binary = self.binary + bytes(-len(self.binary) % 4)
        self.content["buffers"] = [{"byteLength": len(binary)}]
        below = {child for node in self.content["nodes"] for child in node.get("children", [])}
        roots = [k for k in range(len(self.content["nodes"])) if k not in below]
        self.content |= {"scene": 0, "scenes": [{"nodes": roots}]}
        text = json.dumps(self.content).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def content_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The description and the binary chunk of a file."""
    (size,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + size]), bytes(data[28 + size :])
