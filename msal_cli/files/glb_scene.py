"""The description inside a GLB file: where its surfaces lie, and in which frames.

The JSON comes from strangers, so that every number taken from it is checked for its type and range
before it is used.
"""

from __future__ import annotations

import dataclasses
import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.dataclass import dataclass
from msal_cli.errors import (
    ContentError,
    FormatError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.files.base import Buffer

Floats = NDArray[np.float64]

_JSON, _BINARY = 0x4E4F534A, 0x004E4942
_FLOAT32 = 5126
_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_DEEPEST = 200
_STEEPEST = 1e6
MOST_JSON = 64 << 20
"""Longest description that is read; those of very large scenes have a few megabytes, and in memory
it may take thirty times its size."""

_LARGEST = 1e30
"""Larger entries of a frame could take float32 positions beyond what can be computed with."""

_ALWAYS_READ = 1 << 16
"""Corners that are read however often the same ones are named; see ``_require_room``."""

_HINT = "the file is damaged; export it again"
_PLAIN = "export it without compression, or convert it to PLY"


@dataclass(frozen=True)
class Accessor:
    """Rows of three float32 in a file: ``count`` rows, the first at byte ``at``, ``stride`` apart.

    ``index`` is its number in the description.
    """

    index: int
    at: int
    stride: int
    count: int

    def stored(self, data: Buffer) -> NDArray[np.float32]:
        """The rows (count, 3), a view into ``data``."""
        return np.ndarray((self.count, 3), "<f4", data, self.at, (self.stride, 4))

    def values(self, data: Buffer) -> Floats:
        """The rows (count, 3) as float64.

        Raises
        ------
        ContentError
            with code ``E_NONFINITE``.
        """
        stored = self.stored(data)
        finite = np.isfinite(stored).all(axis=1)
        if not finite.all():
            raise ContentError(
                "a position is not finite",
                code="E_NONFINITE",
                where=f"accessor {self.index}, vertex {int(np.argmin(finite))}",
                hint="remove the vertex, or export the mesh again",
            )
        return stored.astype(np.float64)

    def store(self, data: bytearray, rows: NDArray[np.float32]) -> None:
        """Write rows (count, 3) into ``data``."""
        self.stored(data)[...] = rows

    def bound(self, data: Buffer, word: str) -> list[float]:
        """The least (``min``) or largest (``max``) of each coordinate."""
        rows = self.stored(data)
        extreme = rows.min(axis=0) if word == "min" else rows.max(axis=0)
        return [float(x) for x in extreme]

    def shifted(self, distance: int) -> Accessor:
        """The same rows where the file's bytes lie ``distance`` further on."""
        return dataclasses.replace(self, at=self.at + distance)


@dataclass(frozen=True, eq=False)
class Part:
    """Surfaces over one list of positions: triangles (m, 3) int64 into it, its mesh's number, and
    its normals, one to a position, if it has any that can be recomputed."""

    positions: Accessor
    faces: NDArray[np.int64]
    mesh: int
    normals: Accessor | None


@dataclass(frozen=True, eq=False)
class Document:
    """A GLB file taken apart: the description, its bytes, and where the chunk behind it begins.

    ``binary_at`` is the first byte behind the JSON chunk; ``data_at`` and ``data_size`` are the
    content of the binary chunk.
    """

    content: dict[str, Any]
    binary_at: int
    data_at: int
    data_size: int
    data: Buffer

    def entry(self, kind: str, index: object) -> dict[str, Any]:
        """The entry ``index`` of the list ``kind``; FormatError if there is none."""
        entries = self.content.get(kind)
        if (
            not isinstance(entries, list)
            or not isinstance(index, int)
            or isinstance(index, bool)
            or not 0 <= index < len(entries)
            or not isinstance(entries[index], dict)
        ):
            raise FormatError(f"there is no entry {index!r} in {kind}", where=kind, hint=_HINT)
        # Not a copy: a large entry may be named very often.
        found: dict[str, Any] = entries[index]
        return found

    def bounds(self, index: int) -> dict[str, Any]:
        """The ``min`` and ``max`` of an accessor, those that are there."""
        entry = self.entry("accessors", index)
        return {word: entry[word] for word in ("min", "max") if word in entry}

    def _region(self, index: object, width: int, where: str) -> tuple[int, int, int]:
        """First byte, stride and count of an accessor whose rows take ``width`` bytes."""
        accessor = self.entry("accessors", index)
        if "sparse" in accessor:
            raise UnsupportedError("sparse accessors are not read", where=where, hint=_PLAIN)
        view = self.entry("bufferViews", accessor.get("bufferView"))
        if "EXT_meshopt_compression" in _dict(view.get("extensions")):
            raise UnsupportedError("compressed data are not read", where=where, hint=_PLAIN)
        buffer = self.entry("buffers", view.get("buffer"))
        if view.get("buffer") != 0 or "uri" in buffer:
            raise UnsupportedError(
                "positions in another file are not read",
                where=where,
                hint="pack everything into the .glb file",
            )
        count = _whole(accessor, "count", where)
        stride = _whole(view, "byteStride", where, 0) or width
        within = _whole(accessor, "byteOffset", where, 0)
        offset = _whole(view, "byteOffset", where, 0)
        length = _whole(view, "byteLength", where)
        needed = within + stride * (count - 1) + width if count else within
        if stride < width or needed > length or offset + length > self.data_size:
            raise TruncatedError(
                f"{count} rows of {width} bytes do not fit where they are said to lie",
                where=where,
                hint=_HINT,
            )
        return self.data_at + offset + within, stride, count

    def _triples(self, index: object, where: str) -> Accessor | None:
        """An accessor of three float32; None if it is of another type."""
        entry = self.entry("accessors", index)
        if entry.get("componentType") != _FLOAT32 or entry.get("type") != "VEC3":
            return None
        at, stride, count = self._region(index, 12, where)
        assert isinstance(index, int)
        return Accessor(index, at, stride, count)

    def _corners(
        self, primitive: dict[str, Any], count: int, where: str, room: int
    ) -> NDArray[np.int64]:
        """The vertex numbers (k,) of a primitive, strips and fans not yet unrolled, k <= room."""
        if "indices" not in primitive:
            _require_room(count, room, where)
            return np.arange(count, dtype=np.int64)
        index = primitive["indices"]
        component = self.entry("accessors", index).get("componentType")
        code = _INDEX_TYPES.get(component) if isinstance(component, int) else None
        if code is None:
            raise FormatError("the indices have no integer type", where=where, hint=_HINT)
        width = np.dtype(code).itemsize
        at, stride, length = self._region(index, width, where)
        _require_room(length, room, where)
        found = np.ndarray((length,), code, self.data, at, (stride,)).astype(np.int64)
        if length and int(found.max()) >= count:
            raise ContentError(
                f"a face names vertex {int(found.max())} of {count}",
                code="E_INDEX",
                where=where,
                hint=_HINT,
            )
        return found

    def parts(self) -> tuple[list[Part], tuple[str, ...]]:
        """All surfaces, those over one list of positions together; and what to tell of them."""
        found: dict[int, list[Part]] = {}
        told: dict[str, None] = {}
        room = max(self.data_size, _ALWAYS_READ)
        for number in range(len(_list(self.content.get("meshes")))):
            primitives = self.entry("meshes", number).get("primitives")
            for k, primitive in enumerate(_list(primitives)):
                where = f"mesh {number}, primitive {k}"
                room -= self._add(found, told, number, _dict(primitive), where, room)
        parts = _apart([_joined(pieces, told) for pieces in found.values()], self.data_size, told)
        if not sum(len(part.faces) for part in parts):
            raise ContentError(
                "the file has no triangles",
                code="E_NO_FACES",
                hint="msal denoises surfaces; this file has none",
            )
        return parts, tuple(told)

    def _add(
        self,
        found: dict[int, list[Part]],
        told: dict[str, None],
        mesh: int,
        primitive: dict[str, Any],
        where: str,
        room: int,
    ) -> int:
        """Note a primitive; the number of its corners, of which there may be ``room``."""
        if "KHR_draco_mesh_compression" in _dict(primitive.get("extensions")):
            raise UnsupportedError("Draco compression is not read", where=where, hint=_PLAIN)
        mode = primitive.get("mode", _TRIANGLES)
        attributes = _dict(primitive.get("attributes"))
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            told["points and lines are kept as they are"] = None
            return 0
        if "POSITION" not in attributes:
            return 0
        positions = self._triples(attributes["POSITION"], where)
        if positions is not None and not positions.count:
            return 0
        if positions is None:
            raise UnsupportedError("quantised positions are not read", where=where, hint=_PLAIN)
        corners = self._corners(primitive, positions.count, where, room)
        normals = None
        if "NORMAL" in attributes:
            normals = self._triples(attributes["NORMAL"], where)
            if normals is None or normals.count != positions.count:
                normals = None
                told["normals that are not float32 are kept as they are"] = None
        if "TANGENT" in attributes:
            told["tangents are kept as they are"] = None
        if primitive.get("targets"):
            told["the displacements of morph targets are kept as they are"] = None
        part = Part(positions, _triangles(corners, mode), mesh, normals)
        found.setdefault(positions.index, []).append(part)
        return len(corners)

    def properties(self, parts: list[Part]) -> tuple[str, ...]:
        """What is carried along."""
        words = []
        if len(parts) > 1:
            words.append(f"{len(parts)} parts")
        names: dict[str, None] = {}
        for mesh in self.content["meshes"]:
            for primitive in _list(mesh.get("primitives")):
                names.update(dict.fromkeys(_dict(_dict(primitive).get("attributes"))))
        words += [f"vertex.{name}" for name in names if name != "POSITION"]
        for kind in ("materials", "textures", "images", "animations", "skins", "cameras"):
            if self.content.get(kind):
                words.append(kind)
        return tuple(words)

    def with_bounds(self, output: bytearray, accessors: list[Accessor]) -> bytes:
        """``output``, which has new positions, with the bounds of these accessors to match."""
        content = json.loads(json.dumps(self.content))
        for accessor in accessors:
            for word in self.bounds(accessor.index):
                content["accessors"][accessor.index][word] = accessor.bound(output, word)
        if content == self.content:
            return bytes(output)
        text = _as_json(content)
        text += b" " * (-len(text) % 4)
        rest = memoryview(output)[self.binary_at :]
        head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
        return b"".join([head, struct.pack("<II", len(text), _JSON), text, rest])


def _require_room(count: int, room: int, where: str) -> None:
    """Raise TooLargeError for more corners than ``room``.

    Any number of primitives may name the same indices, so that a small file can ask for more
    faces than a machine has memory.
    """
    if count > room:
        raise TooLargeError(
            "the primitives together have more corners than the file has bytes",
            where=where,
            hint="the file repeats the same faces; remove the copies",
        )


def _joined(pieces: list[Part], told: dict[str, None]) -> Part:
    """Primitives over the same positions as one part."""
    if len(pieces) == 1:
        return pieces[0]
    normals = pieces[0].normals
    if any(one.normals != normals for one in pieces):
        told["normals of parts that share positions are kept as they are"] = None
        normals = None
    faces = np.concatenate([one.faces for one in pieces])
    return Part(pieces[0].positions, faces, pieces[-1].mesh, normals)


def _apart(parts: list[Part], data_size: int, told: dict[str, None]) -> list[Part]:
    """The parts, without normals that two of them share; UnsupportedError if rows overlap."""
    used: set[int] = set()
    for k, part in enumerate(parts):
        if part.normals is not None and part.normals.index in used:
            told["normals that several parts share are kept as they are"] = None
            parts[k] = dataclasses.replace(part, normals=None)
        elif part.normals is not None:
            used.add(part.normals.index)
    regions = [own for part in parts for own in (part.positions, part.normals) if own is not None]
    # Rows that do not fit beside one another are not compared: there may be very many.
    is_overlap = sum(12 * own.count for own in regions) > data_size
    if len(regions) > 1 and not is_overlap:
        starts = [own.at + own.stride * np.arange(own.count, dtype=np.int64) for own in regions]
        is_overlap = bool((np.diff(np.sort(np.concatenate(starts))) < 12).any())
    if is_overlap:
        raise UnsupportedError(
            "lists of positions or normals overlap", where="accessors", hint=_PLAIN
        )
    return parts


def _as_json(content: dict[str, Any]) -> bytes:
    """The description as UTF-8; half a surrogate pair, which has none, stays an escape."""
    try:
        return json.dumps(content, separators=(",", ":"), ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return json.dumps(content, separators=(",", ":")).encode()


def _dict(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _whole(entry: dict[str, Any], key: str, where: str, default: int | None = None) -> int:
    value = entry.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**40:
        raise FormatError(f"{key} is {value!r}, not a count", where=where, hint=_HINT)
    return value


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    """Triangles (m, 3) of a list, strip or fan of corners."""
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), dtype=np.int64)
    one, two = corners[1:-1], corners[2:]
    if mode == _FAN:
        return np.stack([np.broadcast_to(corners[0], one.shape), one, two], axis=1)
    faces = np.stack([corners[:-2], one, two], axis=1)
    faces[1::2] = faces[1::2, [1, 0, 2]]
    return faces


def parsed(data: Buffer) -> Document:
    """Take a GLB file apart.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError, UnsupportedError
    """
    view = memoryview(data).cast("B")
    length = wanted_bytes(view, len(view))
    (size,) = struct.unpack_from("<I", view, 12)
    try:
        content = json.loads(bytes(view[20 : 20 + size]).decode("utf-8-sig"))
        json.dumps(content)  # what is nested too deeply to be written is refused at once
    except (ValueError, RecursionError) as failure:
        raise FormatError(
            f"the description is not JSON: {failure}", where="JSON chunk", hint=_HINT
        ) from None
    if not isinstance(content, dict):
        raise FormatError("the description is not a JSON object", where="JSON chunk", hint=_HINT)
    data_at, data_size = _binary_chunk(view, 20 + size, length)
    return Document(content, 20 + size, data_at, data_size, data)


def wanted_bytes(head: memoryview, total: int) -> int:
    """The bytes that a file of ``total`` bytes that begins with ``head`` should have.

    Raises
    ------
    FormatError, TruncatedError, TooLargeError, UnsupportedError
    """
    if total < 20:
        raise TruncatedError(f"the file has only {total} bytes", hint=_HINT)
    magic, version, length, size, kind = struct.unpack_from("<4sIIII", head)
    if magic != b"glTF" or (version == 2 and kind != _JSON):
        raise FormatError("the file does not begin as a GLB file does", where="byte 0", hint=_HINT)
    if version != 2:
        raise UnsupportedError(
            f"glTF version {version} is not read", hint="convert it to version 2"
        )
    if length > total or 20 + size > length:
        raise TruncatedError(
            f"the file should have {max(length, 20 + size)} bytes but has {total}",
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


def placed(document: Document, parts: list[Part]) -> list[Floats]:
    """The frame (4, 4) of each part in the scene, by the first node that shows its mesh.

    Identities if there is one part, or if a frame cannot be undone or understood: then all parts
    stay in their own.
    """
    own = [np.eye(4) for _ in parts]
    if len(parts) == 1:
        return own
    count = len(_list(document.content.get("nodes")))
    above: dict[int, int] = {}
    shows: dict[int, int] = {}
    try:
        for number in range(count):
            node = document.entry("nodes", number)
            for child in node.get("children", []):
                above.setdefault(int(child), number)
            if isinstance(node.get("mesh"), int):
                shows.setdefault(node["mesh"], number)
        with np.errstate(all="ignore"):
            known: dict[int, Floats] = {}
            frames = [_frame(document, above, known, shows.get(part.mesh)) for part in parts]
            if not all(_can_be_undone(frame) for frame in frames):
                return own
    except (TypeError, ValueError, OverflowError, FormatError, np.linalg.LinAlgError):
        return own
    return frames


def _can_be_undone(frame: Floats) -> bool:
    """Whether positions can be taken through a frame and back without harm."""
    largest = np.abs(frame).max()
    return bool(largest < _LARGEST and np.linalg.cond(frame[:3, :3]) < _STEEPEST)


def _frame(
    document: Document, above: dict[int, int], known: dict[int, Floats], node: int | None
) -> Floats:
    """The product of a node's transform and those above it; ``known`` remembers them."""
    path: list[int] = []
    while node is not None and node not in known and len(path) < _DEEPEST:
        path.append(node)
        node = above.get(node)
    frame = np.eye(4) if node is None else known.get(node, np.eye(4))
    for node in reversed(path):
        frame = frame @ _transform(document.entry("nodes", node))
        known[node] = frame
    return frame


def _transform(node: dict[str, Any]) -> Floats:
    """A node's own transform (4, 4): a matrix by columns, or translation, rotation and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    frame = np.eye(4)
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), dtype=np.float64)
    frame[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    frame[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    frame[:3, 3] = node.get("translation", (0, 0, 0))
    return frame
