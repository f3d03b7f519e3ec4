"""VTK's XML files (``.vtu``, ``.vtp``): points and normals replaced inside the original bytes.

Read are unstructured grids and polygonal data in pieces, their arrays as text, base64 or raw
bytes, not compressed or compressed with zlib or LZMA.  A new array is written as the old one was.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Longs
from msal_cli.codecs.cells import Cells
from msal_cli.codecs.layout import Dependent, Layout, Shift
from msal_cli.codecs.slots import UnitSlots
from msal_cli.codecs.vtk_arrays import Coding, code_of, integers, numbers
from msal_cli.codecs.xml_offsets import Element, parse_tree
from msal_cli.errors import EXPORT_AGAIN, ContentError, FormatError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_TYPES = {"vtu": "UnstructuredGrid", "vtp": "PolyData"}
_COMPRESSORS = ("", "vtkZLibDataCompressor", "vtkLZMADataCompressor")
_APPENDED = re.compile(rb"<AppendedData(?:\s+encoding\s*=\s*[\"'](\w+)[\"'])?\s*>\s*_")
_POLYGONS = (("Verts", "vertex"), ("Lines", "line"), ("Strips", "strip"), ("Polys", "polygon"))


def parse_vtu(data: Buffer) -> Layout:
    """Read an unstructured grid; errors as of ``_parse``."""
    return _parse(data, "vtu")


def parse_vtp(data: Buffer) -> Layout:
    """Read polygonal data; errors as of ``_parse``."""
    return _parse(data, "vtp")


def _parse(data: Buffer, format: str) -> Layout:
    """Read a VTU or VTP file.

    Raises UnsupportedError for another compression, another type of VTK file, and curved cells,
    TooLargeError for an array that expands to more than any mesh does.
    """
    appended = _APPENDED.search(data)
    root = parse_tree(data, "VTKFile", appended.start() if appended else None)
    kind = root.attributes.get("type", "")
    if root.name != "VTKFile" or not kind:
        raise FormatError("the file is no VTKFile", where="line 1", hint=EXPORT_AGAIN)
    if kind != _TYPES[format]:
        suffix = {one: name for name, one in _TYPES.items()}.get(kind)
        if suffix is None:
            raise UnsupportedError(f"a VTKFile of the type {kind[:40]!r} is not read")
        raise FormatError(f"a {kind} is a .{suffix} file", hint=f"rename it to .{suffix}")
    coding = _coding(data, root, appended)
    grid = root.find(kind)
    pieces = list(grid.all("Piece")) if grid is not None else []
    parts = [part for part in (_Piece(one, coding) for one in pieces) if part.n_points]
    if not parts:
        raise ContentError(
            "the file has no points", code="E_NO_FACES", hint="check the program that writes it"
        )
    starts = np.cumsum([0, *(part.n_points for part in parts)])
    corners = [part.cells.corners() + start for part, start in zip(parts, starts, strict=False)]
    normals = [part.normals for part in parts if part.normals is not None]
    positions = [part.points for part in parts]
    warnings = [warning for part in parts for warning in part.cells.warnings()]
    if 0 < len(normals) < len(parts):
        normals = []
        warnings.append("normals are kept as they are, since not all pieces have them")
    cell_data = (one.find("CellData") for one in pieces)
    if any(one is not None and _named(one, "normals") is not None for one in cell_data):
        warnings.append("normals of cells are kept as they are")
    is_text = any(part.points_array.attributes.get("format") == "ascii" for part in parts)
    codes = {code_of(part.points_array, coding) for part in parts}
    return Layout(
        "ascii" if is_text else "binary",
        "float64" if coding.order + "f8" in codes else "float32",
        tuple(positions),
        np.concatenate(corners),
        np.concatenate([part.cells.sizes() for part in parts]),
        tuple(normals),
        properties=tuple(dict.fromkeys(name for part in parts for name in part.properties)),
        warnings=tuple(dict.fromkeys(warnings)),
        held=", ".join(filter(None, (part.cells.describe() for part in parts))),
        dependents=(
            *_offsets(data, root, coding),
            *(one for k, part in enumerate(parts) for one in _ranges(data, part.points_array, k)),
        ),
    )


def _coding(data: Buffer, root: Element, appended: re.Match[bytes] | None) -> Coding:
    compressor = root.attributes.get("compressor", "")
    if compressor not in _COMPRESSORS:
        raise UnsupportedError(
            f"arrays compressed by {compressor[:40]} are not read",
            hint="write the file with zlib compression, or with none",
        )
    order = {"LittleEndian": "<", "BigEndian": ">"}.get(root.attributes.get("byte_order", ""))
    header = {"UInt32": "u4", "UInt64": "u8"}.get(root.attributes.get("header_type", "UInt32"))
    if order is None or header is None:
        raise FormatError("byte_order or header_type is wrong", where="line 1", hint=EXPORT_AGAIN)
    coding = Coding(data, order, order + header, compressor)
    if appended:
        coding.appended_at = appended.end()
        coding.appended_stop = len(data)
        coding.is_raw = appended[1] == b"raw"
    return coding


class _Piece:
    """A piece of a grid."""

    def __init__(self, piece: Element, coding: Coding) -> None:
        self.n_points = _count(piece, "NumberOfPoints")
        self.cells = Cells()
        self.normals: UnitSlots | None = None
        self.properties: list[str] = []
        if not self.n_points:
            return
        points = piece.find("Points", "DataArray")
        if points is None or points.attributes.get("NumberOfComponents") != "3":
            raise FormatError(
                "a piece has no points of three coordinates",
                where=f"byte {piece.start}",
                hint=EXPORT_AGAIN,
            )
        self.points_array = points
        self.points = numbers(points, coding, self.n_points)
        cells = piece.find("Cells")
        if cells is not None:
            types = integers(_array(cells, "types"), coding)
            self.cells.add_types(types, *_lists(cells, coding))
        for name, kind in _POLYGONS:
            one = piece.find(name)
            if one is not None and _count(piece, f"NumberOf{name}"):
                self.cells.add(kind, *_lists(one, coding))
        self._read_attributes(piece, coding)

    def _read_attributes(self, piece: Element, coding: Coding) -> None:
        for name, owner in (("PointData", "point"), ("CellData", "cell")):
            group = piece.find(name)
            arrays = group.children if group is not None else []
            self.properties += [f"{owner}.{one.attributes.get('Name', '')}" for one in arrays]
        group = piece.find("PointData")
        array = None if group is None else _named(group, group.attributes.get("Normals", "normals"))
        if array is not None and code_of(array, coding)[1] == "f":
            self.normals = numbers(array, coding, self.n_points, are_normals=True)


def _named(group: Element, name: str) -> Element | None:
    """The array of three components of this name, in any case."""
    return next(
        (
            one
            for one in group.all("DataArray")
            if one.attributes.get("Name", "").lower() == name.lower()
            and one.attributes.get("NumberOfComponents") == "3"
        ),
        None,
    )


def _count(piece: Element, name: str) -> int:
    word = piece.attributes.get(name, "0").strip()
    if not re.fullmatch(r"[0-9]{1,18}", word):
        raise FormatError(f"{name} is no number", where=f"byte {piece.start}", hint=EXPORT_AGAIN)
    return int(word)


def _array(group: Element, name: str) -> Element:
    for one in group.all("DataArray"):
        if one.attributes.get("Name") == name:
            return one
    raise FormatError(f"there is no array {name}", where=f"byte {group.start}", hint=EXPORT_AGAIN)


def _lists(group: Element, coding: Coding) -> tuple[Longs, Longs]:
    """Sizes (k,) and corners of the cells of a group."""
    sizes = np.diff(integers(_array(group, "offsets"), coding), prepend=0)
    corners = integers(_array(group, "connectivity"), coding)
    if (sizes < 0).any() or sizes.sum() > len(corners):
        raise FormatError(
            "the offsets of cells are wrong", where=f"byte {group.start}", hint=EXPORT_AGAIN
        )
    return sizes, corners[: sizes.sum()]


def _offsets(data: Buffer, root: Element, coding: Coding) -> list[Dependent]:
    """The offsets of appended arrays, which move with the size of those in front of them."""
    found = []
    if coding.appended_at < 0 or not coding.compressor:
        return []
    for array in root.inner():
        place = array.attribute_place(data, "offset")
        if array.attributes.get("format") == "appended" and place is not None:
            at = coding.place(array)[0]
            found.append(Dependent(*place, _shifted(at, coding.appended_at)))
    return found


def _shifted(at: int, base: int) -> Callable[[bytes, Sequence[Floats], Shift], bytes]:
    def text(old: bytes, positions: Sequence[Floats], shift: Shift) -> bytes:
        change = shift(at) - shift(base)
        return str(at - base + change).encode() if change else old

    return text


def _ranges(data: Buffer, array: Element, which: int) -> list[Dependent]:
    """The smallest and largest distance from the origin, which VTK writes beside points."""

    def smallest(old: bytes, positions: Sequence[Floats], shift: Shift) -> bytes:
        return repr(float(_lengths(positions[which]).min())).encode()

    def largest(old: bytes, positions: Sequence[Floats], shift: Shift) -> bytes:
        return repr(float(_lengths(positions[which]).max())).encode()

    found = []
    for name, text in (("RangeMin", smallest), ("RangeMax", largest)):
        place = array.attribute_place(data, name)
        if place is not None:
            found.append(Dependent(*place, text))
    for key in array.all("InformationKey"):
        values = list(key.all("Value"))
        if "L2_NORM" in key.attributes.get("name", "") and len(values) == 2:
            found.append(Dependent(values[0].inside, values[0].stop, smallest))
            found.append(Dependent(values[1].inside, values[1].stop, largest))
    return found


def _lengths(points: Floats) -> Floats:
    with np.errstate(over="ignore"):
        lengths: Floats = np.sqrt((points * points).sum(axis=1))
    return lengths


def written(points: Floats, faces: NDArray[np.int32], *, single: bool) -> bytes:
    """A new VTP file of points (n, 3) and triangles (m, 3), its arrays raw behind the rest."""
    arrays = (
        points.astype("<f4" if single else "<f8"),
        faces.astype("<i8"),
        3 * np.arange(1, len(faces) + 1, dtype="<i8"),
    )
    blocks = [np.uint64(one.nbytes).tobytes() + one.tobytes() for one in arrays]
    at = np.cumsum([0, *(len(one) for one in blocks)]).tolist()
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
