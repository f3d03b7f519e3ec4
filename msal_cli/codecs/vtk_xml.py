"""VTK's XML files (``.vtu``, ``.vtp``): points and normals replaced inside the original bytes.

Supported are unstructured grids and polygonal data in pieces, with arrays as text, base64 or raw
bytes, uncompressed or compressed with zlib or LZMA.  A new array is written like the old one.
"""

from __future__ import annotations

import base64
import binascii
import lzma
import re
import zlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli import errors
from msal_cli.arrays import Bytes, Flags, Floats, Longs
from msal_cli.codecs import text_slots
from msal_cli.codecs.mesh_file import Layout, MeshFile
from msal_cli.codecs.slots import Change, Slots, to_type
from msal_cli.codecs.text_slots import Span
from msal_cli.codecs.vtk import Cells
from msal_cli.codecs.xml_tree import Element, parse_tree
from msal_cli.light_dataclass import dataclass
from msal_cli.storage.gzip_streams import ALWAYS_EXPANDED, MAX_RATIO
from msal_cli.storage.regular import Buffer, memory_bytes

_CODES = {
    f"{sign}Int{bits}": f"{code}{bits // 8}"
    for sign, code in (("", "i"), ("U", "u"))
    for bits in (8, 16, 32, 64)
} | {"Float32": "f4", "Float64": "f8"}
_MAX_LZMA_BYTES = 256 << 20
_TOO_SHORT = "an array ends before all its bytes are there"


class Coding:
    """How a file stores arrays: the byte ``order``, the type of ``header`` numbers, and the name of
    the ``compressor``."""

    def __init__(self, data: Buffer, root: Element, appended: re.Match[bytes] | None) -> None:
        self.data = data
        self.compressor = root.attributes.get("compressor", "")
        if self.compressor not in _COMPRESSORS:
            raise errors.UnsupportedError(
                f"arrays compressed by {self.compressor[:40]} are not read",
                hint="write the file with zlib compression, or with none",
            )
        byte_order = root.attributes.get("byte_order", "LittleEndian")
        order = {"LittleEndian": "<", "BigEndian": ">"}.get(byte_order)
        header = {"UInt32": "u4", "UInt64": "u8"}.get(root.attributes.get("header_type", "UInt32"))
        if order is None or header is None:
            raise errors.damaged("byte_order or header_type is wrong", "line 1")
        self.order, self.header = order, order + header
        self.appended_at = appended.end() if appended else -1
        self._is_raw = appended is not None and appended[1] == b"raw"
        self._expanded_bytes = 0

    @property
    def head_bytes(self) -> int:
        """Bytes before an array: its size or, if it is compressed, three numbers for its blocks."""
        return np.dtype(self.header).itemsize * (3 if self.compressor else 1)

    def expand(self, size: int, packed: int, at: int) -> None:
        """Count an array of ``size`` bytes that is stored in ``packed``; TooLargeError if it, or
        all arrays together, expand to too much."""
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
        """The first byte of an array, the end of the bytes that it may have, whether it is raw."""
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
            first, span = np.arange(0, 3 * count, 3), (array.inside, array.text_stop)
            return words.float_rows(first, TextNumbers, unit_length=are_normals, span=span)
        return EncodedNumbers(self, array, code, count)

    def decode(self, array: Element) -> tuple[Buffer, Span]:
        """The bytes of an array, and the place of it and its header in the file."""
        start, stop, is_raw = self.place(array)
        view = memoryview(self.data).cast("B")[:stop]
        source = _Source(view, start, is_raw=is_raw)
        width = np.dtype(self.header).itemsize
        head = source.take(self.head_bytes)
        counts = np.frombuffer(head, dtype=self.header).tolist()
        if not self.compressor:
            content = source.take(counts[0])
            self.expand(len(content), len(content), start)
            return content, (source.first, source.at)
        n_blocks, block_bytes, last_bytes = counts
        if n_blocks * width > stop - start:
            raise errors.cut_short("blocks are missing", f"byte {start}")
        sizes = np.frombuffer(source.take(n_blocks * width), dtype=self.header).tolist()
        # Compressed data are base64 of their own, after that of the header.
        source.left = b""
        packed = sum(sizes)
        total = (n_blocks - 1) * block_bytes + (last_bytes or block_bytes) if n_blocks else 0
        self.expand(total, packed, start)
        content = b"".join(
            _expand_block(
                source.take(size),
                last_bytes if last_bytes and k == n_blocks - 1 else block_bytes,
                self.compressor,
                start,
            )
            for k, size in enumerate(sizes)
        )
        return content, (source.first, source.at)


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
    """An array of words in the bytes ``span``."""

    span: Span

    def encode(self, values: Floats, is_changed: Flags) -> bytes:
        """The bytes of the array with new values (n, 3)."""
        return bytes(text_slots.replace_statements(*self._plan(values, is_changed)))

    def require(self, new: XmlSlots, values: Floats, is_changed: Flags) -> None:
        """Raise InternalError unless ``new``, from another file, is the result of ``encode``."""
        assert isinstance(new, TextNumbers)
        data, patches = self._plan(values, is_changed)
        text_slots.require_replaced(data, new.data[slice(*new.span)], patches)

    def _plan(self, values: Floats, is_changed: Flags) -> tuple[Bytes, list[text_slots.Patch]]:
        patches = text_slots.plan_patches([Change(self, values, is_changed)])
        own = [patch._replace(at=patch.at - self.span[0]) for patch in patches]
        return self.data[slice(*self.span)], own


class EncodedNumbers(Slots):
    """An array in the bytes ``span`` that is replaced as a whole, because it may be compressed or
    in base64."""

    def __init__(self, coding: Coding, array: Element, code: str, count: int) -> None:
        content, self.span = coding.decode(array)
        _require_count(len(content), 3 * np.dtype(code).itemsize * count, array)
        self.codes = (code,) * 3
        self._rows = np.frombuffer(content, dtype=code).reshape(-1, 3)
        self.values = self._rows.astype(np.float64)
        self._coding, self._is_raw = coding, coding.place(array)[2]

    def encode(self, values: Floats, is_changed: Flags) -> bytes:
        """The bytes of the array with new values (n, 3), compressed and encoded like the old
        ones."""
        content = self._new_content(values)
        coding = self._coding
        view = memoryview(coding.data).cast("B")[: self.span[1]]
        source = _Source(view, self.span[0], is_raw=self._is_raw)
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

    def require(self, new: XmlSlots, values: Floats, is_changed: Flags) -> None:
        """Raise InternalError unless ``new``, from another file, is the result of ``encode``."""
        assert isinstance(new, EncodedNumbers)
        if new._rows.tobytes() != self._new_content(values):
            raise errors.InternalError(
                "an array of the file that was made is not what it should be"
            )

    def _new_content(self, values: Floats) -> bytes:
        # Rows that did not move keep their bits, including the signs of zeros.
        is_same = (values == self.values).all(axis=1)[:, None]
        new = np.where(is_same, self._rows, to_type(values, self.codes[0]))
        return new.astype(self._rows.dtype).tobytes()


XmlSlots = TextNumbers | EncodedNumbers


def _expand_block(block: bytes, size: int, compressor: str, at: int) -> bytes:
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
    """Takes bytes one after another, raw or from base64, whose header may be encoded separately.

    ``first`` is the first byte, ``at`` the byte after those taken, ``left`` the decoded bytes that
    are not taken yet; ``is_split`` is whether base64 ended within the bytes taken.
    """

    def __init__(self, view: memoryview, at: int, *, is_raw: bool) -> None:
        while not is_raw and at < len(view) and view[at] in b" \t\r\n":
            at += 1
        self.first = self.at = at
        self.is_split = False
        self._view = view
        self._is_raw = is_raw
        self.left = b""

    def take(self, size: int) -> bytes:
        missing = size - len(self.left)
        n_bytes = missing if self._is_raw else 4 * -(-missing // 3)
        if size < 0 or self.at + max(n_bytes, 0) > len(self._view):
            raise errors.cut_short(_TOO_SHORT, f"byte {len(self._view)}")
        if missing > 0:
            piece = bytes(self._view[self.at : self.at + n_bytes])
            try:
                self.left += piece if self._is_raw else base64.b64decode(piece, validate=True)
            except binascii.Error:
                raise errors.damaged("an array is not base64", f"byte {self.at}") from None
            self.at += n_bytes
            self.is_split |= not self._is_raw and piece.endswith(b"=")
        if len(self.left) < size:
            raise errors.cut_short(_TOO_SHORT, f"byte {self.at}")
        result, self.left = self.left[:size], self.left[size:]
        return result


Edit = tuple[Span, bytes]  # a place, and its new content

Bound = Callable[[Floats], Any]


@dataclass(eq=False, kw_only=True)
class XmlLayout(Layout):
    """A layout with values outside of its arrays that change with positions."""

    # the place of the offset of each appended array, and the first byte of the array
    offsets: Sequence[tuple[Span, int]]
    base: int  # the byte from which offsets count
    # the place of the least or greatest distance from the origin, the index of the array of
    # positions, and the function that computes it
    bounds: Sequence[tuple[Span, int, Bound]]

    @property
    def arrays(self) -> list[XmlSlots]:
        return [*self.positions, *self.normals]  # type: ignore[list-item]

    def dependents(self) -> list[Span]:
        """The places outside of arrays that change with positions."""
        return [span for span, _ in self.offsets] + [span for span, _, _ in self.bounds]


class VtkXmlFile(MeshFile):
    """An opened VTU or VTP file; see ``mesh_file.MeshFile`` for the attributes."""

    _layout: XmlLayout

    def __init__(self, data: Buffer, format: str) -> None:
        super().__init__(data, format, _parse(format, data))

    def _write(self, changes: Sequence[Change], vertices: Floats) -> bytes:
        edits: list[Edit] = [
            (slots.span, slots.encode(values, is_changed)) for slots, values, is_changed in changes
        ]
        edits += self._dependent_edits(vertices, edits)
        return text_slots.replace_spans(bytes(self._data), edits)

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
        ours, theirs, places = self._layout.arrays, there.arrays, there.dependents()
        shapes = [[(type(slots), slots.values.shape) for slots in own] for own in (ours, theirs)]
        if shapes[0] != shapes[1] or len(places) != len(self._layout.dependents()):
            raise errors.InternalError(f"{what} has other arrays")
        edits, spans = [], []
        for slots, values, is_changed in changes:
            new = theirs[next(i for i, own in enumerate(ours) if own is slots)]
            slots.require(new, values, is_changed)
            edits.append((slots.span, output[slice(*new.span)]))
            spans.append(new.span)
        edits += self._dependent_edits(vertices, edits)
        spans += places
        if [output[slice(*span)] for span in spans] != [text for _, text in edits]:
            raise errors.InternalError(f"an attribute of {what} is not what it should be")
        before, after = (
            text_slots.replace_spans(data, [(span, b"") for span in own])
            for data, own in ((bytes(self._data), [span for span, _ in edits]), (output, spans))
        )
        if before != after:
            raise errors.InternalError(f"{what} differs in more than positions and normals")

    def _dependent_edits(self, vertices: Floats, edits: Sequence[Edit]) -> list[Edit]:
        """The edits that follow from new positions, and from the new sizes of arrays."""
        layout, view = self._layout, memoryview(self._data)

        def growth(at: int) -> int:
            return sum(len(new) - (stop - start) for (start, stop), new in edits if stop <= at)

        result = []
        for span, at in layout.offsets:
            change = growth(at) - growth(layout.base)
            new = str(at - layout.base + change).encode() if change else bytes(view[slice(*span)])
            result.append((span, new))
        positions = self._to_file(vertices) if layout.bounds else []
        for span, which, bound in layout.bounds:
            with np.errstate(over="ignore"):
                lengths = np.sqrt((positions[which] ** 2).sum(axis=1))
            result.append((span, repr(float(bound(lengths))).encode()))
        return result


_TYPES = {"vtu": "UnstructuredGrid", "vtp": "PolyData"}
_COMPRESSORS = ("", "vtkZLibDataCompressor", "vtkLZMADataCompressor")
_APPENDED = re.compile(rb"<AppendedData(?:\s+encoding\s*=\s*[\"'](\w+)[\"'])?\s*>\s*_")
_POLYGONS = (("Verts", "vertex"), ("Lines", "line"), ("Strips", "strip"), ("Polys", "polygon"))


def _parse(format: str, data: Buffer) -> XmlLayout:
    """Read a VTU or VTP file.

    Raises UnsupportedError for another compression, another type of VTK file, and curved cells,
    TooLargeError for an array that expands to more than any mesh needs.
    """
    appended = _APPENDED.search(data)
    root = parse_tree(data, appended.start() if appended else None)
    kind = root.attributes.get("type", "")
    if root.name != "VTKFile" or not kind:
        raise errors.damaged("the file is no VTKFile", "line 1")
    if kind != _TYPES[format]:
        suffix = {value: name for name, value in _TYPES.items()}.get(kind)
        if suffix is None:
            raise errors.UnsupportedError(f"a VTKFile of the type {kind[:40]!r} is not read")
        raise errors.FormatError(f"a {kind} is a .{suffix} file", hint=f"rename it to .{suffix}")
    coding = Coding(data, root, appended)
    grid = root.find(kind)
    pieces = list(grid.all("Piece")) if grid is not None else []
    parts = [part for part in (_Piece(piece, coding) for piece in pieces) if part.n_points]
    if not parts:
        raise errors.no_faces("the file has no points")
    starts = np.cumsum([0, *(part.n_points for part in parts)])
    corners, sizes = zip(*(part.cells.polygons() for part in parts), strict=True)
    normals = [part.normals for part in parts if part.normals is not None]
    warnings = [warning for part in parts for warning in part.cells.warnings()]
    if 0 < len(normals) < len(parts):
        normals = []
        warnings.append("normals are kept as they are, since not all pieces have them")
    if any(_find_normals(piece.find("CellData")) for piece in pieces):
        warnings.append("normals of cells are kept as they are")
    is_text = any(part.points_array.attributes.get("format") == "ascii" for part in parts)
    codes = {coding.code_of(part.points_array) for part in parts}
    return XmlLayout(
        "ascii" if is_text else "binary",
        "float64" if coding.order + "f8" in codes else "float32",
        tuple(part.points for part in parts),
        np.concatenate([own + start for own, start in zip(corners, starts, strict=False)]),
        np.concatenate(sizes),
        tuple(normals),
        properties=tuple(dict.fromkeys(name for part in parts for name in part.properties)),
        warnings=tuple(dict.fromkeys(warnings)),
        held=", ".join(filter(None, (part.cells.describe() for part in parts))),
        # The offsets of appended arrays change with the sizes of earlier ones.
        offsets=[
            (span, coding.place(array)[0])
            for array in (root.inner() if coding.compressor else ())
            if array.attributes.get("format") == "appended"
            and (span := array.attribute_places(data).get("offset"))
        ],
        base=coding.appended_at,
        bounds=[
            bound
            for k, part in enumerate(parts)
            for bound in _find_bounds(data, part.points_array, k)
        ],
    )


class _Piece:
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
        array = _find_normals(piece.find("PointData"))
        if array is not None and coding.code_of(array)[1] == "f":
            self.normals = coding.numbers(array, self.n_points, are_normals=True)


def _find_normals(group: Element | None) -> Element | None:
    """The array of three components that a group designates as normals, or that has this name, in
    any case."""
    name = group.attributes.get("Normals", "normals").lower() if group is not None else ""
    for array in group.all("DataArray") if group is not None else ():
        own = array.attributes
        if own.get("Name", "").lower() == name and own.get("NumberOfComponents") == "3":
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


def _find_bounds(data: Buffer, array: Element, which: int) -> list[tuple[Span, int, Bound]]:
    """The least and greatest distance from the origin, which VTK writes beside points."""
    places = array.attribute_places(data)
    spans = [places.get("RangeMin"), places.get("RangeMax")]
    for key in array.all("InformationKey"):
        values = [(value.inside, value.stop) for value in key.all("Value")]
        if "L2_NORM" in key.attributes.get("name", "") and len(values) == 2:
            spans += values
    bounds: tuple[Bound, Bound] = (np.min, np.max)
    return [(span, which, bounds[k % 2]) for k, span in enumerate(spans) if span]


def to_vtp(points: Floats, faces: NDArray[np.int32], *, single: bool) -> bytes:
    """A new VTP file of points (n, 3) and triangles (m, 3), with raw arrays at its end."""
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
