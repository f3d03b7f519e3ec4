"""OFF files: positions and normals replaced inside the original bytes.

Supported are ``OFF`` and its variants with colours, normals and texture coordinates (``COFF``,
``NOFF``, ``STOFF`` and their combinations, also ``NCOFF`` of MeshLab), comments and blank lines
anywhere, counts on the line of ``OFF`` or below, with or without the number of edges.  Where
readers differ:

- the word ``OFF`` may be missing before a line of three counts;
- a line is a vertex or a face, as all known programs write them;
- numbers after a position that the header does not announce are kept, with a warning;
- faces of one or two corners are kept but not part of the mesh, with a warning.
"""

import re

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.mesh_file import Layout
from msal_cli.codecs.slots import number_within
from msal_cli.codecs.text_slots import TextSlots, Words, has_comments, require_indices
from msal_cli.errors import (
    FormatError,
    TruncatedError,
    UnsupportedError,
    damaged,
    format_count,
    other_format,
)
from msal_cli.storage.regular import Buffer

_HEADER = re.compile(
    rb"(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*+)*+(?:((?:ST)?C?N?|NC?(?:ST)?)(4?n?)OFF(?=\d|\b)"
    rb"(?:[ \t]+(BINARY))?|(?=\d+[ \t]+\d+[ \t]+\d+[ \t]*[\r\n]))"
)


def parse(data: Buffer) -> Layout:
    """Read an OFF file; UnsupportedError for a binary one, or another number of dimensions."""
    header = _HEADER.match(data)
    if not header:
        raise other_format("the file does not begin with OFF", "line 1", "off")
    kinds, dimension, binary = header.groups(b"")
    has_texture, has_colours, has_normals = (kind in kinds for kind in (b"ST", b"C", b"N"))
    if dimension:
        kind = (dimension + b"OFF").decode()
        hint = "write it as OFF, with x, y and z for each vertex"
        raise UnsupportedError(f"{kind} files are not read", hint=hint)
    if binary:
        raise UnsupportedError("binary OFF is not read")
    words = Words(data, header.end(), comment=b"#")
    n_vertices, n_faces = words.count(0, "vertices"), words.count(1, "faces")
    # Counts may be on one line or on several, and the third may be missing.
    is_vertex = len(words) > 3 and words.lines[1] < words.lines[2] == words.lines[3]
    n_counts = 2 if is_vertex else min(3, len(words))
    at, lengths, n_trailing = _find_lines(words, n_counts, n_vertices, n_faces)
    first, at = at[n_vertices:], at[:n_vertices]
    n_extra = int(lengths[:n_vertices].min()) - 3 if n_vertices else 0
    if n_extra < 0:
        short = int(at[int(np.argmin(lengths[:n_vertices]))])
        hint = "a vertex has x, y and z; add a 0 to points of the plane, or export it again"
        where = words.where(short)
        raise FormatError("a vertex has fewer than three numbers", where=where, hint=hint)
    n_announced = 3 * has_normals + 2 * has_texture + 4 * has_colours
    if n_trailing and n_extra < n_announced - has_colours:
        raise FormatError(
            "the numbers that the header announces are not on the lines of their vertices",
            where=words.where(int(at[0])),
            hint="convert it to PLY",
        )
    sizes = words.integers(first)
    wrong = (sizes < 0) | (lengths[n_vertices:] < sizes + 1)
    if wrong.any():
        where = words.where(int(first[int(np.argmax(wrong))]))
        raise damaged("a face has fewer corners than it says", where)
    named = np.repeat(first + 1, sizes) + number_within(sizes)
    corners = words.integers(named)
    require_indices(corners, n_vertices, lambda corner: words.where(int(named[corner])))
    positions = words.float_rows(at, TextSlots)
    normals: tuple[TextSlots, ...] = ()
    if has_normals:
        # MeshLab writes NCOFF, and colours of four numbers first; all others CNOFF, normals first.
        first_normal = 7 if kinds.startswith(b"NC") else 3
        if n_extra < first_normal:
            raise damaged("a NOFF file without normals")
        normals = (words.float_rows(at + first_normal, TextSlots, unit_length=True),)
    is_there = {
        "point.normals": has_normals,
        "vertex colours": has_colours,
        "texture coordinates": has_texture,
        "comments": has_comments(data),
        "face colours": bool((lengths[n_vertices:] > sizes + 1).any()),
    }
    is_face = sizes >= 3
    n_small = int(np.count_nonzero(~is_face))
    small = f"{format_count(n_small, 'face')} of fewer than three corners"
    warnings = {
        f"{format_count(n_trailing, 'line')} behind the last face, kept": n_trailing,
        f"{format_count(n_extra - n_announced, 'number')} behind each position, kept": (
            n_extra > n_announced or (n_extra and not n_announced)
        ),
        f"{small}, kept and left out": n_small,
    }
    return Layout(
        "ascii",
        "text",
        (positions,),
        corners[np.repeat(is_face, sizes)],
        sizes[is_face],
        normals,
        properties=tuple(word for word, has_it in is_there.items() if has_it),
        warnings=tuple(warning for warning, is_true in warnings.items() if is_true),
        held=small if n_small else "",
    )


def _find_lines(
    words: Words, start: int, n_vertices: int, n_faces: int
) -> tuple[Longs, Longs, int]:
    """The first word of each vertex and face from word ``start`` on, the number of its words, and
    the number of lines after them."""
    lines = np.flatnonzero(np.diff(words.lines, prepend=-1))
    lines = lines[lines >= start]
    if len(words) > start and (not len(lines) or lines[0] != start):
        raise FormatError("the first vertex stands on the line of the counts", where=words.where(0))
    count = n_vertices + n_faces
    if len(lines) < count:
        raise TruncatedError(
            f"the file has {len(lines):,} lines for {n_vertices:,} vertices and {n_faces:,} faces",
            where=words.where(len(words)),
            hint="it was cut short, or has several vertices or faces on a line: convert it to PLY",
        )
    lengths = np.diff(lines, append=len(words))
    return lines[:count], lengths[:count], len(lines) - count
