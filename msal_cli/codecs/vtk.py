"""VTK's legacy files (``.vtk``): points and normals replaced inside the original bytes.

Supported are ascii and binary files of versions 1 to 5.1 with polygonal data or unstructured grids.
After the cells (attributes, fields, metadata) only normals are read; what is not understood there
is kept.  All binary data are big-endian, as VTK writes them.
"""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from msal_cli import errors
from msal_cli.arrays import Longs
from msal_cli.codecs.mesh_file import Layout
from msal_cli.codecs.slots import Slots, Strided, number_within
from msal_cli.codecs.text_slots import TextSlots, Words, line_of
from msal_cli.storage.regular import Buffer

_CODES = {"signed_char": ">i1", "vtkidtype": ">i4", "float": ">f4", "double": ">f8"}
for _name, _size in (("char", 1), ("short", 2), ("int", 4), ("long", 8)):
    _CODES |= {_name: f">i{_size}", f"unsigned_{_name}": f">u{_size}"}
    _CODES |= {f"vtktypeint{8 * _size}": f">i{_size}", f"vtktypeuint{8 * _size}": f">u{_size}"}
_LINE = re.compile(rb"\s*([^\r\n]*)(?:\r\n|\n|\r|\Z)")
_PARAGRAPH_END = re.compile(rb"\n[ \t]*\r?\n|\Z")
_HEADER = re.compile(
    rb"# vtk DataFile Version[ \t]+(\d+)\.(\d+)[^\r\n]*\r?\n([^\r\n]*)\r?\n"
    rb"\s*(ASCII|BINARY)[ \t]*\r?\n",
    re.IGNORECASE,
)
_POINTS = ("POLYDATA", "UNSTRUCTURED_GRID")
_CELLS = {"VERTICES": "vertex", "LINES": "line", "POLYGONS": "polygon", "TRIANGLE_STRIPS": "strip"}
_PER_TUPLE = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}
_PER_TUPLE |= dict.fromkeys(("GLOBAL_IDS", "PEDIGREE_IDS", "EDGE_FLAGS"), 1)
"""Numbers per tuple of attributes whose line is a name and a type."""

_PRECISIONS = {">f4": "float32", ">f8": "float64"}
_ZERO = np.zeros(1, dtype=np.int64)


def parse(data: Buffer) -> Layout:
    """Read a VTK file; UnsupportedError for data without explicit points, and curved cells."""
    header = _HEADER.match(data)
    if not header:
        message = "the file does not begin with '# vtk DataFile', a title and ASCII or BINARY"
        raise errors.other_format(message, "line 1", "vtk")
    is_text = header[4].upper() == b"ASCII"
    reader = _Reader(data, header.end(), is_text=is_text)
    words = reader.line()
    kind = words[1].upper() if len(words) > 1 and words[0].upper() == "DATASET" else ""
    if not kind:
        raise reader.damaged("no DATASET is named")
    if kind not in _POINTS:
        raise errors.UnsupportedError(
            f"the data set {kind} has no surface of points",
            where=reader.where(),
            hint="extract the surface in the program that wrote it",
        )
    while words := reader.line():
        keyword = words[0].upper()
        if keyword in ("POINT_DATA", "CELL_DATA"):
            reader.read_attributes(words)
            break
        reader.read_section(words)
    if reader.points is None:
        raise reader.damaged("the file has no POINTS")
    if reader.cells is not None:
        raise reader.damaged("the file has no CELL_TYPES")
    normals = reader.normals
    has_normals = normals is not None and len(normals.values) == len(reader.points.values)
    return Layout(
        "ascii" if is_text else "binary_big_endian",
        reader.precision,
        (reader.points,),
        *reader.surface.polygons(),
        (normals,) if normals is not None and has_normals else (),
        properties=tuple(reader.properties),
        warnings=(*reader.surface.warnings(), *reader.warnings),
        held=reader.surface.describe(),
    )


class _Reader:
    """A position in a VTK file, and what was read before it."""

    def __init__(self, data: Buffer, at: int, *, is_text: bool) -> None:
        from msal_cli.kernels.text import as_bytes

        self.precision = ""  # of the points
        self.points: Slots | None = None
        self.surface = Cells()
        # Sizes and corners of cells whose types are not read yet.
        self.cells: tuple[Longs, Longs] | None = None
        self.normals: Slots | None = None
        self.properties: list[str] = []
        self.warnings: list[str] = []
        self._bytes = data
        self._data = as_bytes(data)
        self._at = self._line_at = self._before_line = at
        self._words = Words(data, at) if is_text else None

    def where(self) -> str:
        """The line, or the byte in a binary file, where the last line of words began."""
        if self._words is None:
            return f"byte {self._line_at}"
        return f"line {line_of(self._data, self._line_at)}"

    def damaged(self, message: str) -> errors.FormatError:
        return errors.damaged(message, self.where())

    def line(self) -> list[str]:
        """The words of the next line that has any; empty at the end."""
        found = _LINE.match(self._bytes, self._at)
        assert found is not None  # it matches the empty rest, too
        self._before_line, self._line_at = self._at, found.start(1)
        self._at = found.end()
        return found[1][:1000].decode("ascii", "replace").split()

    def _skip_paragraph(self) -> None:
        found = _PARAGRAPH_END.search(self._bytes, max(self._at - 1, 0))
        assert found is not None
        self._at = found.end()

    def word_of(self, words: list[str], k: int) -> str:
        if k >= len(words):
            raise self.damaged("the line is too short")
        return words[k]

    def count_of(self, words: list[str], k: int, what: str) -> int:
        """A word of a line as a count; ``what`` names the things that it counts."""
        word = self.word_of(words, k)
        if not (word.isascii() and word.isdigit()) or len(word) > 18:
            raise self.damaged(f"{word[:40]!r} is not a number of {what}")
        return int(word)

    def _read_normals(self, count: int, kind: str) -> Slots | None:
        """The normals (n, 3) that follow; None if they are whole numbers."""
        code = self._code(kind)
        if code not in _PRECISIONS:
            self._skip(3 * count, kind)
            return None
        return self._floats(count, code, is_normals=True)

    def _floats(self, count: int, code: str, *, is_normals: bool) -> Slots:
        if self._words is not None:
            chosen = self._next_words(3 * count)
            first = np.arange(chosen.start, chosen.stop, 3)
            return self._words.float_rows(first, TextSlots, unit_length=is_normals)
        size = np.dtype(code).itemsize
        at = self._next_bytes(3 * size * count)
        places = (0, size, 2 * size)
        return Strided(self._data, at, count, 3 * size, places, (code,) * 3)

    def _integers(self, count: int, kind: str) -> Longs:
        code = self._code(kind)
        if self._words is not None:
            return self._words.integers(self._next_words(count))
        size = np.dtype(code).itemsize
        at = self._next_bytes(size * count)
        return self._data[at : at + size * count].view(code).astype(np.int64)

    def _read_cells(self, words: list[str]) -> tuple[Longs, Longs]:
        """Sizes (k,) and corners of the cells in the section that begins with this line."""
        first, second = (self.count_of(words, k, "cells") for k in (1, 2))
        at = self._at
        header = self.line()
        if header and header[0].upper() == "OFFSETS":
            offsets = self._integers(first, self.word_of(header, 1)) if first else _ZERO
            header = self.line()
            if not header or header[0].upper() != "CONNECTIVITY":
                raise self.damaged("no CONNECTIVITY")
            corners = self._integers(second, self.word_of(header, 1))
            sizes = np.diff(offsets)
            if offsets[0] != 0 or offsets[-1] != second or (sizes < 0).any():
                raise self.damaged("the OFFSETS of cells are wrong")
            return sizes, corners
        self._at = at
        return self._counted_cells(first, self._integers(second, "int"))

    def _counted_cells(self, n_cells: int, numbers: Longs) -> tuple[Longs, Longs]:
        """Sizes and corners of cells that are stored as a count followed by corners."""
        if n_cells > len(numbers):
            raise self.damaged("more cells than numbers")
        size = int(numbers[0]) + 1 if n_cells else 0
        if size > 0 and n_cells * size == len(numbers) and (numbers[::size] == size - 1).all():
            firsts = np.arange(n_cells, dtype=np.int64) * size
        else:
            firsts = np.empty(n_cells, dtype=np.int64)
            values = numbers.tolist()
            at = 0
            for k in range(n_cells):
                firsts[k] = at
                at += values[at] + 1 if at < len(values) and values[at] >= 0 else len(values) + 1
            if at != len(values):
                raise self.damaged("the numbers of corners do not add up to the size of the cells")
        is_corner = np.ones(len(numbers), dtype=bool)
        is_corner[firsts] = False
        return numbers[firsts], numbers[is_corner]

    def _skip(self, count: int, kind: str) -> None:
        if self._words is not None:
            self._next_words(count)
        elif kind.lower() == "bit":
            self._next_bytes((count + 7) // 8)
        else:
            self._next_bytes(count * np.dtype(self._code(kind)).itemsize)

    def _code(self, kind: str) -> str:
        code = _CODES.get(kind.lower())
        if code is None:
            raise errors.UnsupportedError(
                f"numbers of the type {kind[:40]!r} are not read", where=self.where()
            )
        return code

    def _next_words(self, count: int) -> slice:
        assert self._words is not None
        first = int(np.searchsorted(self._words.starts, self._at))
        self._words.require(first + count, "numbers")
        if count:
            # Keep the line end, so that a blank line after it still ends METADATA.
            self._at = int(self._words.stops[first + count - 1])
        return slice(first, first + count)

    def _next_bytes(self, count: int) -> int:
        at = self._at
        if at + count > len(self._data):
            raise errors.cut_short(
                f"{at + count - len(self._data):,} bytes are missing", f"byte {len(self._data)}"
            )
        self._at += count
        return at

    def read_section(self, words: list[str]) -> None:
        """Read a section before the attributes; ``words`` are those of its first line."""
        keyword = words[0].upper()
        if keyword == "POINTS":
            n_points, kind = self.count_of(words, 1, "points"), self.word_of(words, 2)
            code = self._code(kind)
            if code not in _PRECISIONS:
                raise errors.UnsupportedError(
                    f"the points are stored as {kind}, not as float or double",
                    where=self.where(),
                    hint="write the points as float or double",
                )
            self.precision = _PRECISIONS[code]
            self.points = self._floats(n_points, code, is_normals=False)
        elif keyword in _CELLS:
            self.surface.add(_CELLS[keyword], *self._read_cells(words))
        elif keyword == "CELLS":
            self.cells = self._read_cells(words)
        elif keyword == "CELL_TYPES":
            if self.cells is None:
                raise self.damaged("CELL_TYPES without CELLS")
            types = self._integers(self.count_of(words, 1, "cells"), "int")
            self.surface.add_types(types, *self.cells)
            self.cells = None
        elif keyword == "METADATA":
            self._skip_paragraph()
        elif keyword == "FIELD":
            self._read_field(words, "")
        else:
            raise self.damaged(f"{words[0][:40]!r} is no section of a VTK file")

    def read_attributes(self, words: list[str]) -> None:
        """Find normals of points among the attributes, whose first line is ``words``; attributes
        that are not understood are kept."""
        owner, n_tuples = "", 0
        try:
            while words:
                keyword = words[0].upper()
                if keyword in ("POINT_DATA", "CELL_DATA"):
                    owner = keyword[: -len("_DATA")].lower()
                    n_tuples = self.count_of(words, 1, "tuples")
                elif keyword == "METADATA":
                    self._skip_paragraph()
                elif keyword == "FIELD":
                    self._read_field(words, owner, n_tuples)
                else:
                    self._read_attribute(words, owner, n_tuples)
                words = self.line()
        except errors.InputError as failure:
            first = failure.where or "the first"
            self.warnings.append(
                f"attributes from {first} on, kept although they were not understood ({failure})"
            )

    def _read_attribute(self, words: list[str], owner: str, n_tuples: int) -> None:
        keyword = words[0].upper()
        name = self.word_of(words, 1)
        if keyword == "SCALARS":
            width = int(words[3]) if len(words) > 3 and words[3].isdigit() else 1
            table = self.line()
            if not table or table[0].upper() != "LOOKUP_TABLE":
                self._at = self._before_line
            self._skip(n_tuples * width, self.word_of(words, 2))
        elif keyword == "COLOR_SCALARS":
            width = self.count_of(words, 2, "colours")
            self._skip(n_tuples * width, "unsigned_char")
        elif keyword == "LOOKUP_TABLE":
            self._skip(4 * self.count_of(words, 2, "colours"), "unsigned_char")
        elif keyword == "NORMALS" and owner == "point":
            self.normals = self._read_normals(n_tuples, self.word_of(words, 2))
        elif keyword in _PER_TUPLE:
            self._skip(n_tuples * _PER_TUPLE[keyword], self.word_of(words, 2))
        elif keyword == "TEXTURE_COORDINATES":
            self._skip(n_tuples * self.count_of(words, 2, "numbers"), self.word_of(words, 3))
        else:
            raise errors.FormatError(f"{words[0][:40]!r} is no attribute", where=self.where())
        if keyword == "NORMALS" and owner == "cell":
            self.warnings.append("normals of cells are kept as they are")
        self.properties.append(f"{owner}.{name}")

    def _read_field(self, words: list[str], owner: str, n_points: int = -1) -> None:
        for _ in range(self.count_of(words, 2, "arrays")):
            header = self.line()
            if header and header[0].upper() == "METADATA":
                self._skip_paragraph()
                header = self.line()
            width, n_tuples = (self.count_of(header, k, "numbers") for k in (1, 2))
            name, kind = self.word_of(header, 0), self.word_of(header, 3)
            is_normals = owner == "point" and width == 3 and name.lower() == "normals"
            if is_normals and n_tuples == n_points and self.normals is None:
                self.normals = self._read_normals(n_tuples, kind)
            else:
                self._skip(width * n_tuples, kind)
            self.properties.append(f"{owner}.{name}" if owner else f"field {name}")


# Cells: the polygons of a surface in file order; other cells are counted

_CURVED = (22, 23, 28, 30, 32, 34, 36, 69, 70, 76, 77)
"""Types of second-order surface cells, which are refused."""

_KINDS = {
    **dict.fromkeys((1, 2), "vertex"),
    **dict.fromkeys((3, 4), "line"),
    **dict.fromkeys((5, 7, 8, 9), "polygon"),
    6: "strip",
    **dict(enumerate(("tetrahedron", "voxel", "hexahedron", "wedge", "pyramid"), 10)),
    42: "polyhedron",
}
_CORNERS = {5: ("triangle", 3), 8: ("pixel", 4), 9: ("quad", 4)}
"""Surface cells with a fixed number of corners."""

_FLAT = ("polygon", "strip", "line", "vertex")


class Cells:
    """Polygons collected block by block, and the number of cells of each kind."""

    def __init__(self) -> None:
        self._corners: list[Longs] = [_ZERO[:0]]
        self._sizes: list[Longs] = [_ZERO[:0]]
        self._counts: Counter[str] = Counter()
        self._small = 0

    def add(self, kind: str, sizes: Longs, corners: Longs) -> None:
        """Add cells of one kind: ``sizes`` (k,), and their corners, concatenated.

        Cells that are not a surface are only counted.
        """
        self._counts[kind] += len(sizes)
        if kind == "strip":
            n_triangles = np.maximum(sizes - 2, 0)
            inside = number_within(n_triangles)
            at = np.repeat(np.cumsum(sizes) - sizes, n_triangles) + inside
            # Every second triangle is reversed, so that all face the same way.
            odd = inside % 2
            corners = corners[np.stack([at + odd, at + 1 - odd, at + 2], axis=1)].reshape(-1)
            sizes = np.full(len(at), 3, dtype=np.int64)
        elif kind != "polygon":
            return
        elif not (is_face := sizes >= 3).all():
            self._small += int(np.count_nonzero(~is_face))
            corners, sizes = corners[np.repeat(is_face, sizes)], sizes[is_face]
        self._corners.append(corners)
        self._sizes.append(sizes)

    def add_types(self, types: Longs, sizes: Longs, corners: Longs) -> None:
        """Add the cells of an unstructured grid with VTK's numbers of ``types`` (k,): polygons in
        file order, and after them strips."""
        if len(types) != len(sizes):
            raise errors.damaged(f"{len(types):,} types for {len(sizes):,} cells", "cells")
        if n_curved := int(np.isin(types, _CURVED).sum()):
            raise errors.UnsupportedError(
                f"the file has second-order surface cells ({n_curved:,})",
                hint="write it with first-order triangles or quads",
            )
        for type, (name, size) in _CORNERS.items():
            if ((types == type) & (sizes != size)).any():
                raise errors.damaged(f"a {name} has not {size} corners")
        # The corners of a pixel are stored row by row.
        last = np.cumsum(sizes)[types == 8] - 1
        corners[[last - 1, last]] = corners[[last, last - 1]]
        kinds: dict[str, list[int]] = {}
        for type in np.unique(types).tolist():
            kinds.setdefault(_KINDS.get(type, f"type-{type} cell"), []).append(type)
        for kind, own in kinds.items():
            chosen = np.isin(types, own)
            self.add(kind, sizes[chosen], corners[np.repeat(chosen, sizes)])

    def polygons(self) -> tuple[Longs, Longs]:
        """The corners (c,) of all polygons, as the file numbers them, and how many each has."""
        return np.concatenate(self._corners), np.concatenate(self._sizes)

    def describe(self, without: Sequence[str] = ()) -> str:
        """The cells except some kinds, such as ``"3 tetrahedra, 1 line"``."""
        counts = {kind: n for kind, n in self._counts.items() if n and kind not in without}
        return ", ".join(errors.format_count(n, kind) for kind, n in counts.items())

    def warnings(self) -> tuple[str, ...]:
        others = self.describe(_FLAT)
        strips = errors.format_count(self._counts["strip"] or None, "triangle strip")
        small = errors.format_count(self._small or None, "polygon")
        warnings = {
            f"other cells ({others}), kept; their corners move with the surface": others,
            f"{strips} read as triangles, and kept": strips,
            f"{small} of fewer than three corners, kept and left out": small,
        }
        return tuple(warning for warning, has_some in warnings.items() if has_some)
