"""The description of a glTF scene: the places of its surfaces, its transforms, and its text.

The JSON is untrusted: every number from it is checked for type and range before use.  If a few of
its values are replaced, all other text stays as it is: spaces, the order of keys, the form of
numbers.  The text is decoded as Latin-1, whatever it is, so that each character is one byte.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from msal_cli import errors
from msal_cli.arrays import Bytes, Floats, Ints
from msal_cli.codecs.slots import Strided
from msal_cli.codecs.text_slots import Span, replace_spans
from msal_cli.light_dataclass import dataclass, field

_MAX_TEXT_BYTES = 64 << 20
"""Longest description that is read; very large scenes have a few megabytes.  In memory it may take
thirty times its size."""

_GAP = re.compile(r"[ \t\n\r,:]*")
_decoder = json.JSONDecoder()


def parse_json(data: bytes, where: str) -> dict[str, Any]:
    try:
        content = json.loads(data.decode().removeprefix("\ufeff"))
        json.dumps(content)  # fails at once for content that is nested too deeply
    except (ValueError, RecursionError) as failure:
        raise errors.damaged(f"the description is not JSON: {str(failure)[:200]}", where) from None
    if not isinstance(content, dict):
        raise errors.damaged("the description is not a JSON object", where)
    return content


def require_short(size: int, where: str = "") -> None:
    """Raise TooLargeError for a description of ``size`` bytes that is too long."""
    if size > _MAX_TEXT_BYTES:
        raise errors.TooLargeError(
            f"the description has {size:,} bytes, more than the {_MAX_TEXT_BYTES:,} that are read",
            where=where,
            hint="it holds more than a mesh; export the mesh alone",
        )


def as_dict(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def as_list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def as_dicts(value: object) -> list[dict[str, Any]]:
    return [as_dict(element) for element in as_list(value)]


def _find_values(text: str, at: int) -> Iterator[tuple[str, Span]]:
    """The keys and places of the values in the object or list that begins at ``at`` of valid JSON;
    in a list keys are empty."""
    is_object = text[at] == "{"
    at = _skip_gap(text, at + 1)
    while text[at] not in "}]":
        key = ""
        if is_object:
            key, at = _decoder.raw_decode(text, at)
            at = _skip_gap(text, at)
        start, at = at, _decoder.raw_decode(text, at)[1]
        yield key, (start, at)
        at = _skip_gap(text, at)


def _skip_gap(text: str, at: int) -> int:
    match = _GAP.match(text, at)
    return match.end() if match else at


def find_entries(text: str, kind: str) -> list[dict[str, Span]]:
    """The places of the values of each entry of the list ``kind`` in a description, by keys.

    ``text`` must be a JSON object, and its value of ``kind`` a list of objects.  Of equal keys the
    last one counts, as for every reader.
    """
    spans = dict(_find_values(text, text.index("{")))
    if kind not in spans:
        return []
    entries = _find_values(text, spans[kind][0])
    return [dict(_find_values(text, at)) if text[at] == "{" else {} for _, (at, _) in entries]


def write_bound(old: str, new: list[float]) -> str:
    """The text ``old`` of a bound with the numbers ``new``.

    If it has three numbers, those that are the same in float32 keep their text.
    """
    value = json.loads(old, parse_int=float)
    if not isinstance(value, list) or [type(number) for number in value] != 3 * [float]:
        return old if value == new else json.dumps(new)
    with np.errstate(all="ignore"):
        stored = np.array(value).astype(np.float32).tolist()
    spans = zip(_find_values(old, 0), stored, new, strict=True)
    return replace_spans(old, [(span, json.dumps(x)) for (_, span), was, x in spans if was != x])


_FLOAT_TYPES = {5126: "<f4"}
_POSITION_TYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", **_FLOAT_TYPES}
"""The whole-number types are those of the extension KHR_mesh_quantization."""

_INDEX_TYPES = {5121: "<u1", 5123: "<u2", 5125: "<u4"}
_COLUMNS = {"VEC3": 3, "VEC4": 4}
_TRIANGLES, _STRIP, _FAN = _SURFACES = 4, 5, 6
_ALWAYS_READ = 1 << 16
"""Corners that are read from any file, however small; see ``Scene.read_parts``."""

_MAX_DEPTH = 200
_PLAIN = "export it without compression, or convert it to PLY"


@dataclass(frozen=True)
class Accessor:
    """Rows of numbers: ``count`` rows, the first at byte ``at``, ``stride`` bytes apart.

    ``index`` is its number in the description; several may have the same rows.  A stored number,
    of numpy's type ``code``, is multiplied by ``unit``.
    """

    index: object = field(compare=False)
    at: int
    stride: int
    count: int
    columns: int
    code: str
    unit: float

    @property
    def width(self) -> int:
        """Bytes of a row."""
        return self.columns * np.dtype(self.code).itemsize

    def rows(self, data: Bytes) -> NDArray[Any]:
        """The rows (count, columns) in ``data``, a view."""
        strides = self.stride, self.width // self.columns
        return np.ndarray((self.count, self.columns), self.code, data, self.at, strides)

    def slots(self, data: Bytes) -> Strided:
        """The slots of the rows, which have three numbers each."""
        places = 0, self.width // 3, 2 * self.width // 3
        codes = (self.code,) * 3
        return Strided(data, self.at, self.count, self.stride, places, codes, whole_rows=True)


@dataclass(eq=False)
class Part:
    """Surfaces over one list of positions."""

    positions: Accessor
    # one per position; None if some primitives have other ones, or they cannot be recomputed
    normals: Accessor | None
    # the numbers of the meshes that have it, the first one first
    meshes: dict[int, None] = field(default_factory=dict)
    # the numbers of all accessors of its positions
    accessors: dict[Any, None] = field(default_factory=dict)
    # (m, 3) indices of positions, by the mode and the indices that they were made from, so that a
    # mesh which occurs twice in a file, perhaps with other materials, is read once
    triangles: dict[object, Ints] = field(default_factory=dict)


@dataclass(eq=False)
class Scene:
    """A description, and the bytes that it refers to."""

    content: dict[str, Any]  # the description
    data: Bytes  # (size,) uint8, the bytes of its buffers and perhaps more
    # first byte and size of each buffer in ``data``, or the error for it; a buffer that the reader
    # does not look for is left out
    buffers: Mapping[int, tuple[int, int] | errors.MsalError]
    # the surfaces by their positions; filled by ``read_parts``
    parts: dict[Accessor, Part] = field(default_factory=dict)
    notes: dict[str, None] = field(default_factory=dict)  # warnings, each once

    def entry(self, kind: str, index: object) -> dict[str, Any]:
        """The entry ``index`` of the list ``kind``; FormatError if there is none."""
        entries = as_list(self.content.get(kind))
        if isinstance(index, int) and not isinstance(index, bool) and 0 <= index < len(entries):
            # Not a copy: a large entry may be referred to very often.
            entry = entries[index]
            if isinstance(entry, dict):
                return entry
        raise errors.damaged(f"there is no entry {index!r} in {kind}", kind)

    def find_rows(
        self, index: object, codes: Mapping[int, str], type: str, where: str
    ) -> Accessor | None:
        """The rows of an accessor; None if its number type is none of ``codes``, or if its rows are
        not of the ``type``, which is not checked if it is empty."""
        accessor = self.entry("accessors", index)
        component = accessor.get("componentType")
        code = codes.get(component) if isinstance(component, int) else None
        if code is None or (type and accessor.get("type") != type):
            return None
        if "sparse" in accessor:
            raise errors.UnsupportedError("sparse accessors are not read", where=where, hint=_PLAIN)
        view = self.entry("bufferViews", accessor.get("bufferView"))
        if "EXT_meshopt_compression" in as_dict(view.get("extensions")):
            raise errors.UnsupportedError("compressed data are not read", where=where, hint=_PLAIN)
        number: Any = view.get("buffer")
        self.entry("buffers", number)
        place = self.buffers.get(number)
        if isinstance(place, errors.MsalError):
            raise place
        if place is None:
            raise errors.UnsupportedError(
                "positions in another file are not read",
                where=where,
                hint="pack everything into the .glb file, or export it as .gltf",
            )
        columns = _COLUMNS.get(type, 1)
        width = columns * np.dtype(code).itemsize
        count = _whole(accessor, "count", where)
        stride = _whole(view, "byteStride", where, 0) or width
        within = _whole(accessor, "byteOffset", where, 0)
        offset = _whole(view, "byteOffset", where, 0)
        length = _whole(view, "byteLength", where)
        needed = within + stride * (count - 1) + width if count else within
        begin, size = place
        if stride < width or needed > length or offset + length > size:
            raise errors.TruncatedError(
                f"{count:,} rows of {width} bytes do not fit where they are said to lie",
                where=where,
                hint=errors.EXPORT_AGAIN,
            )
        is_share = accessor.get("normalized") is True and code != "<f4"
        unit = 1.0 / np.iinfo(code).max if is_share else 1.0
        return Accessor(index, begin + offset + within, stride, count, columns, code, unit)

    def read_parts(self) -> None:
        """Find all surfaces; those over the same positions become one part."""
        size = sum(place[1] for place in self.buffers.values() if isinstance(place, tuple))
        room = max(size, _ALWAYS_READ)
        for mesh in range(len(as_list(self.content.get("meshes")))):
            primitives = as_dicts(self.entry("meshes", mesh).get("primitives"))
            for k, primitive in enumerate(primitives):
                where = f"mesh {mesh}, primitive {k}"
                part = self._find_part(mesh, primitive, where)
                if part is None:
                    continue
                indices = None
                count = n_corners = part.positions.count
                if "indices" in primitive:
                    indices = self.find_rows(primitive["indices"], _INDEX_TYPES, "", where)
                    if indices is None:
                        raise errors.damaged("the indices have no integer type", where)
                    n_corners = indices.count
                source = primitive.get("mode", _TRIANGLES), indices
                if source in part.triangles:
                    continue
                # Any positions can be combined with any indices, so that a small file can ask for
                # more faces than fit into memory.
                if n_corners > room:
                    raise errors.TooLargeError(
                        "the primitives together have more corners than the file has bytes",
                        where=where,
                        hint="the same indices are used with very many lists of positions; export "
                        "the mesh alone",
                    )
                room -= n_corners
                corners = np.arange(count) if indices is None else indices.rows(self.data)[:, 0]
                if n_corners and (highest := int(corners.max())) >= count:
                    raise errors.bad_index(f"a face names vertex {highest} of {count:,}", where)
                part.triangles[source] = _triangles(corners.astype(np.int32), source[0])
        self._refuse_overlaps(size)
        if not any(len(faces) for part in self.parts.values() for faces in part.triangles.values()):
            for k, entry in enumerate(as_dicts(self.content.get("meshes"))):
                if not isinstance(entry.get("primitives"), list):
                    raise errors.damaged("'primitives' is no list", f"mesh {k}")
            raise errors.no_faces("the file has no triangles")

    def _find_part(self, mesh: int, primitive: dict[str, Any], where: str) -> Part | None:
        """The part for the positions of a primitive; None if the primitive is no surface."""
        if "KHR_draco_mesh_compression" in as_dict(primitive.get("extensions")):
            raise errors.UnsupportedError("Draco compression is not read", where=where, hint=_PLAIN)
        attributes = as_dict(primitive.get("attributes"))
        if primitive.get("mode", _TRIANGLES) not in _SURFACES:
            self.notes["points and lines are kept as they are"] = None
            return None
        if "POSITION" not in attributes:
            return None
        positions = self.find_rows(attributes["POSITION"], _POSITION_TYPES, "VEC3", where)
        if positions is None:
            raise errors.UnsupportedError(
                "the positions have a type that glTF does not allow", where=where, hint=_PLAIN
            )
        if not positions.count:
            return None
        if positions.code != "<f4":
            self.notes["positions are whole numbers (quantised): new ones are rounded"] = None
        normals = None
        if "NORMAL" in attributes:
            normals = self.find_rows(attributes["NORMAL"], _FLOAT_TYPES, "VEC3", where)
            if normals is None or normals.count != positions.count:
                normals = None
                self.notes["normals that are not float32 are kept as they are"] = None
        if "TANGENT" in attributes:
            self.notes["tangents are kept as they are"] = None
        if primitive.get("targets"):
            self.notes["the displacements of morph targets are kept as they are"] = None
        part = self.parts.setdefault(positions, Part(positions, normals))
        part.meshes[mesh] = None
        part.accessors[positions.index] = None
        if part.normals != normals:
            self.notes["normals of parts that share positions are kept as they are"] = None
            part.normals = None
        return part

    def _refuse_overlaps(self, data_size: int) -> None:
        """Drop normals that two of the parts share; raise UnsupportedError if rows overlap."""
        parts = self.parts.values()
        used: set[Accessor] = set()
        for part in parts:
            if part.normals in used:
                self.notes["normals that several parts share are kept as they are"] = None
                part.normals = None
            elif part.normals is not None:
                used.add(part.normals)
        regions = [rows for part in parts for rows in (part.positions, part.normals) if rows]
        # Rows that cannot all lie side by side are not compared: there may be very many.
        is_overlap = sum(rows.width * rows.count for rows in regions) > data_size
        if len(regions) > 1 and not is_overlap:
            starts = np.concatenate(
                [rows.at + rows.stride * np.arange(rows.count) for rows in regions]
            )
            widths = np.repeat([rows.width for rows in regions], [rows.count for rows in regions])
            order = np.argsort(starts)
            is_overlap = bool((np.diff(starts[order]) < widths[order][:-1]).any())
        if is_overlap:
            raise errors.UnsupportedError(
                "lists of positions or normals overlap",
                where="accessors",
                hint="export each mesh with lists of its own, or convert it to PLY",
            )

    def properties(self) -> tuple[str, ...]:
        """What is kept unchanged, for reports."""
        names: dict[str, None] = {}
        others: dict[str, None] = {}
        for mesh in self.content["meshes"]:
            for primitive in as_dicts(mesh.get("primitives")):
                names.update(dict.fromkeys(as_dict(primitive.get("attributes"))))
                if primitive.get("targets"):
                    others["morph targets"] = None
                if primitive.get("mode", _TRIANGLES) not in _SURFACES:
                    others["points and lines"] = None
        words = [f"vertex.{name}" for name in names if name != "POSITION"]
        meshes = [node.get("mesh") for node in as_dicts(self.content.get("nodes"))]
        shown = Counter(mesh for mesh in meshes if isinstance(mesh, int))
        copies = [sum(shown[mesh] for mesh in part.meshes) for part in self.parts.values()]
        if n_more := sum(copies) - sum(map(bool, copies)):
            words.insert(
                0, f"instances ({errors.format_count(n_more, 'more place')} of the same surfaces)"
            )
        kinds = ("materials", "textures", "images", "animations", "skins", "cameras")
        return (*words, *others, *(kind for kind in kinds if self.content.get(kind)))

    def references(self) -> tuple[str, ...]:
        """The image files that the scene refers to."""
        uris = [image.get("uri") for image in as_dicts(self.content.get("images"))]
        paths = [uri for uri in uris if isinstance(uri, str) and uri and not has_scheme(uri)]
        return tuple(dict.fromkeys(map(unquote, paths)))

    def frames(self) -> list[Floats]:
        """The frame (4, 4) of each part, by the first node with its mesh; else identities."""
        parents: dict[int, int] = {}
        shown_by: dict[int, int] = {}
        products: dict[int | None, Floats] = {}
        result = []
        try:
            for number in range(len(as_list(self.content.get("nodes")))):
                entry = self.entry("nodes", number)
                for child in entry.get("children", []):
                    parents.setdefault(int(child), number)
                if isinstance(entry.get("mesh"), int):
                    shown_by.setdefault(entry["mesh"], number)
            with np.errstate(all="ignore"):
                for rows, part in self.parts.items():
                    node = shown_by.get(next(iter(part.meshes)))
                    chain: list[int] = []
                    while node is not None and node not in products and len(chain) < _MAX_DEPTH:
                        chain.append(node)
                        node = parents.get(node)
                    frame = products.get(node, np.eye(4))
                    for number in reversed(chain):
                        frame = products[number] = frame @ _transform(self.entry("nodes", number))
                    result.append(frame @ np.diag([rows.unit] * 3 + [1.0]))
        except (TypeError, ValueError, OverflowError, errors.FormatError):
            return [np.eye(4) for _ in self.parts]
        return result


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
    """Whether a reference has a scheme (``data:``, ``https:`` ...), so that it is not a path."""
    return re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", uri) is not None


def _whole(entry: dict[str, Any], key: str, where: str, default: int | None = None) -> int:
    value = entry.get(key, default)
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 2**40:
        raise errors.damaged(f"{key} is {value!r}, not a count", where)
    return value


def _triangles(corners: Ints, mode: int) -> Ints:
    """Triangles (m, 3) of a list, strip or fan of corners."""
    if mode == _TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    first, second, third = corners[:-2], corners[1:-1], corners[2:]
    if mode == _FAN:
        first = np.broadcast_to(corners[:1], third.shape)
    faces = np.stack([first, second, third], axis=1)
    if mode == _STRIP:
        faces[1::2] = faces[1::2, [1, 0, 2]]
    return faces
