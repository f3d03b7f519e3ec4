"""Medit files (``.mesh``, ``.meshb``): vertices replaced inside the original bytes.

A file is a row of keywords with their numbers.  ``Vertices``, ``Triangles`` and ``Quadrilaterals``
are read; required and ridge edges, corners, normals, tangents, solutions and whatever else there
is are kept without being looked into.
"""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Bytes, Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.slots import BinaryNumbers, UnitSlots
from msal_cli.codecs.surface_cells import CORNERS, CURVED, SurfaceCells
from msal_cli.codecs.tokens import Words
from msal_cli.errors import EXPORT_AGAIN, FormatError, TruncatedError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_KINDS = {
    "triangles": "triangle",
    "quadrilaterals": "quad",
    "edges": "edge",
    "tetrahedra": "tetra",
    "hexahedra": "hexahedron",
    "prisms": "wedge",
    "pentahedra": "wedge",
    "pyramids": "pyramid",
    "trianglesp2": CURVED,
    "quadrilateralsq2": CURVED,
    "trianglesp3": CURVED,
    "trianglesp4": CURVED,
}
_KEYWORDS = {
    3: "dimension",
    4: "vertices",
    5: "edges",
    6: "triangles",
    7: "quadrilaterals",
    8: "tetrahedra",
    9: "prisms",
    10: "hexahedra",
    24: "trianglesp2",
    25: "quadrilateralsq2",
    49: "pyramids",
    54: "end",
    60: "normals",
}
"""The keywords of binary files."""


def parse(data: Buffer) -> Layout:
    """Read a Medit file; UnsupportedError for a mesh in the plane, and curved elements."""
    head = bytes(memoryview(data)[:4])
    reader: _Text | _Binary
    reader = _Binary(data) if head in (b"\1\0\0\0", b"\0\0\0\1") else _Text(data)
    cells = SurfaceCells()
    positions: UnitSlots | None = None
    dimension = 3
    has_normals = False
    while (name := reader.next_keyword()) not in ("", "end"):
        if name == "dimension":
            dimension = reader.dimension()
        elif name == "vertices":
            if dimension != 3:
                raise UnsupportedError(
                    f"points have {dimension} coordinates, not three", hint="write a 3D mesh"
                )
            positions = reader.positions()
        elif name in _KINDS:
            kind = _KINDS[name]
            if size := cells.sort(kind, 0 if kind in CORNERS else reader.count(), name):
                cells.add(kind, reader.corners(size))
        elif name == "normals":
            has_normals = True
    if positions is None:
        raise TruncatedError("there are no Vertices", where=reader.where(), hint=EXPORT_AGAIN)
    return cells.content(
        positions,
        reader.precision,
        corners=cells.corners() - 1,
        properties=("normals",) if has_normals else (),
        warnings=("normals are kept as they are",) if has_normals else (),
    )


class _Text:
    """The keywords of a text, one after the other."""

    precision = "text"

    def __init__(self, data: Buffer) -> None:
        self._words = Words(data, comment=b"#")
        self._keywords = [*self._words.keywords(), len(self._words)]
        self._k = -1
        if self._keywords[0] != 0 or self.next_keyword() != "meshversionformatted":
            raise FormatError(
                "the file does not begin with MeshVersionFormatted",
                where="line 1",
                hint=EXPORT_AGAIN,
            )

    def next_keyword(self) -> str:
        """Go to the next keyword; empty at the end."""
        self._k += 1
        self._at = self._keywords[min(self._k, len(self._keywords) - 1)]
        if self._at == len(self._words):
            return ""
        self._name = self._words.word(self._at).decode("ascii", "replace").lower()
        return self._name

    def where(self) -> str:
        return self._words.where(self._at)

    def count(self) -> int:
        """The number behind the keyword."""
        return self._words.count(self._at + 1, self._name)

    dimension = count

    def positions(self) -> UnitSlots:
        return self._words.float_rows(self._rows(4))

    def corners(self, size: int) -> Longs:
        """The corners (p, size) of cells."""
        return self._words.integer_rows(self._rows(size + 1), size)

    def _rows(self, width: int) -> Longs:
        """The first word of each row (n,) behind the keyword and its count."""
        count, stop = self.count(), self._keywords[self._k + 1]
        n_words = stop - self._at - 2
        if n_words != count * width:
            kind = TruncatedError if stop == len(self._words) else FormatError
            raise kind(
                f"{count} {self._name} take {count * width} numbers, but {n_words} are there",
                where=self.where(),
                hint=EXPORT_AGAIN,
            )
        return self._at + 2 + width * np.arange(count, dtype=np.int64)


class _Binary:
    """The keywords of a binary file, each with the place of the next."""

    def __init__(self, data: Buffer) -> None:
        from msal_cli.kernels.text import as_bytes

        self._data: Bytes = as_bytes(data)
        order = "<" if self._data[0] == 1 else ">"
        self._short = f"{order}i4"
        version = self._integer(4, self._short)
        if not 1 <= version <= 4:
            raise FormatError(f"version {version} of Medit's format is not known", where="byte 4")
        self.precision = "float32" if version == 1 else "float64"
        self._real = f"{order}f4" if version == 1 else f"{order}f8"
        self._whole = f"{order}i8" if version == 4 else self._short
        self._place = f"{order}i8" if version >= 3 else self._short
        self._at, self._body, self._next_at = 0, 8, 8

    def next_keyword(self) -> str:
        """Go to the next keyword; empty at the end, ``other`` for one that is not known."""
        if self._next_at == 0:
            return ""
        if not self._body <= self._next_at <= len(self._data):
            raise FormatError("the next keyword is not in the file", where=self.where())
        self._at = self._next_at
        name = _KEYWORDS.get(self._integer(self._at, self._short), "other")
        if name != "end":
            self._next_at = self._integer(self._at + 4, self._place)
            self._body = self._at + 4 + np.dtype(self._place).itemsize
        return name

    def where(self) -> str:
        return f"byte {self._at}"

    def dimension(self) -> int:
        return self._integer(self._body, self._short)

    def count(self) -> int:
        """The number behind the keyword."""
        return self._integer(self._body, self._whole)

    def positions(self) -> UnitSlots:
        size = 3 * np.dtype(self._real).itemsize + np.dtype(self._whole).itemsize
        first, count = self._table(size)
        rows = first + size * np.arange(count, dtype=np.int64)
        return BinaryNumbers(self._data, rows, self._real)

    def corners(self, size: int) -> Longs:
        """The corners (p, size) of cells."""
        first, count = self._table((size + 1) * np.dtype(self._whole).itemsize)
        stop = first + (size + 1) * np.dtype(self._whole).itemsize * count
        rows = self._data[first:stop].view(self._whole).reshape(-1, size + 1)
        return rows[:, :size].astype(np.int64)

    def _table(self, row_bytes: int) -> tuple[int, int]:
        """The first byte and the number of the rows behind the count."""
        count, first = self.count(), self._body + np.dtype(self._whole).itemsize
        if count < 0 or first + count * row_bytes > len(self._data):
            raise TruncatedError(
                f"{count} rows are more than the file has bytes for",
                where=f"byte {self._body}",
                hint=EXPORT_AGAIN,
            )
        return first, count

    def _integer(self, at: int, code: str) -> int:
        size = np.dtype(code).itemsize
        if at < 0 or at + size > len(self._data):
            raise TruncatedError(
                "the file ends before its End",
                where=f"byte {len(self._data)}",
                hint=EXPORT_AGAIN,
            )
        return int(self._data[at : at + size].view(code)[0])
