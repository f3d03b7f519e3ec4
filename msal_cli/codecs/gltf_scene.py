"""The description of a glTF scene: where its surfaces lie, where its nodes put them, and its text.

The JSON comes from strangers, so that every number taken from it is checked for its type and range
before it is used.  Where a few of its values are replaced all other text stays as it is: spaces,
the order of keys, how numbers are written.  That text is Latin-1 here, whatever it is, so that each
character is one byte.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Longs
from msal_cli.codecs.slots import Strided
from msal_cli.errors import (
    EXPORT_AGAIN,
    ContentError,
    FormatError,
    MsalError,
    TooLargeError,
    TruncatedError,
    UnsupportedError,
)

Span = tuple[int, int]
"""The first character of a value, and the one behind its last."""

_MAX_TEXT_BYTES = 64 << 20
"""Longest description that is read; those of very large scenes have a few megabytes, and in memory
it may take thirty times its size."""

_SPACE = re.compile(r"[ \t\n\r]*")
_decoder = json.JSONDecoder()


def parse_json(data: bytes, where: str) -> dict[str, Any]:
    try:
        content = json.loads(data.decode().removeprefix("\ufeff"))
        json.dumps(content)  # what is nested too deeply to be written is refused at once
    except (ValueError, RecursionError) as failure:
        said = str(failure)[:200]
        raise FormatError(
            f"the description is not JSON: {said}", where=where, hint=EXPORT_AGAIN
        ) from None
    if not isinstance(content, dict):
        raise FormatError("the description is not a JSON object", where=where, hint=EXPORT_AGAIN)
    return content


def require_short(size: int, where: str = "") -> None:
    """Raise TooLargeError for a description of ``size`` bytes that is too long."""
    if size > _MAX_TEXT_BYTES:
        raise TooLargeError(
            f"the description has {size:,} bytes, more than the {_MAX_TEXT_BYTES:,} that are read",
            where=where,
            hint="it holds more than a mesh; export the mesh alone",
        )


def as_dict(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def as_list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _skip_space(text: str, at: int) -> int:
    match = _SPACE.match(text, at)
    return match.end() if match else at


def _find_members(text: str, at: int) -> Iterator[tuple[str, Span]]:
    """The keys of the object that begins at ``at``, and where their values lie."""
    at = _skip_space(text, at + 1)
    while text[at] != "}":
        key, at = _decoder.raw_decode(text, at)
        start = _skip_space(text, _skip_space(text, at) + 1)
        at = _decoder.raw_decode(text, start)[1]
        yield key, (start, at)
        at = _skip_space(text, at)
        if text[at] == ",":
            at = _skip_space(text, at + 1)


def find_elements(text: str, at: int) -> Iterator[Span]:
    """Where the elements lie of the list that begins at ``at``."""
    at = _skip_space(text, at + 1)
    while text[at] != "]":
        start, at = at, _decoder.raw_decode(text, at)[1]
        yield start, at
        at = _skip_space(text, at)
        if text[at] == ",":
            at = _skip_space(text, at + 1)


def find_entries(text: str, kind: str) -> list[dict[str, Span]]:
    """Where the values of each entry of the list ``kind`` lie in a description, by their keys.

    ``text`` is known to be an object of JSON, and its value of ``kind`` to be a list of objects;
    of keys that stand twice the last one counts, as for every reader.
    """
    start = _skip_space(text, 3 * text.startswith("\xef\xbb\xbf"))
    spans = dict(_find_members(text, start))
    if kind not in spans:
        return []
    entries = find_elements(text, spans[kind][0])
    return [dict(_find_members(text, at)) if text[at] == "{" else {} for at, _ in entries]


def write_bound(old: str, new: list[float]) -> str:
    """The text ``old`` of a bound with the numbers ``new``.

    Of three numbers, those that are the same as float32 keep their text.
    """
    value = json.loads(old)
    is_triple = (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
    )
    if not is_triple:
        return old if value == new else json.dumps(new)
    spans = zip(find_elements(old, 0), value, new, strict=True)
    return replace_spans(
        old, ((span, json.dumps(now)) for span, was, now in spans if _as_float32(was) != now)
    )


def _as_float32(value: float) -> float:
    import numpy as np

    try:
        with np.errstate(all="ignore"):
            return float(np.float32(value))
    except OverflowError:  # an integer beyond float64
        return float("inf")


def replace_spans(text: str, edits: Iterable[tuple[Span, str]]) -> str:
    """``text`` with other text at some places."""
    pieces, done = [], 0
    for (start, stop), new in sorted(edits):
        pieces += [text[done:start], new]
        done = stop
    return "".join([*pieces, text[done:]])


_FLOAT_TYPES = {5126: "<f4"}
_POSITION_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", **_FLOAT_TYPES}
"""Those of whole numbers are of the extension KHR_mesh_quantization."""

_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_ALWAYS_READ = 1 << 16
"""Corners that are read however small the file is; see ``_require_room``."""

_MAX_DEPTH = 200
_PLAIN = "export it without compression, or convert it to PLY"


@dataclass(frozen=True)
class Accessor:
    """Rows of three numbers: ``count`` rows, the first at byte ``at``, ``stride`` bytes apart.

    ``index`` is its number in the description; several may have the same rows.  A number of numpy's
    type ``code`` stands for ``unit`` times what is stored.
    """

    index: int = field(compare=False)
    at: int
    stride: int
    count: int
    code: str = "<f4"
    unit: float = 1.0

    @property
    def width(self) -> int:
        return 3 * np.dtype(self.code).itemsize

    def rows(self, data: Bytes) -> NDArray[Any]:
        """The rows (n, 3) in ``data``, a view."""
        strides = self.stride, self.width // 3
        return np.ndarray((self.count, 3), self.code, data, self.at, strides)

    def slots(self, data: Bytes) -> Strided:
        """Where the rows are in ``data``."""
        places = 0, self.width // 3, 2 * self.width // 3
        codes = (self.code,) * 3
        return Strided(data, self.at, self.count, self.stride, places, codes, whole_rows=True)


@dataclass(frozen=True, eq=False)
class Part:
    """Surfaces over one list of positions.

    Attributes
    ----------
    faces : triangles (m, 3) into the positions.
    mesh : the number of its mesh.
    normals : one to a position, if it has any that can be recomputed.
    accessors : the numbers of all accessors that its positions have.
    """

    positions: Accessor
    faces: Longs
    mesh: int
    normals: Accessor | None
    accessors: tuple[int, ...]

    def bounds(self, data: Bytes) -> dict[str, list[float]]:
        """The least and the largest of each coordinate in ``data``."""
        # Column by column, because numpy reduces the first of two axes slowly.
        columns = self.positions.rows(data).T
        return {
            "min": [column.min().item() for column in columns],
            "max": [column.max().item() for column in columns],
        }


@dataclass(eq=False)
class _Surfaces:
    """All primitives over one list of positions, whichever ``accessors`` it has.

    Attributes
    ----------
    normals : those of every primitive, None where they differ.
    mesh : the number of the first mesh.
    triangles : (m, 3) by the indices and the mode that they come from, so that a mesh that is twice
        in a file, with other materials perhaps, is read once.
    """

    positions: Accessor
    normals: Accessor | None
    mesh: int
    triangles: dict[object, Longs] = field(default_factory=dict)
    accessors: dict[int, None] = field(default_factory=dict)

    def join(self) -> Part:
        triangles = list(self.triangles.values())
        faces = triangles[0] if len(triangles) == 1 else np.concatenate(triangles)
        return Part(self.positions, faces, self.mesh, self.normals, tuple(self.accessors))


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

    def _triples(self, index: object, codes: dict[int, str], where: str) -> Accessor | None:
        """An accessor of three numbers of one of the types ``codes``; None if it is of another."""
        entry = self.entry("accessors", index)
        component = entry.get("componentType")
        code = codes.get(component) if isinstance(component, int) else None
        if code is None or entry.get("type") != "VEC3":
            return None
        is_share = entry.get("normalized") is True and code != "<f4"
        unit = 1.0 / np.iinfo(code).max if is_share else 1.0
        accessor = self._accessor(index, 3 * np.dtype(code).itemsize, where)
        return dataclasses.replace(accessor, code=code, unit=unit)

    def _indices(self, primitive: dict[str, Any], where: str) -> tuple[Accessor, str] | None:
        """The vertex numbers of a primitive, and numpy's type of them; None for all in turn."""
        if "indices" not in primitive:
            return None
        index = primitive["indices"]
        component = self.entry("accessors", index).get("componentType")
        code = _INDEX_TYPES.get(component) if isinstance(component, int) else None
        if code is None:
            raise FormatError("the indices have no integer type", where=where, hint=EXPORT_AGAIN)
        return self._accessor(index, np.dtype(code).itemsize, where), code

    def _corners(self, indices: tuple[Accessor, str] | None, count: int, where: str) -> Longs:
        """The vertex numbers (k,) of a primitive of ``count`` vertices, strips not unrolled."""
        if indices is None:
            return np.arange(count, dtype=np.int64)
        own, code = indices
        corners = np.ndarray((own.count,), code, self.data, own.at, (own.stride,)).astype(np.int64)
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

    def parts(self) -> tuple[list[Part], tuple[str, ...]]:
        """All surfaces, those over one list of positions together, and warnings."""
        surfaces: dict[Accessor, _Surfaces] = {}
        notes: dict[str, None] = {}
        room = max(self._data_size, _ALWAYS_READ)
        for number in range(len(as_list(self.content.get("meshes")))):
            primitives = self.entry("meshes", number).get("primitives")
            for k, primitive in enumerate(as_list(primitives)):
                where = f"mesh {number}, primitive {k}"
                room -= self._add_primitive(
                    surfaces, notes, number, as_dict(primitive), where, room
                )
        parts = [own.join() for own in surfaces.values()]
        _separate(parts, self._data_size, notes)
        if not sum(len(part.faces) for part in parts):
            raise ContentError(
                "the file has no triangles",
                code="E_NO_FACES",
                hint="msal denoises surfaces; this file has none",
            )
        return parts, tuple(notes)

    def _add_primitive(
        self,
        surfaces: dict[Accessor, _Surfaces],
        notes: dict[str, None],
        mesh: int,
        primitive: dict[str, Any],
        where: str,
        room: int,
    ) -> int:
        """Add a primitive to those over the same positions; returns the number of corners that were
        read, at most ``room``."""
        if "KHR_draco_mesh_compression" in as_dict(primitive.get("extensions")):
            raise UnsupportedError("Draco compression is not read", where=where, hint=_PLAIN)
        mode = primitive.get("mode", _TRIANGLES)
        attributes = as_dict(primitive.get("attributes"))
        if mode not in (_TRIANGLES, _STRIP, _FAN):
            notes["points and lines are kept as they are"] = None
            return 0
        if "POSITION" not in attributes:
            return 0
        positions = self._triples(attributes["POSITION"], _POSITION_TYPES, where)
        if positions is None:
            raise UnsupportedError(
                "the positions have a type that glTF does not allow", where=where, hint=_PLAIN
            )
        if not positions.count:
            return 0
        if positions.code != "<f4":
            notes["positions are whole numbers (quantised): new ones are rounded"] = None
        normals = None
        if "NORMAL" in attributes:
            normals = self._triples(attributes["NORMAL"], _FLOAT_TYPES, where)
            if normals is None or normals.count != positions.count:
                normals = None
                notes["normals that are not float32 are kept as they are"] = None
        if "TANGENT" in attributes:
            notes["tangents are kept as they are"] = None
        if primitive.get("targets"):
            notes["the displacements of morph targets are kept as they are"] = None
        own = surfaces.setdefault(positions, _Surfaces(positions, normals, mesh))
        own.accessors[positions.index] = None
        if own.normals != normals:
            notes["normals of parts that share positions are kept as they are"] = None
            own.normals = None
        indices = self._indices(primitive, where)
        source = mode, indices and (indices[0].at, indices[0].stride, indices[0].count, indices[1])
        if source in own.triangles:
            return 0
        n_corners = positions.count if indices is None else indices[0].count
        _require_room(n_corners, room, where)
        corners = self._corners(indices, positions.count, where)
        own.triangles[source] = _triangles(corners, mode)
        return n_corners

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
                units = (np.diag([*3 * [part.positions.unit], 1.0]) for part in parts)
                return [
                    self._frame(parents, known, shown_by.get(part.mesh)) @ unit
                    for part, unit in zip(parts, units, strict=True)
                ]
        except (TypeError, ValueError, OverflowError, FormatError):
            return [np.eye(4) for _ in parts]

    def _frame(self, parents: dict[int, int], known: dict[int, Floats], node: int | None) -> Floats:
        """The product of a node's transform and those above it; ``known`` remembers them."""
        path: list[int] = []
        while node is not None and node not in known and len(path) < _MAX_DEPTH:
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

    Any number of lists of positions may be joined with any number of lists of indices, so that a
    small file can ask for more faces than a machine has memory.
    """
    if count > room:
        raise TooLargeError(
            "the primitives together have more corners than the file has bytes",
            where=where,
            hint="the same indices are used with very many lists of positions; export the mesh "
            "alone",
        )


def _separate(parts: list[Part], data_size: int, notes: dict[str, None]) -> None:
    """Drop normals that two of the parts share; raise UnsupportedError if rows overlap."""
    used: set[Accessor] = set()
    for k, part in enumerate(parts):
        if part.normals is not None and part.normals in used:
            notes["normals that several parts share are kept as they are"] = None
            parts[k] = dataclasses.replace(part, normals=None)
        elif part.normals is not None:
            used.add(part.normals)
    regions = [
        slots for part in parts for slots in (part.positions, part.normals) if slots is not None
    ]
    # Rows that do not fit beside one another are not compared: there may be very many.
    is_overlap = sum(region.width * region.count for region in regions) > data_size
    if len(regions) > 1 and not is_overlap:
        starts = np.concatenate(
            [
                region.at + region.stride * np.arange(region.count, dtype=np.int64)
                for region in regions
            ]
        )
        widths = np.repeat(
            [region.width for region in regions], [region.count for region in regions]
        )
        order = np.argsort(starts)
        is_overlap = bool((np.diff(starts[order]) < widths[order][:-1]).any())
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
