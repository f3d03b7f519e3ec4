"""XDMF files (``.xdmf``) that hold their numbers themselves: points replaced inside the bytes.

Most programs write the numbers into an HDF5 or binary file beside the XDMF.  Such files are
refused: no other file is ever opened, and none could be written.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.ply_writer import corners_of
from msal_cli.codecs.slots import Tokens
from msal_cli.codecs.surface_cells import CORNERS, SurfaceCells
from msal_cli.codecs.text_lines import float_lines, integer_lines
from msal_cli.codecs.tokens import Words
from msal_cli.codecs.xml_offsets import Element, parse_tree
from msal_cli.errors import EXPORT_AGAIN, FormatError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_SIZES = {"triangle": 3, "quadrilateral": 4, "polyvertex": 1, "polyline": 2}
_SIZES |= {"tetrahedron": 4, "pyramid": 5, "wedge": 6, "hexahedron": 8}
_MIXED = {4: "triangle", 5: "quad", 6: "tetrahedron", 7: "pyramid", 8: "wedge", 9: "hexahedron"}
"""Kinds of cells of one size in a topology of several kinds."""

_WITH_COUNT = {1: "vertex", 2: "line", 3: "polygonal"}
"""Kinds that are followed by the number of their corners."""

_HINT = "write the numbers into the XDMF file itself (Format='XML'), or convert it to VTU or PLY"


def parse(data: Buffer) -> Layout:
    """Read an XDMF file; UnsupportedError for numbers in another file, several grids, points in
    the plane, and curved cells."""
    root = parse_tree(data, "Xdmf")
    if root.name != "Xdmf":
        raise FormatError("the file is no Xdmf", where="line 1", hint=EXPORT_AGAIN)
    everything = list(root.inner())
    _refuse_references(data, everything)
    grids = [one for one in everything if one.find("Geometry") is not None]
    if len(grids) != 1:
        raise UnsupportedError(
            f"the file has {len(grids)} grids with points, not one", hint="export one grid"
        )
    geometry, topology = grids[0].find("Geometry"), grids[0].find("Topology")
    item = geometry.find("DataItem") if geometry is not None else None
    if geometry is None or topology is None or item is None:
        raise FormatError("a grid has no points or no topology", hint=EXPORT_AGAIN)
    kind = _type(geometry, "GeometryType", "XYZ")
    if kind != "xyz":
        raise UnsupportedError(f"points of the type {kind.upper()}", hint="write them as XYZ")
    words = Words(data, item.inside, item.text_stop)
    if len(words) % 3:
        raise FormatError("points have not three numbers each", hint=EXPORT_AGAIN)
    cells = SurfaceCells()
    _read_cells(data, topology, cells)
    is_single = item.attributes.get("Precision", "4") == "4"
    return cells.content(
        Tokens(words.data, words.starts, words.stops),
        "float32" if is_single else "float64",
        encoding="ascii",
        properties=tuple(
            f"{one.attributes.get('Center', 'Node').lower()}.{one.attributes.get('Name', '')}"
            for one in grids[0].all("Attribute")
        ),
    )


def _refuse_references(data: Buffer, everything: list[Element]) -> None:
    """Raise UnsupportedError for numbers that are not in the file itself."""
    for one in everything:
        if one.name == "include":
            raise UnsupportedError(
                "the file includes another, which msal does not open", hint=_HINT
            )
        if one.name != "DataItem":
            continue
        format = one.attributes.get("Format", "XML")
        if format.upper() != "XML":
            raise UnsupportedError(
                f"its numbers are in another file ({format}), which msal does not open", hint=_HINT
            )
        if one.attributes.get("ItemType", "Uniform") != "Uniform" or "Reference" in one.attributes:
            raise UnsupportedError("its numbers are put together from other items", hint=_HINT)


def _type(element: Element, name: str, default: str) -> str:
    """The type of a geometry or topology, in small letters; old files call it ``Type``."""
    return element.attributes.get(name, element.attributes.get("Type", default)).lower()


def _read_cells(data: Buffer, topology: Element, cells: SurfaceCells) -> None:
    kind = _type(topology, "TopologyType", "")
    item = topology.find("DataItem")
    numbers = np.zeros(0, dtype=np.int64)
    if item is not None:
        numbers = Words(data, item.inside, item.text_stop).integers(slice(None))
    if kind in ("triangle", "quadrilateral"):
        if len(numbers) % _SIZES[kind]:
            raise FormatError(f"the numbers of {kind}s are cut", hint=EXPORT_AGAIN)
        cells.add(kind.removesuffix("rilateral"), numbers.reshape(-1, _SIZES[kind]))
    elif kind == "polygon":
        text = topology.attributes.get("NodesPerElement", "")
        size = int(text) if text.isascii() and text.isdigit() and len(text) < 9 else 0
        if size < 3 or len(numbers) % size:
            raise FormatError("NodesPerElement of the polygons is wrong", hint=EXPORT_AGAIN)
        cells.add("polygonal", numbers.reshape(-1, size))
    elif kind == "mixed":
        _read_mixed(numbers, cells)
    elif kind in _SIZES:
        cells.count(kind, len(numbers) // _SIZES[kind])
    elif kind.startswith(("tri", "quad")):
        cells.refuse_curved(kind, len(numbers))
    else:
        cells.count(kind or "cell", 1)


def _read_mixed(numbers: Longs, cells: SurfaceCells) -> None:
    """Add the cells of a topology of several kinds: of each its kind, then its corners."""
    values = numbers.tolist()
    corners: list[int] = []
    sizes: list[int] = []
    at = 0
    while at < len(values):
        kind = values[at]
        at += 1
        if kind in _WITH_COUNT and at < len(values):
            name, size = _WITH_COUNT[kind], values[at]
            at += 1
        elif kind in _MIXED:
            name = _MIXED[kind]
            size = CORNERS.get(name) or _SIZES[name]
        else:
            raise UnsupportedError(
                f"cells of XDMF's type {kind} are not read", hint="write first-order cells"
            )
        if size < 0 or at + size > len(values):
            raise FormatError("the numbers of the cells are cut", hint=EXPORT_AGAIN)
        if kind in (3, 4, 5) and size >= 3:
            corners += values[at : at + size]
            sizes.append(size)
        if kind not in (4, 5):
            cells.count(name, 1)
        at += size
    cells.add_polygons("polygon", np.array(corners, np.int64), np.array(sizes, np.int64))


_TEMPLATE = """<?xml version="1.0" encoding="utf-8"?>
<Xdmf Version="3.0"><Domain><Grid Name="mesh" GridType="Uniform">
<Topology TopologyType="Triangle" NumberOfElements="{n_faces}"><DataItem DataType="Int" \
Dimensions="{n_faces} 3" Format="XML" Precision="4">
{faces}</DataItem></Topology>
<Geometry GeometryType="XYZ"><DataItem DataType="Float" Dimensions="{n_vertices} 3" Format="XML" \
Precision="{precision}">
{positions}</DataItem></Geometry>
</Grid></Domain></Xdmf>
"""


def written(points: Floats, faces: Ints, *, single: bool) -> bytes:
    """A new file of points (n, 3) and triangles (m, 3), its numbers inside."""
    return _TEMPLATE.format(
        n_faces=len(faces),
        faces=integer_lines(*corners_of(faces)).decode(),
        n_vertices=len(points),
        precision=4 if single else 8,
        positions=float_lines(points, single=single).decode(),
    ).encode()
