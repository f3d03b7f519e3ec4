"""VTK's XML files (``.vtu``, ``.vtp``): points and normals replaced inside the original bytes.

Read are unstructured grids and polygonal data in pieces, their arrays as text, base64 or raw
bytes, not compressed or compressed with zlib or LZMA.  A new array is written as the old one was.
"""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli import errors
from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs import text_slots
from msal_cli.codecs.mesh_file import Layout, MeshFile
from msal_cli.codecs.slots import Change, Slots, to_type
from msal_cli.codecs.vtk import Cells
from msal_cli.codecs.xml_tree import Element, parse_tree
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED, MAX_RATIO
from msal_cli.storage.regular import Buffer, memory_bytes

_CODES = {
    f"{sign}Int{bits}": f"{code}{bits // 8}"
    for sign, code in (("", "i"), ("U", "u"))
    for bits in (8, 16, 32, 64)
} | {"Float32": "f4", "Float64": "f8"}
_MAX_LZMA_BYTES = 256 << 20
_BLANKS = b" \t\r\n"
_TOO_SHORT = "an array ends before all its bytes are there"


class Coding:
    """How a file stores arrays: ``order`` of bytes, type of the ``header`` numbers, and the name of
    the ``compressor``."""

    def __init__(self, data: Buffer, root: Element, appended: re.Match[bytes] | None) -> None:
        self.data = data
        self.compressor = root.attributes.get("compressor", "")
        if self.compressor not in _COMPRESSORS:
            raise errors.UnsupportedError(
                f"arrays compressed by {self.compressor[:40]} are not read",
                hint="write the file with zlib compression, or with none",
            )
        order = {"LittleEndian": "<", "BigEndian": ">"}.get(root.attributes.get("byte_order", ""))
        header = {"UInt32": "u4", "UInt64": "u8"}.get(root.attributes.get("header_type", "UInt32"))
        if order is None or header is None:
            raise errors.damaged("byte_order or header_type is wrong", "line 1")
        self.order, self.header = order, order + header
        self.appended_at = appended.end() if appended else -1
        self._is_raw = appended is not None and appended[1] == b"raw"
        self._expanded_bytes = 0

    @property
    def head_bytes(self) -> int:
        """Bytes before an array: its size or, if it is compressed, three numbers of its blocks."""
        return np.dtype(self.header).itemsize * (3 if self.compressor else 1)

    def expand(self, size: int, packed: int, at: int) -> None:
        """Count an array of ``size`` bytes that is stored in ``packed``; TooLargeError beyond what
        one array, or all arrays together, may expand to."""
        self._expanded_bytes += size
        of_all = max(ALWAYS_EXPANDED, MAX_RATIO * len(self.data))
        if size > max(ALWAYS_EXPANDED, MAX_RATIO * packed) or self._expanded_bytes > min(
            of_all, memory_bytes() // 2
        ):
            raise errors.TooLargeError(
                f"an array of {packed:,} bytes expands to {size:,}, and all to "
                f"{self._expanded_bytes:,}",
                where=f"byte {at}",
                hint="write the file without compression if it is what it should be",
            )

    def place(self, array: Element) -> tuple[int, int, bool]:
        """The first byte of an array, the last that it may have, and whether it is raw."""
        if array.attributes.get("format") != "appended":
            return array.inside, array.text_stop, False
        offset = array.attributes.get("offset", "").strip()
        if self.appended_at < 0 or not re.fullmatch(r"[0-9]{1,18}", offset):
            raise errors.damaged(
                "an array is said to be appended, but is not", f"byte {array.start}"
            )
        return self.appended_at + int(offset), len(self.data), self._is_raw

    def code_of(self, array: Element) -> str:
        """numpy's type of an array's numbers."""
        kind = array.attributes.get("type", "")
        if kind not in _CODES:
            raise errors.UnsupportedError(
                f"numbers of the type {kind[:40]!r} are not read", where=f"byte {array.start}"
            )
        return self.order + _CODES[kind]

    def integers(self, array: Element) -> NDArray[np.int64]:
        """All whole numbers of an array (k,)."""
        code = self.code_of(array)
        if array.attributes.get("format", "ascii") == "ascii":
            return text_slots.Words(self.data, array.inside, array.text_stop).integers(slice(None))
        content = self.decode(array)[0]
        if len(content) % np.dtype(code).itemsize:
            raise errors.damaged("an array is cut", f"byte {array.start}")
        return np.frombuffer(content, dtype=code).astype(np.int64)

    def numbers(self, array: Element, count: int, *, are_normals: bool = False) -> XmlSlots:
        """The rows (count, 3) of an array of floating-point numbers."""
        code = self.code_of(array)
        if code[1] != "f":
            raise errors.UnsupportedError(
                f"positions are stored as {array.attributes['type']}",
                where=f"byte {array.start}",
                hint="write them as Float32 or Float64",
            )
        if array.attributes.get("format", "ascii") == "ascii":
            words = text_slots.Words(self.data, array.inside, array.text_stop)
            _require_count(len(words), 3 * count, array)
            rows = words.float_rows(np.arange(0, 3 * count, 3), unit_length=are_normals)
            return TextNumbers(
                rows.data,
                rows.at,
                values=rows.values,
                unit_length=are_normals,
                start=array.inside,
                stop=array.text_stop,
            )
        return EncodedNumbers(self, array, code, count)

    def decode(self, array: Element) -> tuple[Buffer, int, int]:
        """The bytes of an array, and between which bytes of the file it and its header are."""
        start, stop, is_raw = self.place(array)
        view = memoryview(self.data).cast("B")[:stop]
        source = _Source(view, start, is_raw=is_raw)
        width = np.dtype(self.header).itemsize
        head = source.take(self.head_bytes)
        counts = np.frombuffer(head, dtype=self.header).tolist()
        if not self.compressor:
            content = source.take(counts[0])
            self.expand(len(content), len(content), start)
            return content, source.first, source.at
        n_blocks, block_bytes, last_bytes = counts
        if n_blocks * width > stop - start:
            raise _cut("blocks are missing", start)
        sizes = np.frombuffer(source.take(n_blocks * width), dtype=self.header).tolist()
        source.begin_data()
        packed = sum(sizes)
        total = (n_blocks - 1) * block_bytes + (last_bytes or block_bytes) if n_blocks else 0
        self.expand(total, packed, start)
        content = b"".join(
            _expanded(
                source.take(size),
                last_bytes if last_bytes and k == n_blocks - 1 else block_bytes,
                self.compressor,
                start,
            )
            for k, size in enumerate(sizes)
        )
        return content, source.first, source.at


def _require_count(there: int, wanted: int, array: Element) -> None:
    if there != wanted:
        kind = errors.TruncatedError if there < wanted else errors.FormatError
        raise kind(
            f"an array holds {there:,} numbers or bytes where {wanted:,} are counted",
            where=f"byte {array.start}",
            hint=errors.EXPORT_AGAIN,
        )


@dataclass(eq=False)
class TextNumbers(text_slots.TextSlots):
    """An array of words between the bytes ``start`` and ``stop``."""

    start: int
    stop: int

    def encode(self, values: Floats, is_changed: Flags) -> bytes:
        """The bytes of the array with new values (n, 3)."""
        return bytes(text_slots.replace_statements(*self._plan(values, is_changed)))

    def require(self, new: XmlSlots, values: Floats, is_changed: Flags) -> None:
        """Raise InternalError unless ``new``, of another file, is what ``encode`` makes."""
        assert isinstance(new, TextNumbers)
        data, patches = self._plan(values, is_changed)
        text_slots.require_replaced(data, new.data[new.start : new.stop], patches)

    def _plan(self, values: Floats, is_changed: Flags) -> tuple[Bytes, list[text_slots.Patch]]:
        patches = text_slots.plan_patches([Change(self, values, is_changed)])
        own = [patch._replace(at=patch.at - self.start) for patch in patches]
        return self.data[self.start : self.stop], own


class EncodedNumbers(Slots):
    """An array that is replaced as a whole, since it may be compressed or written in base64;
    ``start`` and ``stop`` are as of ``TextNumbers``."""

    def __init__(self, coding: Coding, array: Element, code: str, count: int) -> None:
        content, self.start, self.stop = coding.decode(array)
        _require_count(len(content), 3 * np.dtype(code).itemsize * count, array)
        self.codes = (code,) * 3
        self._rows = np.frombuffer(content, dtype=code).reshape(-1, 3)
        self.values = self._rows.astype(np.float64)
        self._coding, self._is_raw = coding, coding.place(array)[2]

    def encode(self, values: Floats, is_changed: Flags) -> bytes:
        """The bytes of the array with new values (n, 3), compressed and written as those that they
        replace."""
        return self._pack(self._new_content(values))

    def require(self, new: XmlSlots, values: Floats, is_changed: Flags) -> None:
        """Raise InternalError unless ``new``, of another file, is what ``encode`` makes."""
        assert isinstance(new, EncodedNumbers)
        if new._rows.tobytes() != self._new_content(values):
            raise errors.InternalError(
                "an array of the file that was made is not what it should be"
            )

    def _new_content(self, values: Floats) -> bytes:
        # Rows that did not move keep their bits, the signs of zeros included.
        is_same = (values == self.values).all(axis=1)[:, None]
        new = np.where(is_same, self._rows, to_type(values, self.codes[0]))
        return new.astype(self._rows.dtype).tobytes()

    def _pack(self, content: bytes) -> bytes:
        coding = self._coding
        view = memoryview(coding.data).cast("B")[: self.stop]
        source = _Source(view, self.start, is_raw=self._is_raw)
        head = source.take(coding.head_bytes)
        is_split = source.is_split
        if coding.compressor:
            block_bytes = max(1, int(np.frombuffer(head, dtype=coding.header)[1]))
            blocks = [content[at : at + block_bytes] for at in range(0, len(content), block_bytes)]
            pack = zlib.compress if coding.compressor == "vtkZLibDataCompressor" else lzma.compress
            packed = [pack(block) for block in blocks]
            counts = [len(blocks), block_bytes, len(content) % block_bytes, *map(len, packed)]
            head = np.array(counts, dtype=coding.header).tobytes()
            content, is_split = b"".join(packed), True
        if self._is_raw:
            return head + content
        if is_split:
            return base64.b64encode(head) + base64.b64encode(content)
        return base64.b64encode(head + content)


XmlSlots = TextNumbers | EncodedNumbers


def _expanded(block: bytes, size: int, compressor: str, at: int) -> bytes:
    try:
        if compressor == "vtkZLibDataCompressor":
            content = zlib.decompressobj().decompress(block, size + 1)
        else:
            limit = lzma.LZMADecompressor(memlimit=_MAX_LZMA_BYTES)
            content = limit.decompress(block, size + 1)
    except (zlib.error, lzma.LZMAError) as failure:
        raise errors.damaged(f"a compressed array is damaged: {failure}", f"byte {at}") from None
    if len(content) != size:
        raise errors.damaged("a compressed block has another size than it says", f"byte {at}")
    return content


class _Source:
    """Bytes taken one behind the other, raw or from base64, whose header may be a piece of its own.

    ``first`` is where they begin, ``at`` the byte behind what was taken, and ``is_split`` whether
    base64 ended within them.
    """

    def __init__(self, view: memoryview, at: int, *, is_raw: bool) -> None:
        while not is_raw and at < len(view) and view[at] in _BLANKS:
            at += 1
        self.first = self.at = at
        self.is_split = False
        self._view = view
        self._is_raw = is_raw
        self._left = b""

    def take(self, size: int) -> bytes:
        missing = size - len(self._left)
        n_bytes = missing if self._is_raw else 4 * -(-missing // 3)
        if size < 0 or self.at + max(n_bytes, 0) > len(self._view):
            raise _cut(_TOO_SHORT, len(self._view))
        if missing > 0:
            piece = bytes(self._view[self.at : self.at + n_bytes])
            try:
                self._left += piece if self._is_raw else base64.b64decode(piece, validate=True)
            except binascii.Error:
                raise errors.damaged("an array is not base64", f"byte {self.at}") from None
            self.at += n_bytes
            self.is_split |= not self._is_raw and piece.endswith(b"=")
        if len(self._left) < size:
            raise _cut(_TOO_SHORT, self.at)
        result, self._left = self._left[:size], self._left[size:]
        return result

    def begin_data(self) -> None:
        """Compressed data are a piece of base64 of their own."""
        self._left = b""


def _cut(message: str, at: int) -> errors.TruncatedError:
    return errors.TruncatedError(message, where=f"byte {at}", hint=errors.EXPORT_AGAIN)


Shift = Callable[[int], int]
"""By how many bytes a place of the input moves, new positions and normals being written."""

Text = Callable[[bytes, Sequence[Floats], Shift], bytes]
"""``text(old, positions, shift)`` are the bytes that stand for ``old``."""


class Dependent(NamedTuple):
    """Bytes that depend on positions: counts of bytes up to a place, or bounds."""

    start: int
    stop: int
    text: Text


@dataclass(eq=False, kw_only=True)
class XmlLayout(Layout):
    """``dependents`` are what changes with positions, none of it inside an array of theirs."""

    dependents: tuple[Dependent, ...]

    @property
    def arrays(self) -> list[XmlSlots]:
        """All positions and normals."""
        return [*self.positions, *self.normals]  # type: ignore[list-item]


class VtkXmlFile(MeshFile):
    """An opened VTU or VTP file; see ``mesh_file.MeshFile`` for the attributes."""

    _layout: XmlLayout

    def __init__(self, data: Buffer, format: str) -> None:
        super().__init__(data, format, _parse(format, data))

    def _write(self, changes: Sequence[Change], vertices: Floats) -> bytes:
        edits = [
            (slots.start, slots.stop, slots.encode(values, is_changed))
            for slots, values, is_changed in changes
        ]
        edits += self._dependent_texts(vertices, _shift_by(edits))
        pieces: list[Buffer] = []
        done = 0
        for start, stop, new in sorted(edits):
            pieces += [memoryview(self._data)[done:start], new]
            done = stop
        return b"".join([*pieces, memoryview(self._data)[done:]])

    def _compare(self, result: Bytes, changes: Sequence[Change], vertices: Floats) -> None:
        if not changes:
            super()._compare(result, changes, vertices)
            return
        what = f"the {self.format} file that was made"
        output = result.tobytes()
        try:
            there = _parse(self.format, output)
        except errors.MsalError as failure:
            raise errors.InternalError(f"{what} cannot be read: {failure}") from failure
        ours, theirs = self._layout.arrays, there.arrays
        shapes = [[(type(slots), slots.values.shape) for slots in own] for own in (ours, theirs)]
        if shapes[0] != shapes[1] or len(there.dependents) != len(self._layout.dependents):
            raise errors.InternalError(f"{what} has other arrays")
        edits, places = [], []
        for slots, values, is_changed in changes:
            new = theirs[next(i for i, own in enumerate(ours) if own is slots)]
            slots.require(new, values, is_changed)
            edits.append((slots.start, slots.stop, output[new.start : new.stop]))
            places.append((new.start, new.stop))
        edits += self._dependent_texts(vertices, _shift_by(edits))
        places += [(dependent.start, dependent.stop) for dependent in there.dependents]
        for (_, _, text), (start, stop) in zip(edits, places, strict=True):
            if output[start:stop] != text:
                raise errors.InternalError(f"an attribute of {what} is not what it should be")
        if _rest(self._data, [edit[:2] for edit in edits]) != _rest(output, places):
            raise errors.InternalError(f"{what} differs in more than positions and normals")

    def _dependent_texts(self, vertices: Floats, shift: Shift) -> list[tuple[int, int, bytes]]:
        """What depends on positions, and the bytes that it should have."""
        positions, view = self._to_file(vertices), memoryview(self._data)
        return [
            (start, stop, text(bytes(view[start:stop]), positions, shift))
            for start, stop, text in self._layout.dependents
        ]


def _shift_by(edits: Sequence[tuple[int, int, bytes]]) -> Shift:
    growths = [(stop, len(new) - (stop - start)) for start, stop, new in edits]
    return lambda at: sum(growth for stop, growth in growths if stop <= at)


def _rest(data: Buffer, spans: Sequence[tuple[int, int]]) -> bytes:
    view = memoryview(data)
    starts, stops = zip(*sorted(spans), strict=True)
    return b"".join(view[at:to] for at, to in zip((0, *stops), (*starts, None), strict=True))


_TYPES = {"vtu": "UnstructuredGrid", "vtp": "PolyData"}
_COMPRESSORS = ("", "vtkZLibDataCompressor", "vtkLZMADataCompressor")
_APPENDED = re.compile(rb"<AppendedData(?:\s+encoding\s*=\s*[\"'](\w+)[\"'])?\s*>\s*_")
_POLYGONS = (("Verts", "vertex"), ("Lines", "line"), ("Strips", "strip"), ("Polys", "polygon"))


def _parse(format: str, data: Buffer) -> XmlLayout:
    """Read a VTU or VTP file.

    Raises UnsupportedError for another compression, another type of VTK file, and curved cells,
    TooLargeError for an array that expands to more than any mesh does.
    """
    appended = _APPENDED.search(data)
    root = parse_tree(data, appended.start() if appended else None)
    kind = root.attributes.get("type", "")
    if root.name != "VTKFile" or not kind:
        raise errors.damaged("the file is no VTKFile", "line 1")
    if kind != _TYPES[format]:
        suffix = {one: name for name, one in _TYPES.items()}.get(kind)
        if suffix is None:
            raise errors.UnsupportedError(f"a VTKFile of the type {kind[:40]!r} is not read")
        raise errors.FormatError(f"a {kind} is a .{suffix} file", hint=f"rename it to .{suffix}")
    coding = Coding(data, root, appended)
    grid = root.find(kind)
    pieces = list(grid.all("Piece")) if grid is not None else []
    parts = [part for part in (_Piece(piece, coding) for piece in pieces) if part.n_points]
    if not parts:
        raise errors.ContentError(
            "the file has no points", code="E_NO_FACES", hint="check the program that writes it"
        )
    starts = np.cumsum([0, *(part.n_points for part in parts)])
    corners = [part.cells.corners() + start for part, start in zip(parts, starts, strict=False)]
    normals = [part.normals for part in parts if part.normals is not None]
    warnings = [warning for part in parts for warning in part.cells.warnings()]
    if 0 < len(normals) < len(parts):
        normals = []
        warnings.append("normals are kept as they are, since not all pieces have them")
    cell_data = (piece.find("CellData") for piece in pieces)
    if any(piece is not None and _named(piece, "normals") is not None for piece in cell_data):
        warnings.append("normals of cells are kept as they are")
    is_text = any(part.points_array.attributes.get("format") == "ascii" for part in parts)
    codes = {coding.code_of(part.points_array) for part in parts}
    return XmlLayout(
        "ascii" if is_text else "binary",
        "float64" if coding.order + "f8" in codes else "float32",
        tuple(part.points for part in parts),
        np.concatenate(corners),
        np.concatenate([part.cells.sizes() for part in parts]),
        tuple(normals),
        properties=tuple(dict.fromkeys(name for part in parts for name in part.properties)),
        warnings=tuple(dict.fromkeys(warnings)),
        held=", ".join(filter(None, (part.cells.describe() for part in parts))),
        dependents=(
            *_offsets(data, root, coding),
            *(end for k, part in enumerate(parts) for end in _ranges(data, part.points_array, k)),
        ),
    )


class _Piece:
    """A piece of a grid."""

    def __init__(self, piece: Element, coding: Coding) -> None:
        self.n_points = _count(piece, "NumberOfPoints")
        self.cells = Cells()
        self.normals: XmlSlots | None = None
        self.properties: list[str] = []
        if not self.n_points:
            return
        holder = piece.find("Points")
        points = None if holder is None else holder.find("DataArray")
        if points is None or points.attributes.get("NumberOfComponents") != "3":
            raise errors.damaged(
                "a piece has no points of three coordinates", f"byte {piece.start}"
            )
        self.points_array = points
        self.points = coding.numbers(points, self.n_points)
        cells = piece.find("Cells")
        if cells is not None:
            types = coding.integers(_array(cells, "types"))
            self.cells.add_types(types, *_lists(cells, coding))
        for name, kind in _POLYGONS:
            group = piece.find(name)
            if group is not None and _count(piece, f"NumberOf{name}"):
                self.cells.add(kind, *_lists(group, coding))
        for owner, group in (("point", piece.find("PointData")), ("cell", piece.find("CellData"))):
            names = [array.attributes.get("Name", "") for array in group.children] if group else []
            self.properties += [f"{owner}.{name}" for name in names]
        group = piece.find("PointData")
        array = None if group is None else _named(group, group.attributes.get("Normals", "normals"))
        if array is not None and coding.code_of(array)[1] == "f":
            self.normals = coding.numbers(array, self.n_points, are_normals=True)


def _named(group: Element, name: str) -> Element | None:
    """The array of three components of this name, in any case."""
    for array in group.all("DataArray"):
        own = array.attributes
        if own.get("Name", "").lower() == name.lower() and own.get("NumberOfComponents") == "3":
            return array
    return None


def _count(piece: Element, name: str) -> int:
    word = piece.attributes.get(name, "0").strip()
    if not re.fullmatch(r"[0-9]{1,18}", word):
        raise errors.damaged(f"{name} is no number", f"byte {piece.start}")
    return int(word)


def _array(group: Element, name: str) -> Element:
    for array in group.all("DataArray"):
        if array.attributes.get("Name") == name:
            return array
    raise errors.damaged(f"there is no array {name}", f"byte {group.start}")


def _lists(group: Element, coding: Coding) -> tuple[Longs, Longs]:
    sizes = np.diff(coding.integers(_array(group, "offsets")), prepend=0)
    corners = coding.integers(_array(group, "connectivity"))
    if (sizes < 0).any() or sizes.sum() > len(corners):
        raise errors.damaged("the offsets of cells are wrong", f"byte {group.start}")
    return sizes, corners[: sizes.sum()]


def _offsets(data: Buffer, root: Element, coding: Coding) -> list[Dependent]:
    """The offsets of appended arrays, which move with the size of those in front of them."""
    if coding.appended_at < 0 or not coding.compressor:
        return []
    base = coding.appended_at

    def shifted(at: int) -> Text:
        def text(old: bytes, positions: Sequence[Floats], shift: Shift) -> bytes:
            change = shift(at) - shift(base)
            return str(at - base + change).encode() if change else old

        return text

    return [
        Dependent(*place, shifted(coding.place(array)[0]))
        for array in root.inner()
        if array.attributes.get("format") == "appended"
        and (place := array.attribute_places(data).get("offset"))
    ]


def _ranges(data: Buffer, array: Element, which: int) -> list[Dependent]:
    """The smallest and largest distance from the origin, which VTK writes beside points."""

    def distance(reduce: Callable[[Floats], Any]) -> Text:
        def text(old: bytes, positions: Sequence[Floats], shift: Shift) -> bytes:
            points = positions[which]
            with np.errstate(over="ignore"):
                lengths = np.sqrt((points * points).sum(axis=1))
            return repr(float(reduce(lengths))).encode()

        return text

    texts = distance(np.min), distance(np.max)
    found = array.attribute_places(data)
    places = [found.get(name) for name in ("RangeMin", "RangeMax")]
    bounds = [Dependent(*at, text) for at, text in zip(places, texts, strict=True) if at]
    for key in array.all("InformationKey"):
        values = list(key.all("Value"))
        if "L2_NORM" in key.attributes.get("name", "") and len(values) == 2:
            pairs = zip(values, texts, strict=True)
            bounds += [Dependent(value.inside, value.stop, text) for value, text in pairs]
    return bounds


def to_vtp(points: Floats, faces: NDArray[np.int32], *, single: bool) -> bytes:
    """A new VTP file of points (n, 3) and triangles (m, 3), its arrays raw behind the rest."""
    arrays = (
        points.astype("<f4" if single else "<f8"),
        faces.astype("<i8"),
        3 * np.arange(1, len(faces) + 1, dtype="<i8"),
    )
    blocks = [np.uint64(array.nbytes).tobytes() + array.tobytes() for array in arrays]
    at = np.cumsum([0, *(len(block) for block in blocks)]).tolist()
    real = "Float32" if single else "Float64"
    head = (
        '<?xml version="1.0"?>\n<VTKFile type="PolyData" version="1.0" '
        'byte_order="LittleEndian" header_type="UInt64">\n<PolyData>'
        f'<Piece NumberOfPoints="{len(points)}" NumberOfPolys="{len(faces)}">\n'
        f'<Points><DataArray type="{real}" NumberOfComponents="3" format="appended" '
        f'offset="{at[0]}"/></Points>\n'
        f'<Polys><DataArray type="Int64" Name="connectivity" format="appended" '
        f'offset="{at[1]}"/>\n<DataArray type="Int64" Name="offsets" format="appended" '
        f'offset="{at[2]}"/></Polys>\n'
        '</Piece></PolyData>\n<AppendedData encoding="raw">\n_'
    )
    return b"".join([head.encode(), *blocks, b"\n</AppendedData>\n</VTKFile>\n"])
