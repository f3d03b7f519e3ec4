"""VTK's legacy files (``.vtk``): points and normals replaced inside the original bytes.

Read are ascii and binary files of versions 1 to 5.1 with polygonal data, unstructured grids, and
structured grids that are one layer of quadrilaterals.  What stands behind the cells (attributes,
fields, metadata) is looked into for normals alone; whatever of it is not understood is kept.
Everything binary is big-endian, as VTK writes it on every machine.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from msal_cli.arrays import Longs
from msal_cli.codecs.cells import Cells
from msal_cli.codecs.layout import Layout
from msal_cli.codecs.slots import UnitSlots
from msal_cli.codecs.vtk_stream import Stream
from msal_cli.errors import EXPORT_AGAIN, FormatError, InputError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_HEADER = re.compile(
    rb"# vtk DataFile Version[ \t]+(\d+)\.(\d+)[^\r\n]*\r?\n([^\r\n]*)\r?\n"
    rb"\s*(ASCII|BINARY)[ \t]*\r?\n",
    re.IGNORECASE,
)
_POINTS = ("POLYDATA", "UNSTRUCTURED_GRID", "STRUCTURED_GRID")
_CELLS = {
    "VERTICES": "vertex",
    "LINES": "line",
    "POLYGONS": "polygon",
    "TRIANGLE_STRIPS": "strip",
}
_PER_TUPLE = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6}


@dataclass(eq=False)
class _Parsed:
    """What a file holds, ``cells`` being those whose types are not read yet."""

    points: UnitSlots | None = None
    surface: Cells = field(default_factory=Cells)
    cells: tuple[Longs, Longs] | None = None
    normals: UnitSlots | None = None
    properties: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)


def parse(data: Buffer) -> Layout:
    """Read a VTK file; UnsupportedError for data without points of their own, and curved cells."""
    header = _HEADER.match(data)
    if not header:
        raise FormatError(
            "the file does not begin with '# vtk DataFile', a title and ASCII or BINARY",
            where="line 1",
            hint=EXPORT_AGAIN,
        )
    is_text = header[4].upper() == b"ASCII"
    stream = Stream(data, header.end(), is_text=is_text)
    words = stream.line()
    kind = words[1].upper() if len(words) > 1 and words[0].upper() == "DATASET" else ""
    if not kind:
        raise FormatError("no DATASET is named", where=stream.where(), hint=EXPORT_AGAIN)
    if kind not in _POINTS:
        raise UnsupportedError(
            f"the data set {kind} has no surface of points",
            hint="extract the surface in the program that wrote it",
        )
    parsed = _Parsed()
    dimensions: list[int] = []
    while words := stream.line():
        keyword = words[0].upper()
        if keyword == "DIMENSIONS":
            dimensions = [stream.count_of(words, k, "points") for k in (1, 2, 3)]
        elif keyword in ("POINT_DATA", "CELL_DATA"):
            stream.back()
            _read_attributes(stream, parsed)
            break
        else:
            _read_section(stream, words, parsed)
    if parsed.points is None:
        raise FormatError("the file has no POINTS", where=stream.where(), hint=EXPORT_AGAIN)
    if kind == "STRUCTURED_GRID":
        parsed.surface.add_layer(dimensions, len(parsed.points.values))
    elif parsed.cells is not None:
        raise FormatError("the file has no CELL_TYPES", where=stream.where(), hint=EXPORT_AGAIN)
    normals = parsed.normals
    has_normals = normals is not None and len(normals.values) == len(parsed.points.values)
    return parsed.surface.content(
        parsed.points,
        stream.precision,
        encoding="ascii" if is_text else "binary_big_endian",
        normals=(normals,) if normals is not None and has_normals else (),
        properties=tuple(parsed.properties),
        warnings=tuple(parsed.warnings),
    )


def _read_section(stream: Stream, words: list[str], parsed: _Parsed) -> None:
    """Read a section in front of the attributes; ``words`` are those of its first line."""
    keyword = words[0].upper()
    if keyword == "POINTS":
        n_points = stream.count_of(words, 1, "points")
        parsed.points = stream.positions(n_points, stream.word_of(words, 2))
    elif keyword in _CELLS:
        parsed.surface.add(_CELLS[keyword], *stream.cells(words))
    elif keyword == "CELLS":
        parsed.cells = stream.cells(words)
    elif keyword == "CELL_TYPES":
        if parsed.cells is None:
            raise FormatError("CELL_TYPES without CELLS", where=stream.where(), hint=EXPORT_AGAIN)
        types = stream.integers(stream.count_of(words, 1, "cells"), "int")
        parsed.surface.add_types(types, *parsed.cells)
        parsed.cells = None
    elif keyword == "METADATA":
        stream.skip_paragraph()
    elif keyword == "FIELD":
        _read_field(stream, words, "", parsed)
    elif keyword.endswith("_COORDINATES") or keyword in ("SPACING", "ORIGIN"):
        raise UnsupportedError(f"{words[0]} in a data set of points", where=stream.where())
    else:
        raise FormatError(
            f"{words[0][:40]!r} is no section of a VTK file",
            where=stream.where(),
            hint=EXPORT_AGAIN,
        )


def _read_attributes(stream: Stream, parsed: _Parsed) -> None:
    """Look for normals of points among the attributes; what is not understood is left alone."""
    owner, n_tuples = "", 0
    try:
        while words := stream.line():
            keyword = words[0].upper()
            if keyword in ("POINT_DATA", "CELL_DATA"):
                owner = keyword[: -len("_DATA")].lower()
                n_tuples = stream.count_of(words, 1, "tuples")
            elif keyword == "METADATA":
                stream.skip_paragraph()
            elif keyword == "FIELD":
                _read_field(stream, words, owner, parsed, n_tuples)
            else:
                _read_attribute(stream, words, owner, n_tuples, parsed)
    except InputError as failure:
        parsed.warnings.append(
            f"attributes from {failure.where or 'the first'} on were not understood ({failure}); "
            "they are kept as they are"
        )


def _read_attribute(
    stream: Stream, words: list[str], owner: str, n_tuples: int, parsed: _Parsed
) -> None:
    keyword = words[0].upper()
    name = stream.word_of(words, 1)
    if keyword == "SCALARS":
        width = int(words[3]) if len(words) > 3 and words[3].isdigit() else 1
        table = stream.line()
        if not table or table[0].upper() != "LOOKUP_TABLE":
            stream.back()
        stream.skip(n_tuples * width, stream.word_of(words, 2))
    elif keyword == "COLOR_SCALARS":
        width = stream.count_of(words, 2, "colours")
        stream.skip(n_tuples * width, "unsigned_char")
    elif keyword == "LOOKUP_TABLE":
        stream.skip(4 * stream.count_of(words, 2, "colours"), "unsigned_char")
    elif keyword == "NORMALS" and owner == "point":
        parsed.normals = stream.normals(n_tuples, stream.word_of(words, 2))
    elif keyword in _PER_TUPLE:
        stream.skip(n_tuples * _PER_TUPLE[keyword], stream.word_of(words, 2))
    elif keyword == "TEXTURE_COORDINATES":
        stream.skip(n_tuples * stream.count_of(words, 2, "numbers"), stream.word_of(words, 3))
    elif keyword in ("GLOBAL_IDS", "PEDIGREE_IDS", "EDGE_FLAGS"):
        stream.skip(n_tuples, stream.word_of(words, 2))
    else:
        raise FormatError(f"{words[0][:40]!r} is no attribute", where=stream.where())
    if keyword == "NORMALS" and owner == "cell":
        parsed.warnings.append("normals of cells are kept as they are")
    parsed.properties.append(f"{owner}.{name}")


def _read_field(
    stream: Stream, words: list[str], owner: str, parsed: _Parsed, n_points: int = -1
) -> None:
    """Read the arrays of a FIELD; one of normals of the points is replaced."""
    for _ in range(stream.count_of(words, 2, "arrays")):
        header = stream.line()
        if header and header[0].upper() == "METADATA":
            stream.skip_paragraph()
            header = stream.line()
        width, n_tuples = (stream.count_of(header, k, "numbers") for k in (1, 2))
        name, kind = stream.word_of(header, 0), stream.word_of(header, 3)
        is_normals = owner == "point" and width == 3 and name.lower() == "normals"
        if is_normals and n_tuples == n_points and parsed.normals is None:
            parsed.normals = stream.normals(n_tuples, kind)
        else:
            stream.skip(width * n_tuples, kind)
        parsed.properties.append(f"{owner}.{name}" if owner else f"field {name}")
