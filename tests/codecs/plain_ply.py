"""PLY written and read in the plainest way, value by value: the tests' own idea of the format."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field, replace
from itertools import pairwise

PACK = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H",
    "uint16": "H", "int": "i", "int32": "i", "uint": "I", "uint32": "I", "int64": "q",
    "uint64": "Q", "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip
ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")
FLOATS = ("float", "float32", "double", "float64")


@dataclass
class Element:
    """``properties`` are (name, type, count type or ""); ``rows`` hold one value or list each."""

    name: str
    properties: list[tuple[str, str, str]]
    rows: list[list]

    def column(self, name: str) -> int:
        return [one[0] for one in self.properties].index(name)


@dataclass
class Ply:
    """A PLY file as plain Python data."""

    encoding: str
    elements: list[Element]
    comments: list[str] = field(default_factory=list)
    newline: str = "\n"
    trailing: bytes = b""

    def element(self, name: str) -> Element:
        return next(one for one in self.elements if one.name == name)

    def with_columns(self, element: str, columns: dict[str, list]) -> Ply:
        """The same with other values in some scalars of an element."""
        old = self.element(element)
        rows = [list(row) for row in old.rows]
        for name, values in columns.items():
            for row, value in zip(rows, values, strict=True):
                row[old.column(name)] = value
        new = replace(old, rows=rows)
        return replace(self, elements=[new if one is old else one for one in self.elements])


def header(ply: Ply) -> bytes:
    lines = ["ply", f"format {ply.encoding} 1.0", *ply.comments]
    for element in ply.elements:
        lines.append(f"element {element.name} {len(element.rows)}")
        for name, kind, count_kind in element.properties:
            lines.append(
                f"property list {count_kind} {kind} {name}"
                if count_kind
                else f"property {kind} {name}"
            )
    return "".join(line + ply.newline for line in [*lines, "end_header"]).encode()


def written(ply: Ply) -> bytes:
    """The file's bytes; a value that is a str is put into ascii as it stands."""
    out = [header(ply)]
    sign = ">" if ply.encoding == "binary_big_endian" else "<"
    for element in ply.elements:
        for row in element.rows:
            numbers = []
            for (_, kind, count_kind), value in zip(element.properties, row, strict=True):
                values = value if count_kind else [value]
                numbers += [(count_kind, len(values))] if count_kind else []
                numbers += [(kind, one) for one in values]
            if ply.encoding != "ascii":
                out += [struct.pack(sign + PACK[kind], number) for kind, number in numbers]
            elif numbers:
                line = " ".join(str(number) for _, number in numbers)
                out.append((line + ply.newline).encode())
    return b"".join(out) + ply.trailing


def read(data: bytes) -> Ply:
    """The file as plain data; good files only."""
    newline = "\r\n" if data[3:5] == b"\r\n" else chr(data[3])
    end = data.index(b"end_header" + newline.encode()) + len("end_header" + newline)
    lines = data[:end].decode("latin-1").split(newline)
    ply = Ply("", [], newline=newline)
    counts = []
    for line in lines[1:]:
        words = line.split()
        if words[:1] == ["format"]:
            ply.encoding = words[1]
        elif words[:1] == ["element"]:
            ply.elements.append(Element(words[1], [], []))
            counts.append(int(words[2]))
        elif words[:2] == ["property", "list"]:
            ply.elements[-1].properties.append((words[4], words[3], words[2]))
        elif words[:1] == ["property"]:
            ply.elements[-1].properties.append((words[2], words[1], ""))
        elif words[:1] in (["comment"], ["obj_info"], ["Created"]):
            ply.comments.append(line)
    is_text, at = ply.encoding == "ascii", end
    sign = ">" if ply.encoding == "binary_big_endian" else "<"
    words = iter(data[end:].split())

    def number(kind: str):
        nonlocal at
        if is_text:
            return float(next(words)) if kind in FLOATS else int(next(words))
        (value,) = struct.unpack_from(sign + PACK[kind], data, at)
        at += struct.calcsize(sign + PACK[kind])
        return value

    def value(kind: str, count_kind: str):
        return [number(kind) for _ in range(number(count_kind))] if count_kind else number(kind)

    for element, count in zip(ply.elements, counts, strict=True):
        element.rows = [[value(*p[1:]) for p in element.properties] for _ in range(count)]
    ply.trailing = b"" if is_text else data[at:]
    return ply


def triangles(ply: Ply) -> list[list[int]]:
    """Fans of the faces, then the strips unrolled."""
    result = []
    for element in ply.elements:
        if element.name == "face":
            k = next(i for i, p in enumerate(element.properties) if p[0].startswith("vertex_ind"))
            for row in element.rows:
                corners = row[k]
                result += [[corners[0], b, c] for b, c in pairwise(corners[1:])]
    for element in ply.elements:
        if element.name == "tristrips":
            for row in element.rows:
                run: list[int] = []
                for corner in row[0]:
                    run = [] if corner == -1 else [*run, corner]
                    if len(run) > 2:
                        a, b, c = run[-3:]
                        if len({a, b, c}) == 3:
                            result.append([a, b, c] if len(run) % 2 else [b, a, c])
    return result


def single(value: float) -> float:
    """The float32 next to a value."""
    return struct.unpack("<f", struct.pack("<f", value))[0]


def cube(encoding: str = "binary_little_endian", kind: str = "float") -> Ply:
    """A cube of quads with colours, a camera, edges and comments."""
    corners = [[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)]
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return Ply(
        encoding,
        [
            Element("camera", [("focal", "float", ""), ("k1", "double", "")], [[0.25, 1.5]]),
            Element(
                "vertex",
                [("x", kind, ""), ("y", kind, ""), ("z", kind, ""), ("red", "uchar", "")],
                [[*corner, k] for k, corner in enumerate(corners)],
            ),
            Element("face", [("vertex_indices", "int", "uchar")], [[quad] for quad in quads]),
            Element("edge", [("vertex1", "int", ""), ("vertex2", "int", "")], [[0, 1], [1, 3]]),
        ],
        ["comment made by a test", "obj_info 42 frames"],
    )
