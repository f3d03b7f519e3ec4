"""A glTF scene: where its surfaces lie, and where its nodes put them.

The JSON comes from strangers, so that every number taken from it is checked for its type and range
before it is used.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Longs
from msal_cli.codecs.gltf_json import as_dict, as_list
from msal_cli.codecs.record_slots import Strided
from msal_cli.errors import (
    EXPORT_AGAIN,
    ContentError,
    FormatError,
    MsalError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)

_FLOAT32 = 5126
_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_ALWAYS_READ = 1 << 16
"""Corners that are read however often the same ones are named; see ``_require_room``."""

_DEEPEST = 200
_PLAIN = "export it without compression, or convert it to PLY"


@dataclass(frozen=True)
class Accessor:
    """Rows of three float32: ``count`` rows, the first at byte ``at``, ``stride`` bytes apart.

    ``index`` is its number in the description.
    """

    index: int
    at: int
    stride: int
    count: int

    def slots(self, data: Bytes) -> Strided:
        """The rows in ``data``."""
        codes = ("<f4", "<f4", "<f4")
        return Strided(data, self.at, self.count, self.stride, (0, 4, 8), codes, whole_rows=True)


@dataclass(frozen=True, eq=False)
class Part:
    """Surfaces over one list of positions.

    Attributes
    ----------
    faces : triangles (m, 3) into the positions.
    mesh : the number of its mesh.
    normals : one to a position, if it has any that can be recomputed.
    source : the accessor and the mode that the triangles come from.
    """

    positions: Accessor
    faces: Longs
    mesh: int
    normals: Accessor | None
    source: tuple[object, object] = (None, None)

    def bounds(self, data: Bytes) -> dict[str, list[float]]:
        """The least and the largest of each coordinate in ``data``."""
        own = self.positions
        rows = np.ndarray((own.count, 3), "<f4", data, own.at, (own.stride, 4))
        # Column by column, because numpy reduces the first of two axes slowly.
        return {
            "min": [float(column.min()) for column in rows.T],
            "max": [float(column.max()) for column in rows.T],
        }


@dataclass(frozen=True, eq=False)
class Scene:
    """A description, and the bytes that it speaks of.

    Attributes
    ----------
    content : the description.
    data : (size,) uint8, the bytes of its buffers and perhaps more.
    buffers : first byte and size of each buffer in ``data``, or why it cannot be had; a buffer that
        the reader does not look for is left out.
    """

    content: dict[str, Any]
    data: Bytes
    buffers: dict[int, tuple[int, int] | MsalError]

    @property
    def _data_size(self) -> int:
        """Bytes in all buffers."""
        return sum(place[1] for place in self.buffers.values() if isinstance(place, tuple))

    def entry(self, kind: str, index: object) -> dict[str, Any]:
        """The entry ``index`` of the list ``kind``; FormatError if there is none."""
        entries = as_list(self.content.get(kind))
        if isinstance(index, int) and not isinstance(index, bool) and 0 <= index < len(entries):
            # Not a copy: a large entry may be named very often.
            entry = entries[index]
            if isinstance(entry, dict):
                return entry
        raise FormatError(f"there is no entry {index!r} in {kind}", where=kind, hint=EXPORT_AGAIN)

    def _accessor(self, index: object, width: int, where: str) -> Accessor:
        """The place of an accessor whose rows take ``width`` bytes."""
        accessor = self.entry("accessors", index)
        if "sparse" in accessor:
            raise UnsupportedError("sparse accessors are not read", where=where, hint=_PLAIN)
        view = self.entry("bufferViews", accessor.get("bufferView"))
        if "EXT_meshopt_compression" in as_dict(view.get("extensions")):
            raise UnsupportedError("compressed data are not read", where=where, hint=_PLAIN)
        number: Any = view.get("buffer")
        self.entry("buffers", number)
        place = self.buffers.get(number)
        if isinstance(place, MsalError):
            raise place
        if place is None:
            raise UnsupportedError(
                "positions in another file are not read",
                where=where,
                hint="pack everything into the .glb file, or export it as .gltf",
            )
        count = _whole(accessor, "count", where)
        stride = _whole(view, "byteStride", where, 0) or width
        within = _whole(accessor, "byteOffset", where, 0)
        offset = _whole(view, "byteOffset", where, 0)
        length = _whole(view, "byteLength", where)
        needed = within + stride * (count - 1) + width if count else within
        begin, size = place
        if stride < width or needed > length or offset + length > size:
            raise TruncatedError(
                f"{count} rows of {width} bytes do not fit where they are said to lie",
                where=where,
                hint=EXPORT_AGAIN,
            )
        assert isinstance(index, int)
        return Accessor(index, begin + offset + within, stride, count)

    def _triples(self, index: object, where: str) -> Accessor | None:
        """An accessor of three float32; None if it is of another type."""
        entry = self.entry("accessors", index)
        if entry.get("componentType") != _FLOAT32 or entry.get("type") != "VEC3":
            return None
        return self._accessor(index, 12, where)

    def _corners(self, primitive: dict[str, Any], count: int, where: str, room: int) -> Longs:
        """The vertex numbers (k,) of a primitive, strips and fans not yet unrolled, k <= room."""
        if "indices" not in primitive:
            _require_room(count, room, where)
            return np.arange(count, dtype=np.int64)
        index = primitive["indices"]
        component = self.entry("accessors", index).get("componentType")
        code = _INDEX_TYPES.get(component) if isinstance(component, int) else None
        if code is None:
            raise FormatError("the indices have no integer type", where=where, hint=EXPORT_AGAIN)
        accessor = self._accessor(index, np.dtype(code).itemsize, where)
        _require_room(accessor.count, room, where)
        shape, strides = (accessor.count,), (accessor.stride,)
        corners = np.ndarray(shape, code, self.data, accessor.at, strides).astype(np.int64)
        highest = int(corners.max(initial=-1))
        if highest >= count:
            raise ContentError(
                f"a face names vertex {highest} of {count}",
                code="E_INDEX",
                where=where,
                hint=EXPORT_AGAIN,
            )
        return corners

    def read_rows(self, index: object, codes: dict[int, str], width: int) -> NDArray[np.generic]:
        """The rows (count, width) of an accessor whose numbers have one of the types ``codes``."""
        where = f"accessor {index!r}"
        component = self.entry("accessors", index).get("componentType")
        code = codes.get(component) if isinstance(component, int) else None
        if code is None:
            raise FormatError("the numbers have another type", where=where, hint=EXPORT_AGAIN)
        size = np.dtype(code).itemsize
        place = self._accessor(index, size * width, where)
        shape, strides = (place.count, width), (place.stride, size)
        return np.ndarray(shape, code, self.data, place.at, strides)

    def read_view(self, index: object) -> bytes:
        """The bytes of a buffer view, such as an image."""
        where = f"bufferViews[{index!r}]"
        view = self.entry("bufferViews", index)
        number: Any = view.get("buffer")
        self.entry("buffers", number)
        place = self.buffers.get(number)
        offset = _whole(view, "byteOffset", where, 0)
        length = _whole(view, "byteLength", where)
        if not isinstance(place, tuple) or offset + length > place[1]:
            raise TruncatedError("the bytes are not in the file", where=where, hint=EXPORT_AGAIN)
        begin = place[0] + offset
        return self.data[begin : begin + length].tobytes()

    def parts(self) -> tuple[list[Part], tuple[str, ...]]:
        """All surfaces, those over one list of positions together, and warnings."""
        by_positions: dict[int, list[Part]] = {}
        notes: dict[str, None] = {}
        room = max(self._data_size, _ALWAYS_READ)
        for number in range(len(as_list(self.content.get("meshes")))):
            primitives = self.entry("meshes", number).get("primitives")
            for k, primitive in enumerate(as_list(primitives)):
                where = f"mesh {number}, primitive {k}"
                part, n_corners = self._part(notes, number, as_dict(primitive), where, room)
                room -= n_corners
                if part is not None:
                    by_positions.setdefault(part.positions.index, []).append(part)
        parts = [_merge(pieces, notes) for pieces in by_positions.values()]
        _separate(parts, self._data_size, notes)
        if not sum(len(part.faces) for part in parts):
            raise ContentError(
                "the file has no triangles",
                code="E_NO_FACES",
                hint="msal denoises surfaces; this file has none",
            )
        return parts, tuple(notes)

    def _part(
        self, notes: dict[str, None], mesh: int, primitive: dict[str, Any], where: str, room: int
    ) -> tuple[Part | None, int]:
        """The surface of a primitive, and the number of its corners, at most ``room``."""
        if "KHR_draco_mesh_compression" in as_dict(primitive.get("extensions")):
            raise UnsupportedError("Draco compression is not read", where=where, hint=_PLAIN)
        mode = primitive.get("mode", _TRIANGLES)
        attributes = as_dict(primitive.get("attributes"))
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            notes["points and lines are kept as they are"] = None
            return None, 0
        if "POSITION" not in attributes:
            return None, 0
        positions = self._triples(attributes["POSITION"], where)
        if positions is None:
            raise UnsupportedError("quantised positions are not read", where=where, hint=_PLAIN)
        if not positions.count:
            return None, 0
        corners = self._corners(primitive, positions.count, where, room)
        normals = None
        if "NORMAL" in attributes:
            normals = self._triples(attributes["NORMAL"], where)
            if normals is None or normals.count != positions.count:
                normals = None
                notes["normals that are not float32 are kept as they are"] = None
        if "TANGENT" in attributes:
            notes["tangents are kept as they are"] = None
        if primitive.get("targets"):
            notes["the displacements of morph targets are kept as they are"] = None
        source = primitive.get("indices"), mode
        return Part(positions, _triangles(corners, mode), mesh, normals, source), len(corners)

    def properties(self) -> tuple[str, ...]:
        """What is carried along."""
        words = []
        names: dict[str, None] = {}
        for mesh in self.content["meshes"]:
            for primitive in as_list(mesh.get("primitives")):
                names.update(dict.fromkeys(as_dict(as_dict(primitive).get("attributes"))))
        words += [f"vertex.{name}" for name in names if name != "POSITION"]
        meshes = [as_dict(node).get("mesh") for node in as_list(self.content.get("nodes"))]
        numbers = [mesh for mesh in meshes if isinstance(mesh, int)]
        if len(set(numbers)) < len(numbers):
            words.append("instances")
        for kind in ("materials", "textures", "images", "animations", "skins", "cameras"):
            if self.content.get(kind):
                words.append(kind)
        return tuple(words)

    def references(self) -> tuple[str, ...]:
        """Images in files of their own."""
        uris = [as_dict(image).get("uri") for image in as_list(self.content.get("images"))]
        return tuple(
            dict.fromkeys(
                unquote(uri) for uri in uris if isinstance(uri, str) and uri and not has_scheme(uri)
            )
        )

    def frames(self, parts: list[Part]) -> list[Floats]:
        """The frame (4, 4) of each part, by the first node that shows its mesh.

        Identities if a frame is not understood.
        """
        parents: dict[int, int] = {}
        shown_by: dict[int, int] = {}
        try:
            for number in range(len(as_list(self.content.get("nodes")))):
                node = self.entry("nodes", number)
                for child in node.get("children", []):
                    parents.setdefault(int(child), number)
                if isinstance(node.get("mesh"), int):
                    shown_by.setdefault(node["mesh"], number)
            with np.errstate(all="ignore"):
                known: dict[int, Floats] = {}
                return [self._frame(parents, known, shown_by.get(part.mesh)) for part in parts]
        except (TypeError, ValueError, OverflowError, FormatError):
            return [np.eye(4) for _ in parts]

    def _frame(self, parents: dict[int, int], known: dict[int, Floats], node: int | None) -> Floats:
        """The product of a node's transform and those above it; ``known`` remembers them."""
        path: list[int] = []
        while node is not None and node not in known and len(path) < _DEEPEST:
            path.append(node)
            node = parents.get(node)
        frame = np.eye(4) if node is None else known.get(node, np.eye(4))
        for node in reversed(path):
            frame = frame @ _transform(self.entry("nodes", node))
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


def has_scheme(uri: str) -> bool:
    """Whether a reference is more than a path: ``data:``, ``https:`` ..."""
    return re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", uri) is not None


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


def _merge(pieces: list[Part], notes: dict[str, None]) -> Part:
    """Primitives over the same positions as one part, the same triangles once: a mesh that is twice
    in a file, with other materials perhaps, is one surface."""
    if len(pieces) == 1:
        return pieces[0]
    normals = pieces[0].normals
    if any(one.normals != normals for one in pieces):
        notes["normals of parts that share positions are kept as they are"] = None
        normals = None
    distinct = {one.source: one.faces for one in pieces}
    faces = np.concatenate(list(distinct.values()))
    return Part(pieces[0].positions, faces, pieces[-1].mesh, normals)


def _separate(parts: list[Part], data_size: int, notes: dict[str, None]) -> None:
    """Drop normals that two of the parts share; raise UnsupportedError if rows overlap."""
    used: set[int] = set()
    for k, part in enumerate(parts):
        if part.normals is not None and part.normals.index in used:
            notes["normals that several parts share are kept as they are"] = None
            parts[k] = dataclasses.replace(part, normals=None)
        elif part.normals is not None:
            used.add(part.normals.index)
    regions = [one for part in parts for one in (part.positions, part.normals) if one is not None]
    # Rows that do not fit beside one another are not compared: there may be very many.
    is_overlap = sum(12 * one.count for one in regions) > data_size
    if len(regions) > 1 and not is_overlap:
        starts = [one.at + one.stride * np.arange(one.count, dtype=np.int64) for one in regions]
        is_overlap = bool((np.diff(np.sort(np.concatenate(starts))) < 12).any())
    if is_overlap:
        raise UnsupportedError(
            "lists of positions or normals overlap", where="accessors", hint=_PLAIN
        )


def _whole(entry: dict[str, Any], key: str, where: str, default: int | None = None) -> int:
    value = entry.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**40:
        raise FormatError(f"{key} is {value!r}, not a count", where=where, hint=EXPORT_AGAIN)
    return value


def _triangles(corners: Longs, mode: int) -> Longs:
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
