"""Writing PLY files: with another encoding or other number types, and new ones of a mesh.

A re-encoded file keeps every element, property and comment, in order; in its header only the format
line and the types of ``x y z nx ny nz`` change.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats, Ints, Longs
from msal_cli.codecs.ply_body import Lines, Part, Section, section_at
from msal_cli.codecs.ply_header import NORMAL, POSITION, TYPES, Header, Property
from msal_cli.codecs.slots import as_float32, to_type
from msal_cli.errors import ContentError

_CHUNK = 65_536  # records converted to text at a time


class Numbers(NamedTuple):
    """The ``values`` of one property in all records, in native byte order, record by record, and
    their number in each record (count,); None for one each."""

    values: NDArray[Any]
    lengths: Longs | None = None


def recode(
    data: Bytes, old: Header, new: Header, text: bytes, values: Mapping[str, Floats], end: int
) -> bytearray:
    """A file with another encoding or other number types.

    Parameters
    ----------
    data, old : the file and its header; ``end`` is the byte after its last element.
    new, text : the new header, with the same elements, and its bytes.
    values : new numbers (n,) of the vertices, by their properties.
    """
    output = bytearray(text)
    keeps_encoding = new.encoding == old.encoding
    at = old.size
    for element, renewed in zip(old.elements, new.elements, strict=True):
        names = [prop.name for prop in element.properties]
        section = section_at(Part(data, old, element, at), names)
        at = section.stop
        own = values if element.name == "vertex" else {}
        if keeps_encoding and renewed == element and not own:
            output += data[section.start : section.stop].data
            continue
        columns: list[Numbers] = []
        for prop in renewed.properties:
            numbers = _read_numbers(section, prop, own.get(prop.name))
            if prop.is_list:
                assert numbers.lengths is not None
                columns.append(Numbers(numbers.lengths.astype(prop.count_code)))
            columns.append(numbers)
        if new.encoding == "ascii":
            _append_text(output, columns, element.count, old.newline)
        else:
            _append_binary(output, columns, element.count, new.byte_order)
    if keeps_encoding:
        output += data[end:].data
    return output


def _read_numbers(section: Section, prop: Property, values: Floats | None) -> Numbers:
    """The numbers of a property in its new type; ``values`` (count,) replace those of the file.

    Raises FormatError for a token that is not a number, ContentError (``E_RANGE``) for a number
    that does not fit the type.
    """
    dtype = np.dtype(prop.code)
    given: NDArray[Any]
    lengths: Longs | None = None
    if values is not None:
        given = values
    elif isinstance(section, Lines):
        given, lengths = _read_tokens(section, prop, dtype)
    else:
        given, lengths = section.items(prop.name)
        given, lengths = given.reshape(-1), lengths if prop.is_list else None
    if given.dtype.kind == "f" and dtype != given.dtype.newbyteorder("="):
        exact, given = given, to_type(_as_float64(given), dtype.str)
        if dtype.kind == "f":
            _require_all(np.isfinite(given) | ~np.isfinite(exact), section, prop, lengths)
    return Numbers(given.astype(dtype, copy=False), lengths)


def _require_all(
    fits: Flags, section: Section, prop: Property, lengths: Longs | None = None
) -> None:
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


def _read_tokens(section: Lines, prop: Property, dtype: np.dtype[Any]) -> Numbers:
    """A property of an ascii element: whole numbers as ``dtype``, others as float64."""
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
    if dtype.kind == "f":
        return Numbers(values, lengths)
    limits = np.iinfo(dtype)
    fits = (values >= limits.min) & (values <= limits.max) & (np.rint(values) == values)
    # From here on a double cannot distinguish whole numbers.
    fits &= np.abs(values) < 2.0**53
    _require_all(fits, section, prop, lengths)
    return Numbers(values.astype(dtype), lengths)


def _append_binary(output: bytearray, columns: Sequence[Numbers], count: int, order: str) -> None:
    from msal_cli.kernels.ply_scan import scatter

    arrays = [values.astype(order + values.dtype.str[1:]) for values, _ in columns]
    sizes = [
        np.full(count, array.itemsize) if lengths is None else lengths * array.itemsize
        for array, (_, lengths) in zip(arrays, columns, strict=True)
    ]
    ends = np.cumsum(sum(sizes, np.zeros(count, dtype=np.int64)))
    packed = np.empty(int(ends[-1]) if count else 0, dtype=np.uint8)
    at = ends - np.diff(ends, prepend=0)
    for array, size in zip(arrays, sizes, strict=True):
        scatter(packed, at, size, array.view(np.uint8))
        at = at + size
    output += packed.data


def _append_text(output: bytearray, columns: Sequence[Numbers], count: int, newline: bytes) -> None:
    if not columns:
        return
    firsts = [
        np.arange(count + 1)
        if column.lengths is None
        else np.concatenate([[0], np.cumsum(column.lengths)])
        for column in columns
    ]
    for begin in range(0, count, _CHUNK):
        end = min(begin + _CHUNK, count)
        part = [
            (column.values[first[begin] : first[end]], np.diff(first[begin : end + 1]))
            for column, first in zip(columns, firsts, strict=True)
        ]
        output += _lines_of(part, newline).data


def _lines_of(columns: Sequence[tuple[NDArray[Any], Longs]], newline: bytes) -> Bytes:
    """The lines of records as one text; a column is all its values and their number in each
    record (count,)."""
    from msal_cli.kernels.ply_scan import gather

    per_record = sum(lengths for _, lengths in columns)
    ends = np.cumsum(per_record)
    slot = ends - per_record
    # Tokens alternate with the separators after them; the texts of both are in one buffer.
    starts = np.zeros(2 * int(ends[-1]), dtype=np.int64)
    sizes = np.ones_like(starts)
    texts = [np.frombuffer(b" " + newline, dtype=np.uint8)]
    size = len(texts[0])
    for values, lengths in columns:
        slots = np.repeat(slot - (np.cumsum(lengths) - lengths), lengths) + np.arange(len(values))
        slot = slot + lengths
        text, stops = _token_text(values)
        sizes[2 * slots] = np.diff(stops, prepend=0)
        starts[2 * slots] = size + stops - sizes[2 * slots]
        texts.append(text)
        size += len(text)
    starts[2 * ends - 1] = 1
    sizes[2 * ends - 1] = len(newline)
    packed = np.empty(int(sizes.sum()), dtype=np.uint8)
    gather(np.concatenate(texts), starts, sizes, packed)
    return packed


def _as_float64(values: NDArray[Any]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):  # a signalling NaN
        return values.astype(np.float64)


def _token_text(values: NDArray[Any]) -> tuple[Bytes, Longs]:
    """The texts of numbers, concatenated, and the end of each: whole numbers plain, others as the
    shortest text that is read as the same value of their type."""
    from msal_cli.kernels.text import print_numbers, print_shortest

    if values.dtype.kind == "f":
        return print_shortest(_as_float64(values), values.itemsize == 4)
    if values.itemsize < 8 or (np.abs(values.astype(np.float64)) < 2.0**53).all():
        return print_numbers(values.astype(np.float64), 0)
    tokens = [b"%d" % value for value in values.tolist()]
    stops = np.cumsum([len(token) for token in tokens], dtype=np.int64)
    return np.frombuffer(b"".join(tokens), dtype=np.uint8), stops


_TYPES = {"<f4": "float", "<f8": "double", "u1": "uchar"}
_SHADES = ("red", "green", "blue", "alpha")


def write_ply(
    vertices: Floats,
    corners: Longs | Ints,
    sizes: Longs,
    *,
    single: bool,
    normals: Floats | None = None,
    colours: NDArray[np.uint8] | None = None,
    fields: Mapping[str, Floats] | None = None,
    comments: Sequence[str] = (),
) -> bytes:
    """A binary file, little endian.

    Parameters
    ----------
    vertices : (n, 3) positions, stored as ``float`` if ``single``, else as ``double``.
    corners, sizes : polygons as of ``MeshFile.polygons``.
    normals : (n, 3), stored as ``float``; colours : (n, 3) or (n, 4).
    fields : numbers (n,) by the names of their properties; stored as ``float``.
    comments : lines of the header; characters that are not printable ASCII are escaped.
    """
    # Vertices that no face uses need not be finite.
    positions: NDArray[Any] = as_float32(vertices) if single else vertices
    real = "<f4" if single else "<f8"
    columns: list[tuple[str, str, NDArray[Any]]] = []
    columns += [(name, real, column) for name, column in zip(POSITION, positions.T, strict=True)]
    if normals is not None:
        columns += [(name, "<f4", column) for name, column in zip(NORMAL, normals.T, strict=True)]
    if colours is not None:
        columns += [(name, "u1", shade) for name, shade in zip(_SHADES, colours.T, strict=False)]
    columns += [(name, "<f4", values) for name, values in (fields or {}).items()]
    rows = np.empty(len(vertices), dtype=[(name, code) for name, code, _ in columns])
    # Fields that are too large for the type become infinite, which readers accept.
    with np.errstate(over="ignore"):
        for name, _, values in columns:
            rows[name] = values
    texts = (comment.encode("ascii", "backslashreplace").decode() for comment in comments)
    shown = ("".join(c if c.isprintable() else f"\\x{ord(c):02x}" for c in text) for text in texts)
    count_type = "uint" if int(sizes.max()) > 255 else "uchar"
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {text[:1000]}" for text in shown]
    header += [f"element vertex {len(rows)}"]
    header += [f"property {_TYPES[code]} {name}" for name, code, _ in columns]
    header += [f"element face {len(sizes)}", f"property list {count_type} int vertex_indices"]
    lists = [Numbers(sizes.astype(TYPES[count_type])), Numbers(corners.astype(np.int32), sizes)]
    faces = bytearray()
    _append_binary(faces, lists, len(sizes), "<")
    return b"".join(("\n".join([*header, "end_header", ""]).encode(), rows.data, faces))
