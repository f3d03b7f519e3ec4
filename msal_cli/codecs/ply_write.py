"""PLY files written: in another encoding or with other types of numbers, and new ones of a mesh.

Of a file that is re-encoded every element, property and comment is kept, in its order; of the
header only the format line and the types of ``x y z nx ny nz`` change.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Ints, Longs
from msal_cli.codecs.mesh_file import MeshFile
from msal_cli.codecs.ply_body import Lines, Section, section_at
from msal_cli.codecs.ply_header import Header, Property, retype_header
from msal_cli.codecs.slots import to_type
from msal_cli.errors import ContentError, InternalError, UsageError
from msal_cli.storage.regular import Buffer

_ENCODINGS = {"ascii": "ascii", "binary": "binary_little_endian"}
_CODES = {"float32": "f4", "float64": "f8"}

_COMMENT = re.compile(rb"[ \t]*(?:comment|obj_info)(?:\s|\Z)")

_CHUNK = 65_536
"""Records turned into text at a time."""


@dataclass(frozen=True)
class Column:
    """The values of one property in native byte order: (count,), or for a list all items one
    record behind another with the number of each record's items in ``lengths`` (count,)."""

    property: Property
    values: NDArray[Any]
    lengths: Longs | None


class Recoding:
    """A change of encoding and number types, and what it makes of a file.

    ``encoding`` is ``same``, ``ascii`` or ``binary`` (little endian); ``precision`` is ``same``,
    ``float32`` or ``float64``; ``is_stream`` says that the file's ascii records do not stand one
    to a line.  Raises UsageError for any other word.
    """

    def __init__(
        self,
        data: Bytes,
        header: Header,
        encoding: str,
        precision: str,
        retypable: Mapping[str, Sequence[str]],
        is_stream: bool = False,
    ) -> None:
        if encoding not in ("same", *_ENCODINGS) or precision not in ("same", *_CODES):
            raise UsageError(
                f"a PLY file cannot be written with encoding '{encoding}' and precision "
                f"'{precision}'",
                hint="encodings are same, ascii, binary; precisions same, float32, float64",
            )
        self._data = data
        self._header = header
        self._is_stream = is_stream
        self.encoding = _ENCODINGS.get(encoding, header.encoding)
        self._codes: dict[int, str] = {}
        if precision != "same":
            self._codes = {
                prop.line: _CODES[precision]
                for element in header.elements
                for prop in element.properties
                if prop.name in retypable.get(element.name, ()) and prop.code != _CODES[precision]
            }

    @property
    def is_same(self) -> bool:
        """Whether nothing but values changes."""
        return self.keeps_encoding and not self._codes

    @property
    def keeps_encoding(self) -> bool:
        return self.encoding == self._header.encoding

    def code(self, prop: Property) -> str:
        """The numpy code with which a property is written."""
        return self._codes.get(prop.line, prop.code)

    def header(self) -> bytes:
        text = self._data[: self._header.size].tobytes()
        return retype_header(self._header, text, self.encoding, self._codes)

    def encoded(self, values: Mapping[tuple[str, str], Floats], end: int) -> bytearray:
        """The whole file.  ``values`` holds, for (element, property), the (count,) numbers to be
        written in place of the file's; ``end`` is the byte behind the last element."""
        output = bytearray(self.header())
        at = self._header.size
        if not self.keeps_encoding and self._header.encoding == "ascii":
            # Binary records leave no room for comments: they become the last lines of the header.
            lines = find_body_comments(self._data[at:end].tobytes())
            place = output.rindex(b"end_header")
            output[place:place] = b"".join(line + self._header.newline for line in lines)
        for element in self._header.elements:
            names = [prop.name for prop in element.properties]
            section = section_at(self._data, self._header, element, at, names, self._is_stream)
            at = section.stop
            is_touched = any(
                (element.name, prop.name) in values or prop.line in self._codes
                for prop in element.properties
            )
            if self.keeps_encoding and not is_touched:
                output += self._data[section.start : section.stop].data
                continue
            columns = [
                self._column(section, prop, values.get((element.name, prop.name)))
                for prop in element.properties
            ]
            if self.encoding == "ascii":
                _append_text(output, columns, element.count, self._header.newline)
            else:
                order = ">" if self.encoding == "binary_big_endian" else "<"
                _append_binary(output, columns, element.count, order)
        if self.keeps_encoding:
            output += self._data[end:].data
        return output

    def _column(self, section: Section, prop: Property, values: Floats | None) -> Column:
        dtype = np.dtype(self.code(prop))
        lengths: Longs | None = None
        given: NDArray[Any]
        if values is not None:
            given = values
        elif isinstance(section, Lines):
            return _read_tokens(section, prop, dtype)
        elif prop.is_list:
            given, lengths = section.items(prop.name)
        else:
            given = section.column(prop.name)
        if given.dtype.kind == "f" and dtype != given.dtype.newbyteorder("="):
            column = to_type(_as_float64(given), dtype.str)
            if dtype.kind == "f":
                _require_all(np.isfinite(column) | ~np.isfinite(given), section, prop)
            return Column(prop, column, lengths)
        return Column(prop, given.astype(dtype), lengths)


def find_body_comments(body: bytes) -> list[bytes]:
    """The comments among ascii records, without the blanks around them."""
    if b"comment" not in body and b"obj_info" not in body:
        return []
    return [line.strip() for line in re.split(rb"[\r\n]+", body) if _COMMENT.match(line)]


def _require_all(
    fits: Flags, section: Section, prop: Property, lengths: Longs | None = None
) -> None:
    """Raise ContentError unless every value (count,), or item of a list, fits its type."""
    if fits.all():
        return
    record = int(np.argmin(fits))
    if lengths is not None:
        record = int(np.searchsorted(np.cumsum(lengths), record, side="right"))
    raise ContentError(
        f"'{prop.name}' of {section.element.name} {record} does not fit its number type",
        where=section.where(record),
        hint="keep the file's own encoding and precision, or choose --precision float64",
        code="E_RANGE",
    )


def _read_tokens(section: Lines, prop: Property, dtype: np.dtype[Any]) -> Column:
    """A property of an ascii element as numbers of ``dtype``.

    Raises FormatError for a token that is no number, ContentError (``E_RANGE``) for one that the
    type cannot hold.
    """
    from msal_cli.kernels.text import read_numbers

    lengths: Longs | None = None
    if prop.is_list:
        starts, stops, lengths = section.item_spans(prop.name)
        _require_all(lengths <= np.iinfo(prop.count_code).max, section, prop)
    else:
        starts, stops = section.spans([prop.name])
    values, bad = read_numbers(section.data, starts, stops)
    if bad >= 0:
        raise section.not_a_number(int(starts[bad]), "a number")
    column: NDArray[Any]
    if dtype.kind == "f":
        column = to_type(values, dtype.str)
        fits = np.isfinite(column) | ~np.isfinite(values)
    elif dtype.itemsize == 8:
        column, fits = _long_integers(section, starts, stops, dtype)
    else:
        limits = np.iinfo(dtype)
        fits = (values >= limits.min) & (values <= limits.max) & (np.rint(values) == values)
        column = np.where(fits, values, 0.0).astype(dtype)
    _require_all(fits, section, prop, lengths)
    return Column(prop, column, lengths)


def _long_integers(
    section: Lines, starts: Longs, stops: Longs, dtype: np.dtype[Any]
) -> tuple[NDArray[Any], Flags]:
    """64-bit integers, which a double cannot tell apart, and which of them fit."""
    limits = np.iinfo(dtype)
    column = np.zeros(len(starts), dtype=dtype)
    fits = np.ones(len(starts), dtype=bool)
    for k, (start, stop) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
        token = section.data[start:stop].tobytes()
        # Twenty digits and a sign: longer ones do not fit, and int() is slow on very long ones.
        fits[k] = re.fullmatch(rb"[+-]?[0-9]{1,20}", token) and (
            limits.min <= int(token) <= limits.max
        )
        if fits[k]:
            column[k] = int(token)
    return column, fits


def _append_binary(output: bytearray, columns: Sequence[Column], count: int, order: str) -> None:
    from msal_cli.kernels.ply_scan import scatter

    fields: list[tuple[NDArray[Any], Longs]] = []
    for column in columns:
        if column.lengths is not None:
            counts = column.lengths.astype(order + column.property.count_code)
            fields.append((counts, np.full(count, counts.itemsize)))
        values = column.values.astype(order + column.values.dtype.str[1:])
        lengths = np.ones(count, dtype=np.int64) if column.lengths is None else column.lengths
        fields.append((values, lengths * values.itemsize))
    sizes = sum((size for _, size in fields), np.zeros(count, dtype=np.int64))
    ends = np.cumsum(sizes)
    packed = np.empty(int(ends[-1]) if count else 0, dtype=np.uint8)
    at = ends - sizes
    for values, size in fields:
        scatter(packed, at, size, values.view(np.uint8))
        at = at + size
    output += packed.data


def _append_text(output: bytearray, columns: Sequence[Column], count: int, newline: bytes) -> None:
    """Append ``count`` lines of the columns."""
    if not columns:
        return
    firsts = [
        None if column.lengths is None else np.concatenate([[0], np.cumsum(column.lengths)])
        for column in columns
    ]
    for begin in range(0, count, _CHUNK):
        end = min(begin + _CHUNK, count)
        part = []
        for column, first in zip(columns, firsts, strict=True):
            items = slice(begin, end) if first is None else slice(first[begin], first[end])
            lengths = None if column.lengths is None else column.lengths[begin:end]
            part.append(Column(column.property, column.values[items], lengths))
        output += _lines_of(part, end - begin, newline).data


def _lines_of(columns: Sequence[Column], count: int, newline: bytes) -> Bytes:
    """The lines of ``count`` records as one text."""
    from msal_cli.kernels.ply_scan import gather

    per_record = np.zeros(count, dtype=np.int64)
    for column in columns:
        per_record += 1 if column.lengths is None else column.lengths + 1
    ends = np.cumsum(per_record)
    slot = ends - per_record
    # Tokens and the separators behind them alternate; the texts of both lie in one buffer.
    starts = np.empty(2 * int(ends[-1]), dtype=np.int64)
    sizes = np.empty_like(starts)
    texts = [np.frombuffer(b" " + newline, dtype=np.uint8)]
    size = len(texts[0])
    for column in columns:
        printings = [(column.values, slot)]
        if column.lengths is not None:
            items = np.repeat(
                slot + 1 - (np.cumsum(column.lengths) - column.lengths), column.lengths
            )
            printings = [(column.lengths, slot), (column.values, items + np.arange(len(items)))]
            slot = slot + column.lengths
        slot = slot + 1
        for values, slots in printings:
            text, stops = _token_text(values)
            sizes[2 * slots] = np.diff(stops, prepend=0)
            starts[2 * slots] = size + stops - sizes[2 * slots]
            texts.append(text)
            size += len(text)
    starts[1::2] = 0
    sizes[1::2] = 1
    starts[2 * ends - 1] = 1
    sizes[2 * ends - 1] = len(newline)
    packed = np.empty(int(sizes.sum()), dtype=np.uint8)
    gather(np.concatenate(texts), starts, sizes, packed)
    return packed


def _as_float64(values: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):  # a signalling NaN
        return values.astype(np.float64)


def _token_text(values: NDArray[Any]) -> tuple[Bytes, Longs]:
    """The texts of numbers one behind another and the end of each: whole numbers plain, others
    as the shortest text that reads back as the same value of their type."""
    from msal_cli.kernels.text import print_numbers, print_shortest

    if values.dtype.kind == "f":
        return print_shortest(_as_float64(values), values.itemsize == 4)
    if values.itemsize < 8 or (np.abs(values.astype(np.float64)) < 2.0**53).all():
        return print_numbers(values.astype(np.float64), 0)
    tokens = [b"%d" % value for value in values.tolist()]
    stops = np.cumsum([len(token) for token in tokens], dtype=np.int64)
    return np.frombuffer(b"".join(tokens), dtype=np.uint8), stops


VertexColumn = tuple[str, str, NDArray[Any]]
"""The name of a property, its type in numpy's words, and a number (n,) for each vertex."""

_TYPES = {"<f4": "float", "<f8": "double", "u1": "uchar"}


def write_ply(
    columns: Sequence[VertexColumn], corners: Longs, sizes: Longs, comments: Sequence[str] = ()
) -> bytes:
    """A file of vertices with these ``columns``, and polygons of ``sizes`` (p,) with ``corners``
    (c,) one behind the other.  Comments are printable ASCII."""
    rows = np.empty(len(columns[0][2]), dtype=[(name, code) for name, code, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    is_long = int(sizes.max()) > 255
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {comment}" for comment in comments]
    header += [f"element vertex {len(rows)}"]
    header += [f"property {_TYPES[code]} {name}" for name, code, _ in columns]
    header += [f"element face {len(sizes)}"]
    header += [f"property list {'uint' if is_long else 'uchar'} int vertex_indices"]
    head = "\n".join([*header, "end_header", ""]).encode()
    return b"".join((head, rows.data, _face_bytes(corners, sizes, "<u4" if is_long else "u1")))


def corners_of(polygons: list[Any] | Ints) -> tuple[Longs, Longs]:
    """The corners (c,) of polygons one behind the other, and how many each has (p,)."""
    if isinstance(polygons, np.ndarray):
        sizes = np.full(len(polygons), polygons.shape[1], dtype=np.int64)
        return polygons.reshape(-1).astype(np.int64), sizes
    sizes = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    return np.concatenate(polygons).astype(np.int64), sizes


def _face_bytes(corners: Longs, sizes: Longs, code: str) -> memoryview:
    """Lists of corners: a count of type ``code``, then 32-bit indices."""
    from msal_cli.kernels.ply_scan import scatter

    widths = np.full(len(sizes), np.dtype(code).itemsize)
    ends = np.cumsum(widths + 4 * sizes)
    starts = ends - 4 * sizes
    out = np.empty(int(ends[-1]), dtype=np.uint8)
    scatter(out, starts - widths, widths, sizes.astype(code).view(np.uint8))
    scatter(out, starts, 4 * sizes, corners.astype("<i4").view(np.uint8))
    return out.data


_NAME = re.compile(r"[a-z][a-z0-9_]*")
_TAKEN = frozenset({"x", "y", "z", "red", "green", "blue"})
_MAX_COMMENT = 1000


def with_fields(
    mesh_file: MeshFile,
    vertices: Floats,
    fields: Mapping[str, Floats],
    colours: NDArray[np.uint8] | None = None,
    comments: Sequence[str] = (),
) -> Buffer:
    """A binary PLY of the mesh with numbers, and colours, at its vertices.

    Parameters
    ----------
    mesh_file : the file whose polygons, and whose precision of positions, are taken.
    vertices : (n, 3) positions in file order, file units.
    fields : (n,) numbers by the name of their property; stored as ``float``.
    colours : (n, 3), stored as ``red``, ``green`` and ``blue``; None for none.
    comments : lines of the header; what is no printable ASCII in them is escaped.
    """
    from msal_cli.codecs.slots import as_float32

    is_single = mesh_file.precision == "float32"
    positions: NDArray[Any] = as_float32(vertices) if is_single else vertices
    real = "<f4" if is_single else "<f8"
    columns: list[VertexColumn] = [(name, real, positions[:, k]) for k, name in enumerate("xyz")]
    if colours is not None:
        columns += [(name, "u1", colours[:, k]) for k, name in enumerate(("red", "green", "blue"))]
    for name, values in fields.items():
        if not _NAME.fullmatch(name) or name in _TAKEN or len(values) != len(vertices):
            raise InternalError(f"{name!r} cannot be a field of {len(vertices)} vertices")
        # What is too large for the type becomes infinite, which readers know.
        with np.errstate(over="ignore"):
            columns.append((name, "<f4", values.astype(np.float32)))
    is_triangulated = mesh_file.n_polygons == len(mesh_file.faces)
    corners, sizes = corners_of(mesh_file.faces if is_triangulated else mesh_file.polygons())
    return write_ply(columns, corners, sizes, [_printable(comment) for comment in comments])


def _printable(comment: str) -> str:
    text = comment.encode("ascii", "backslashreplace").decode()
    text = "".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text)
    return text[:_MAX_COMMENT]
