"""Gmsh files (``.msh``) of versions 2 and 4: nodes replaced inside the original bytes.

Read are ascii and binary files, binary ones in either byte order.  Names, entities, data of nodes
and of elements, periodic links and every other section are kept without being looked into.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Bytes, Longs
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.slots import BinaryNumbers, UnitSlots
from msal_cli.codecs.surface_cells import CURVED, SurfaceCells, runs_of
from msal_cli.codecs.tokens import Words, indices_of
from msal_cli.errors import EXPORT_AGAIN, FormatError, TruncatedError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_HEADER = re.compile(rb"\$MeshFormat\s+(\d+)(?:\.(\d+))?\s+([01])\s+(\d+)[ \t]*\r?\n")
_SIZES = {1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 12: 27, 13: 18}
_SIZES |= {14: 14, 15: 1, 16: 8, 17: 20, 18: 15, 19: 13, 20: 9, 21: 10, 22: 12, 23: 15, 24: 15}
_SIZES |= {25: 21, 26: 4, 27: 5, 28: 6, 29: 20, 30: 35, 31: 56, 92: 64, 93: 125}
_KINDS = {
    1: "line",
    2: "triangle",
    3: "quad",
    4: "tetra",
    5: "hexahedron",
    6: "wedge",
    7: "pyramid",
    15: "vertex",
    **dict.fromkeys((9, 10, 16, 20, 21, 22, 23, 24, 25), CURVED),
}
_FLUENT = re.compile(rb"\s*\((?:0|1|2|10|12|13|39|45)\s")
"""The first section of a mesh of ANSYS Fluent: the number of its kind in parentheses."""


def parse(data: Buffer) -> Layout:
    """Read a Gmsh file; UnsupportedError for versions 1 and 3, and curved elements."""
    header = _HEADER.search(data, 0, 4096)
    if not header:
        if re.match(rb"\s*\$NOD\s", data):
            raise _unknown_version("1")
        if _FLUENT.match(data):
            raise UnsupportedError(
                "this is a mesh of ANSYS Fluent, which has the suffix .msh too, and is not read",
                hint="export the surface as STL, PLY or OBJ",
            )
        raise FormatError("there is no $MeshFormat", where="line 1", hint=EXPORT_AGAIN)
    version = int(header[1]), int((header[2] or b"0")[:1])
    if version[0] not in (2, 4) or version > (4, 1):
        raise _unknown_version(f"{version[0]}.{version[1]}")
    if version[0] == 2 and re.search(rb"(?m)^\$ParametricNodes\s", data):
        raise UnsupportedError(
            "nodes with parameters are not read in version 2",
            hint="write version 4.1, or without Mesh.SaveParametric",
        )
    is_text = header[3] == b"0"
    cells = SurfaceCells()
    if is_text:
        tags, positions = _text_nodes(_section(data, "Nodes"), version)
        _text_elements(_section(data, "Elements"), version, cells)
    else:
        source = _Binary(data, header.end(), int(header[4]))
        source.go_behind(b"$Nodes")
        tags, positions = _binary_nodes(source, version)
        source.go_behind(b"$Elements")
        _binary_elements(source, version, cells)
    names = [
        one.decode()
        for one in re.findall(rb"(?m)^\$((?:Element)?(?:Node)?Data|PhysicalNames)\b", data)
    ]
    return cells.content(
        positions,
        "text" if is_text else "float64",
        corners=indices_of(tags, cells.corners()),
        properties=tuple(dict.fromkeys(names)),
    )


def _unknown_version(version: str) -> UnsupportedError:
    return UnsupportedError(
        f"version {version} of Gmsh's format is not read", hint="write version 2.2, 4.0 or 4.1"
    )


# ascii


def _section(data: Buffer, name: str) -> Words:
    """The words between ``$name`` and ``$Endname``."""
    start = re.search(rb"(?m)^[ \t]*\$%s\s" % name.encode(), data)
    if not start:
        raise FormatError(f"there is no ${name}", hint=EXPORT_AGAIN)
    end = re.compile(rb"\$End%s" % name.encode()).search(data, start.end() - 1)
    if not end:
        raise TruncatedError(
            f"the file ends before $End{name}", hint="the file was cut short; export it again"
        )
    return Words(data, start.end(), end.start())


def _text_nodes(words: Words, version: tuple[int, int]) -> tuple[Longs, UnitSlots]:
    """UnitSlots (n,) and positions of the nodes."""
    if version[0] == 2:
        count = words.count(0, "nodes")
        words.require(1 + 4 * count, f"{count} nodes")
        first = 1 + 4 * np.arange(count, dtype=np.int64)
        return words.integers(first), words.float_rows(first + 1)
    n_blocks = words.count(0, "blocks")
    tags, at = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    is_old = version[1] == 0
    next_word = 2 if is_old else 4
    for _ in range(n_blocks):
        words.require(next_word + 4, "nodes")
        dimension = words.count(next_word + (1 if is_old else 0), "dimensions")
        extra = dimension if words.word(next_word + 2) == b"1" else 0
        count = words.count(next_word + 3, "nodes")
        next_word += 4
        words.require(next_word + count * (4 + extra), f"{count} nodes")
        rows = np.arange(count, dtype=np.int64)
        if is_old:
            first = next_word + rows * (4 + extra)
            tags.append(words.integers(first))
            at.append(first + 1)
        else:
            tags.append(words.integers(next_word + rows))
            at.append(next_word + count + rows * (3 + extra))
        next_word += count * (4 + extra)
    return np.concatenate(tags), words.float_rows(np.concatenate(at))


def _text_elements(words: Words, version: tuple[int, int], cells: SurfaceCells) -> None:
    if version[0] == 4:
        n_blocks = words.count(0, "blocks")
        next_word = 2 if version[1] == 0 else 4
        for _ in range(n_blocks):
            words.require(next_word + 4, "elements")
            kind, count = words.count(next_word + 2, "type"), words.count(next_word + 3, "elements")
            width = 1 + _size_of(kind)
            next_word += 4
            words.require(next_word + count * width, f"{count} elements")
            if _sort(cells, kind, count):
                first = next_word + width * np.arange(count, dtype=np.int64)
                cells.add(_KINDS[kind], words.integer_rows(first, width)[:, 1:])
            next_word += count * width
        return
    count = words.count(0, "elements")
    first, lengths = words.lines_of_words()
    is_element = first > 0
    first, lengths = first[is_element][:count], lengths[is_element][:count]
    if len(first) < count:
        raise TruncatedError(f"only {len(first)} of {count} elements are there", hint=EXPORT_AGAIN)
    words.require_lengths(first, lengths, 3, "element")
    kinds, n_tags = words.integers(first + 1), words.integers(first + 2)
    for run in runs_of(kinds):
        kind = int(kinds[run.start])
        own, behind = first[run], n_tags[run]
        if size := _sort(cells, kind, len(own)):
            wrong = (behind < 0) | (lengths[run] != 3 + behind + size)
            if wrong.any():
                raise FormatError(
                    "an element has not as many nodes as its type asks for",
                    where=words.where(int(own[int(np.argmax(wrong))])),
                    hint=EXPORT_AGAIN,
                )
            cells.add(_KINDS[kind], words.integer_rows(own + 3 + behind, size))


def _size_of(kind: int) -> int:
    if kind not in _SIZES:
        raise UnsupportedError(f"elements of Gmsh's type {kind} are not known")
    return _SIZES[kind]


def _sort(cells: SurfaceCells, kind: int, count: int) -> int:
    return cells.sort(_KINDS.get(kind, f"element of type {kind}"), count, f"of type {kind}")


# binary


@dataclass(eq=False)
class _Binary:
    """A position in a binary file, whose integers are as the one behind the header is."""

    data: Buffer
    at: int
    size_bytes: int
    order: str = "<"

    def __post_init__(self) -> None:
        one = bytes(memoryview(self.data)[self.at : self.at + 4])
        if one not in (b"\1\0\0\0", b"\0\0\0\1"):
            raise FormatError("the byte order is not given", where=f"byte {self.at}")
        if self.size_bytes not in (4, 8):
            raise FormatError(f"numbers of {self.size_bytes} bytes", where="line 2")
        self.order = "<" if one[0] else ">"
        self.at += 4

    def whole(self) -> Bytes:
        """The whole file (size,)."""
        from msal_cli.kernels.text import as_bytes

        return as_bytes(self.data)

    def go_behind(self, line: bytes) -> None:
        """Go to the first byte behind the next line that is just this one."""
        found = re.compile(rb"\n\s*%s[ \t]*\r?\n" % re.escape(line)).search(self.data, self.at)
        if not found:
            raise FormatError(f"there is no {line.decode()}", hint=EXPORT_AGAIN)
        self.at = found.end()

    def text_count(self) -> int:
        """A number that is written in digits on its line."""
        found = re.compile(rb"(\d{1,18})[ \t]*\r?\n").match(self.data, self.at)
        if not found:
            raise FormatError("a count is missing", where=f"byte {self.at}", hint=EXPORT_AGAIN)
        self.at = found.end()
        return int(found[1])

    def skip(self, size: int) -> int:
        """Go ``size`` bytes on; returns where they begin."""
        at = self.at
        if size < 0 or at + size > len(self.data):
            raise TruncatedError(
                "the file ends before all numbers are there",
                where=f"byte {len(self.data)}",
                hint="the file was cut short; copy or export it again",
            )
        self.at += size
        return at

    def integers(self, count: int, size: int = 4) -> Longs:
        """The next integers, of ``size`` bytes each."""
        at = self.skip(count * size)
        return self.whole()[at : at + count * size].view(f"{self.order}i{size}").astype(np.int64)


def _binary_nodes(source: _Binary, version: tuple[int, int]) -> tuple[Longs, UnitSlots]:
    code = f"{source.order}f8"
    if version[0] == 2:
        count = source.text_count()
        at = source.skip(28 * count) + 28 * np.arange(count, dtype=np.int64)
        return _tags_at(source, at), BinaryNumbers(source.whole(), at + 4, code)
    tags, places = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    is_old = version[1] == 0
    n_blocks = int(source.integers(2 if is_old else 4, source.size_bytes)[0])
    for _ in range(n_blocks):
        head = source.integers(3)
        dimension = int(head[1 if is_old else 0])
        extra = dimension if head[2] == 1 else 0
        count = int(source.integers(1, source.size_bytes)[0])
        if not 0 <= extra <= 3 or not 0 <= count <= len(source.data):
            raise FormatError("a block of nodes is damaged", where=f"byte {source.at}")
        rows = np.arange(count, dtype=np.int64)
        if is_old:
            at = source.skip((28 + 8 * extra) * count) + (28 + 8 * extra) * rows
            tags.append(_tags_at(source, at))
            places.append(at + 4)
        else:
            tags.append(source.integers(count, source.size_bytes))
            size = 24 + 8 * extra
            places.append(source.skip(size * count) + size * rows)
    return np.concatenate(tags), BinaryNumbers(source.whole(), np.concatenate(places), code)


def _tags_at(source: _Binary, at: Longs) -> Longs:
    data = source.whole()
    rows = np.stack([data[at + k] for k in range(4)], axis=1)
    return np.ascontiguousarray(rows).view(f"{source.order}i4").reshape(-1).astype(np.int64)


def _binary_elements(source: _Binary, version: tuple[int, int], cells: SurfaceCells) -> None:
    if version[0] == 2:
        left = source.text_count()
        while left > 0:
            kind, count, n_tags = source.integers(3).tolist()
            if not 0 < count <= left or n_tags < 0:
                raise FormatError("a block of elements is damaged", where=f"byte {source.at}")
            size = 1 + n_tags + _size_of(kind)
            numbers = source.integers(count * size).reshape(-1, size)
            if _sort(cells, kind, count):
                cells.add(_KINDS[kind], numbers[:, 1 + n_tags :])
            left -= count
        return
    is_old = version[1] == 0
    n_blocks = int(source.integers(2 if is_old else 4, source.size_bytes)[0])
    for _ in range(n_blocks):
        kind = int(source.integers(3)[2])
        count = int(source.integers(1, source.size_bytes)[0])
        if not 0 <= count <= len(source.data):
            raise FormatError("a block of elements is damaged", where=f"byte {source.at}")
        size = 1 + _size_of(kind)
        numbers = source.integers(count * size, 4 if is_old else source.size_bytes)
        if _sort(cells, kind, count):
            cells.add(_KINDS[kind], numbers.reshape(-1, size)[:, 1:])
