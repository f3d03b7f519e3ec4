"""The description of a glTF scene: where its surfaces lie.

The JSON comes from strangers, so that every number taken from it is checked for its type and range
before it is used.
"""

from __future__ import annotations

import dataclasses
import json
import re
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats
from msal_cli.codecs.gltf_text import Edit, bound_edits, edited, entry_spans, kept_bound
from msal_cli.errors import (
    EXPORT_AGAIN,
    ContentError,
    FormatError,
    MsalError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)
from msal_cli.storage.buffers import Buffer

_FLOAT32 = 5126
_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
MOST_JSON = 64 << 20
"""Longest description that is read; those of very large scenes have a few megabytes, and in memory
it may take thirty times its size."""

_ALWAYS_READ = 1 << 16
"""Corners that are read however often the same ones are named; see ``_require_room``."""

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
    its normals, one to a position, if it has any that can be recomputed.

    ``source`` is the accessor and the mode that the triangles come from.
    """

    positions: Accessor
    faces: NDArray[np.int64]
    mesh: int
    normals: Accessor | None
    source: tuple[object, object] = (None, None)


@dataclass(frozen=True, eq=False)
class Document:
    """A description, and the bytes that it speaks of.

    Attributes
    ----------
    content, text : the description, and how it is written.
    binary_at : the first byte of ``data`` behind the description, 0 where it is a file of its own.
    places : where the content of each buffer lies in ``data``, first byte and size; those buffers
        that cannot be had are left out.
    data : the bytes of the file, or of the buffers.
    failures : why buffers cannot be had.
    """

    content: dict[str, Any]
    text: str
    binary_at: int
    places: dict[int, tuple[int, int]]
    data: Buffer
    failures: dict[int, MsalError] = field(default_factory=dict)

    @property
    def data_size(self) -> int:
        """Bytes in all buffers."""
        return sum(size for _, size in self.places.values())

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
            raise FormatError(
                f"there is no entry {index!r} in {kind}", where=kind, hint=EXPORT_AGAIN
            )
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
        if "EXT_meshopt_compression" in as_dict(view.get("extensions")):
            raise UnsupportedError("compressed data are not read", where=where, hint=_PLAIN)
        number = view.get("buffer")
        self.entry("buffers", number)
        if number in self.failures:
            raise self.failures[number]
        if number not in self.places:
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
        begin, size = self.places[number]
        if stride < width or needed > length or offset + length > size:
            raise TruncatedError(
                f"{count} rows of {width} bytes do not fit where they are said to lie",
                where=where,
                hint=EXPORT_AGAIN,
            )
        return begin + offset + within, stride, count

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
            raise FormatError("the indices have no integer type", where=where, hint=EXPORT_AGAIN)
        width = np.dtype(code).itemsize
        at, stride, length = self._region(index, width, where)
        _require_room(length, room, where)
        found = np.ndarray((length,), code, self.data, at, (stride,)).astype(np.int64)
        if length and int(found.max()) >= count:
            raise ContentError(
                f"a face names vertex {int(found.max())} of {count}",
                code="E_INDEX",
                where=where,
                hint=EXPORT_AGAIN,
            )
        return found

    def parts(self) -> tuple[list[Part], tuple[str, ...]]:
        """All surfaces, those over one list of positions together; and what to tell of them."""
        found: dict[int, list[Part]] = {}
        notes: dict[str, None] = {}
        room = max(self.data_size, _ALWAYS_READ)
        for number in range(len(as_list(self.content.get("meshes")))):
            primitives = self.entry("meshes", number).get("primitives")
            for k, primitive in enumerate(as_list(primitives)):
                where = f"mesh {number}, primitive {k}"
                room -= self._add(found, notes, number, as_dict(primitive), where, room)
        parts = _apart([_joined(pieces, notes) for pieces in found.values()], self.data_size, notes)
        if not sum(len(part.faces) for part in parts):
            raise ContentError(
                "the file has no triangles",
                code="E_NO_FACES",
                hint="msal denoises surfaces; this file has none",
            )
        return parts, tuple(notes)

    def _add(
        self,
        found: dict[int, list[Part]],
        notes: dict[str, None],
        mesh: int,
        primitive: dict[str, Any],
        where: str,
        room: int,
    ) -> int:
        """Note a primitive; the number of its corners, of which there may be ``room``."""
        if "KHR_draco_mesh_compression" in as_dict(primitive.get("extensions")):
            raise UnsupportedError("Draco compression is not read", where=where, hint=_PLAIN)
        mode = primitive.get("mode", _TRIANGLES)
        attributes = as_dict(primitive.get("attributes"))
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            notes["points and lines are kept as they are"] = None
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
                notes["normals that are not float32 are kept as they are"] = None
        if "TANGENT" in attributes:
            notes["tangents are kept as they are"] = None
        if primitive.get("targets"):
            notes["the displacements of morph targets are kept as they are"] = None
        source = primitive.get("indices"), mode
        part = Part(positions, _triangles(corners, mode), mesh, normals, source)
        found.setdefault(positions.index, []).append(part)
        return len(corners)

    def properties(self, parts: list[Part]) -> tuple[str, ...]:
        """What is carried along."""
        words = []
        if len(parts) > 1:
            words.append(f"{len(parts)} parts")
        names: dict[str, None] = {}
        for mesh in self.content["meshes"]:
            for primitive in as_list(mesh.get("primitives")):
                names.update(dict.fromkeys(as_dict(as_dict(primitive).get("attributes"))))
        words += [f"vertex.{name}" for name in names if name != "POSITION"]
        if self._has_instances():
            words.append("instances")
        for kind in ("materials", "textures", "images", "animations", "skins", "cameras"):
            if self.content.get(kind):
                words.append(kind)
        return tuple(words)

    def _has_instances(self) -> bool:
        """Whether a mesh is shown by more than one node."""
        shown = [as_dict(node).get("mesh") for node in as_list(self.content.get("nodes"))]
        meshes = [number for number in shown if isinstance(number, int)]
        return len(set(meshes)) < len(meshes)

    def references(self) -> tuple[str, ...]:
        """Images in files of their own."""
        found: dict[str, None] = {}
        for image in as_list(self.content.get("images")):
            uri = as_dict(image).get("uri")
            if isinstance(uri, str) and uri and not has_scheme(uri):
                found[unquote(uri)] = None
        return tuple(found)

    def bounded(self, output: Buffer, accessors: list[Accessor]) -> str:
        """The text with the bounds of these accessors to match their rows in ``output``."""
        return edited(self.text, self.bound_edits(output, accessors))

    def bound_edits(self, output: Buffer, accessors: list[Accessor]) -> list[Edit]:
        """The edits of the text that make the bounds of these accessors match their rows."""
        spans = entry_spans(self.text, "accessors")
        edits: list[Edit] = []
        for accessor in accessors:
            for word, old in self.bounds(accessor.index).items():
                new = accessor.bound(output, word)
                edits += bound_edits(self.text, spans[accessor.index][word], old, new)
        return edits

    def bounded_content(self, output: Buffer, accessors: list[Accessor]) -> dict[str, Any]:
        """What ``bounded`` should be read as."""
        content: dict[str, Any] = json.loads(json.dumps(self.content))
        for accessor in accessors:
            for word, old in self.bounds(accessor.index).items():
                new = accessor.bound(output, word)
                content["accessors"][accessor.index][word] = kept_bound(old, new)
        return content


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


def _joined(pieces: list[Part], notes: dict[str, None]) -> Part:
    """Primitives over the same positions as one part, the same triangles once: a mesh that stands
    twice in a file, with other materials perhaps, is one surface."""
    if len(pieces) == 1:
        return pieces[0]
    normals = pieces[0].normals
    if any(one.normals != normals for one in pieces):
        notes["normals of parts that share positions are kept as they are"] = None
        normals = None
    distinct = {one.source: one.faces for one in pieces}
    faces = np.concatenate(list(distinct.values()))
    return Part(pieces[0].positions, faces, pieces[-1].mesh, normals)


def _apart(parts: list[Part], data_size: int, notes: dict[str, None]) -> list[Part]:
    """The parts, without normals that two of them share; UnsupportedError if rows overlap."""
    used: set[int] = set()
    for k, part in enumerate(parts):
        if part.normals is not None and part.normals.index in used:
            notes["normals that several parts share are kept as they are"] = None
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


def parsed_description(data: bytes, where: str) -> tuple[str, dict[str, Any]]:
    """The text of a description, and what it says.

    Raises
    ------
    FormatError
    """
    try:
        text = data.decode()
        content = json.loads(text.removeprefix("\ufeff"))
        json.dumps(content)  # what is nested too deeply to be written is refused at once
    except (ValueError, RecursionError) as failure:
        said = str(failure)[:200]
        raise FormatError(
            f"the description is not JSON: {said}", where=where, hint=EXPORT_AGAIN
        ) from None
    if not isinstance(content, dict):
        raise FormatError("the description is not a JSON object", where=where, hint=EXPORT_AGAIN)
    return text, content


def as_dict(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def as_list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _whole(entry: dict[str, Any], key: str, where: str, default: int | None = None) -> int:
    value = entry.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**40:
        raise FormatError(f"{key} is {value!r}, not a count", where=where, hint=EXPORT_AGAIN)
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
