"""Medit files (``.mesh``, ``.meshb``): vertices replaced inside the original bytes.

A file is a row of keywords with their numbers.  ``Vertices``, ``Triangles`` and ``Quadrilaterals``
are read; required and ridge edges, corners, normals, tangents, solutions and whatever else there
is are kept without being looked into.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Longs
from msal_cli.codecs.slot_file import Content, PatchedFile
from msal_cli.codecs.slots import BinaryNumbers, TextNumbers
from msal_cli.codecs.surface_cells import SurfaceCells
from msal_cli.codecs.tokens import Words
from msal_cli.errors import EXPORT_AGAIN, FormatError, TruncatedError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_FLAT = {"triangles": ("triangle", 3), "quadrilaterals": ("quad", 4)}
_CURVED = ("trianglesp2", "quadrilateralsq2", "trianglesp3", "trianglesp4")
_OTHERS = {
    "edges": "edge",
    "tetrahedra": "tetra",
    "hexahedra": "hexahedron",
    "prisms": "wedge",
    "pentahedra": "wedge",
    "pyramids": "pyramid",
}
_NUMBERED = {
    5: "edges",
    6: "triangles",
    7: "quadrilaterals",
    8: "tetrahedra",
    9: "prisms",
    10: "hexahedra",
    24: "trianglesp2",
    25: "quadrilateralsq2",
    49: "pyramids",
    60: "normals",
}
_DIMENSION, _VERTICES, _END = 3, 4, 54


def read(data: Buffer, format: str) -> PatchedFile:
    """Open the Medit file ``data`` (its bytes).

    Raises
    ------
    FormatError, TruncatedError
        if the file is not what its format says.
    UnsupportedError
        for a mesh in the plane, and curved elements.
    ContentError
        ``E_NO_FACES``, ``E_INDEX`` or ``E_NONFINITE``.
    """
    head = bytes(memoryview(data)[:4])
    is_binary = head in (b"\1\0\0\0", b"\0\0\0\1")
    return PatchedFile(data, format, _parse_binary if is_binary else _parse_text)


def _content(
    cells: SurfaceCells, positions: TextNumbers | BinaryNumbers, precision: str, has_normals: bool
) -> Content:
    warnings = cells.warnings()
    if has_normals:
        warnings += ("normals are kept as they are",)
    return Content(
        "ascii" if precision == "text" else "binary",
        precision,
        (positions,),
        cells.corners() - 1,
        cells.sizes(),
        properties=("normals",) if has_normals else (),
        warnings=warnings,
        held=cells.held(),
    )


def _refuse_plane(dimension: int) -> None:
    if dimension != 3:
        raise UnsupportedError(
            f"points have {dimension} coordinates, not three", hint="write a 3D mesh"
        )


def _parse_text(data: Buffer) -> Content:
    words = Words(data, comment=b"#")
    keywords = words.keywords()
    first = words.word(keywords[0]).lower() if keywords and keywords[0] == 0 else b""
    if first != b"meshversionformatted":
        raise FormatError(
            "the file does not begin with MeshVersionFormatted", where="line 1", hint=EXPORT_AGAIN
        )
    cells = SurfaceCells()
    positions = None
    dimension = 3
    has_normals = False
    for keyword, stop in zip(keywords, [*keywords[1:], len(words)], strict=False):
        name = words.word(keyword).decode("ascii", "replace").lower()
        if name == "end":
            break
        if name == "dimension":
            dimension = words.count(keyword + 1, "dimensions")
        elif name == "vertices":
            _refuse_plane(dimension)
            rows = _rows(words, keyword, stop, 4, "vertices")
            places = (rows[:, None] + np.arange(3)).reshape(-1)
            positions = TextNumbers(words.data, words.starts[places], words.stops[places])
        elif name in _FLAT:
            kind, size = _FLAT[name]
            rows = _rows(words, keyword, stop, size + 1, name)
            places = (rows[:, None] + np.arange(size)).reshape(-1)
            cells.add(kind, words.integers(places).reshape(-1, size))
        elif name in _OTHERS:
            cells.count(_OTHERS[name], words.count(keyword + 1, name))
        elif name in _CURVED:
            cells.refuse_curved(name, words.count(keyword + 1, name))
        elif name == "normals":
            has_normals = True
    if positions is None:
        raise TruncatedError(
            "there are no Vertices", where=words.where(len(words)), hint=EXPORT_AGAIN
        )
    return _content(cells, positions, "text", has_normals)


def _rows(words: Words, keyword: int, stop: int, width: int, what: str) -> Longs:
    """The first word of each row (n,) behind a keyword and its count."""
    count = words.count(keyword + 1, what)
    if stop - keyword - 2 != count * width:
        kind = TruncatedError if stop == len(words) else FormatError
        raise kind(
            f"{count} {what} take {count * width} numbers, but {stop - keyword - 2} are there",
            where=words.where(keyword),
            hint=EXPORT_AGAIN,
        )
    return keyword + 2 + width * np.arange(count, dtype=np.int64)


def _parse_binary(data: Buffer) -> Content:
    from msal_cli.kernels.text import as_bytes

    source = as_bytes(data)
    order = "<" if source[0] == 1 else ">"
    at = 8
    version = _integer(source, 4, f"{order}i4")
    if not 1 <= version <= 4:
        raise FormatError(f"version {version} of Medit's format is not known", where="byte 4")
    real = f"{order}f4" if version == 1 else f"{order}f8"
    whole = f"{order}i8" if version == 4 else f"{order}i4"
    place = f"{order}i8" if version >= 3 else f"{order}i4"
    cells = SurfaceCells()
    positions = None
    dimension = 3
    has_normals = False
    while True:
        keyword = _integer(source, at, f"{order}i4")
        if keyword == _END:
            break
        next_at = _integer(source, at + 4, place)
        body = at + 4 + np.dtype(place).itemsize
        if keyword == _DIMENSION:
            dimension = _integer(source, body, f"{order}i4")
        elif keyword == _VERTICES:
            _refuse_plane(dimension)
            size = 3 * np.dtype(real).itemsize + np.dtype(whole).itemsize
            first, count = _table(source, body, whole, size)
            rows = first + size * np.arange(count, dtype=np.int64)
            positions = BinaryNumbers(source, rows, real)
        elif (name := _NUMBERED.get(keyword, "")) in _FLAT:
            kind, width = _FLAT[name]
            size = (width + 1) * np.dtype(whole).itemsize
            first, count = _table(source, body, whole, size)
            numbers = source[first : first + size * count].view(whole).reshape(-1, width + 1)
            cells.add(kind, numbers[:, :width].astype(np.int64))
        elif name in _OTHERS:
            cells.count(_OTHERS[name], _integer(source, body, whole))
        elif name in _CURVED:
            cells.refuse_curved(name, _integer(source, body, whole))
        elif name:
            has_normals = True
        if next_at == 0:
            break
        if not body <= next_at <= len(source):
            raise FormatError("the next keyword is not in the file", where=f"byte {at}")
        at = next_at
    if positions is None:
        raise TruncatedError("there are no Vertices", where=f"byte {at}", hint=EXPORT_AGAIN)
    return _content(cells, positions, "float32" if version == 1 else "float64", has_normals)


def _integer(source: NDArray[np.uint8], at: int, code: str) -> int:
    size = np.dtype(code).itemsize
    if at < 0 or at + size > len(source):
        raise TruncatedError(
            "the file ends before its End", where=f"byte {len(source)}", hint=EXPORT_AGAIN
        )
    return int(source[at : at + size].view(code)[0])


def _table(source: NDArray[np.uint8], body: int, whole: str, size: int) -> tuple[int, int]:
    """The first byte and the number of rows behind a count."""
    count = _integer(source, body, whole)
    first = body + np.dtype(whole).itemsize
    if count < 0 or first + count * size > len(source):
        raise TruncatedError(
            f"{count} rows are more than the file holds",
            where=f"byte {body}",
            hint=EXPORT_AGAIN,
        )
    return first, count
