"""OFF files: positions and normals replaced inside the original bytes.

Read are ``OFF`` and its variants with colours, normals and texture coordinates (``COFF``,
``NOFF``, ``STOFF`` and their combinations, also ``NCOFF`` of MeshLab), comments and blank lines
anywhere, counts on the line of ``OFF`` or below, with or without the number of edges.  Where
readers differ:

- a line is a vertex or a face, as nearly all programs write them; a file in which that does not
  come out is read word by word, as Geomview does;
- numbers behind a position that its header does not announce are kept, with a warning;
- faces of one or two corners are kept and left out of the mesh, with a warning.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs.mesh_file import Layout
from msal_cli.codecs.slots import number_within
from msal_cli.codecs.text_slots import TextSlots
from msal_cli.codecs.tokens import Words, require_indices
from msal_cli.errors import EXPORT_AGAIN, ContentError, FormatError, InputError, UnsupportedError
from msal_cli.storage.regular import Buffer

_HEADER = re.compile(
    rb"(?:\xef\xbb\xbf)?(?:\s|#[^\r\n]*+)*+((?:ST)?C?N?|NC?(?:ST)?)(4?n?)OFF(?=\d|\b)"
    rb"(?:[ \t]+(BINARY))?"
)
_CONVERT = "convert it to PLY"


def parse(data: Buffer) -> Layout:
    """Read an OFF file; UnsupportedError for a binary one, or another number of dimensions."""
    header = _HEADER.match(data)
    if not header:
        raise FormatError("the file does not begin with OFF", where="line 1", hint=_CONVERT)
    kinds, dimension, binary = header.groups()
    has_texture, has_colours, has_normals = (kind in kinds for kind in (b"ST", b"C", b"N"))
    if dimension:
        kind = (dimension + b"OFF").decode()
        raise UnsupportedError(f"{kind} files are not read", hint=_CONVERT)
    if binary:
        raise UnsupportedError("binary OFF is not read", hint=_CONVERT)
    words = Words(data, header.end(), comment=b"#")
    n_vertices, n_faces = words.count(0, "vertices"), words.count(1, "faces")
    # Counts may stand on one line or on several.
    n_counts = min(3, int(np.searchsorted(words.lines, words.lines[1], side="right")))
    width = 3 + 3 * has_normals + 2 * has_texture + 4 * has_colours
    warnings = []
    try:
        parsed = _by_lines(words, n_counts, n_vertices, n_faces)
        if parsed.n_behind:
            try:
                parsed = _by_words(words, n_counts, n_vertices, n_faces, width)
            except InputError:
                warnings.append(f"{parsed.n_behind} lines behind the last face are kept")
    except InputError as by_lines:
        try:
            parsed = _by_words(words, n_counts, n_vertices, n_faces, width)
        except InputError:
            raise by_lines from None
    at, corners, sizes, extra = parsed.at, parsed.corners, parsed.sizes, parsed.n_extra
    positions = words.float_rows(at)
    normals: tuple[TextSlots, ...] = ()
    if has_normals:
        # MeshLab writes NCOFF, and colours of four numbers first; all others CNOFF, normals first.
        first_normal = 7 if kinds.startswith(b"NC") else 3
        if extra < first_normal:
            raise FormatError("a NOFF file without normals", hint=EXPORT_AGAIN)
        normals = (words.float_rows(at + first_normal, unit_length=True),)
    announced = width - 3
    properties = [
        word
        for word, is_there in (
            ("point.normals", has_normals),
            ("vertex colours", has_colours),
            ("texture coordinates", has_texture),
            ("face colours", parsed.has_face_colours),
        )
        if is_there
    ]
    if extra > announced or (extra and not announced):
        warnings.append(f"{extra - announced} numbers behind each position are kept as they are")
    is_face = sizes >= 3
    if not is_face.all():
        warnings.append(
            f"{np.count_nonzero(~is_face)} faces of fewer than three corners are kept and left out"
        )
        corners = corners[np.repeat(is_face, sizes)]
    return Layout(
        "ascii",
        "text",
        (positions,),
        corners,
        sizes[is_face],
        normals,
        properties=tuple(properties),
        warnings=tuple(warnings),
        held=f"{n_vertices} vertices and {n_faces} faces",
    )


@dataclass(frozen=True, eq=False)
class _Parsed:
    """First words of vertices (n,), corners (c,), sizes (p,), whether faces have colours, how many
    words stand behind each position, and how many lines behind the last face."""

    at: Longs
    corners: Longs
    sizes: Longs
    has_face_colours: bool
    n_extra: int
    n_behind: int = 0


def _by_lines(words: Words, start: int, n_vertices: int, n_faces: int) -> _Parsed:
    lines = words.first_of_lines()
    lines = lines[lines >= start]
    if len(words) > start and (not len(lines) or lines[0] != start):
        raise FormatError("the first vertex stands on the line of the counts", where=words.where(0))
    ends = np.append(lines[1:], len(words))
    if len(lines) < n_vertices + n_faces:
        words.require(len(words) + 1, f"{n_vertices} vertices and {n_faces} faces")
    lengths = ends - lines
    vertices, faces = slice(0, n_vertices), slice(n_vertices, n_vertices + n_faces)
    short = lengths[vertices] < 3
    if short.any():
        at = int(lines[int(np.argmax(short))])
        raise FormatError("a vertex has fewer than three numbers", where=words.where(at))
    first = lines[faces]
    sizes = words.integers(first)
    _require_sizes(sizes, words, first)
    short = lengths[faces] < sizes + 1
    if short.any():
        at = int(first[int(np.argmax(short))])
        raise FormatError(
            "a face has fewer corners than it says", where=words.where(at), hint=EXPORT_AGAIN
        )
    corners = _corners(words, first, sizes, n_vertices)
    extra = int(lengths[vertices].min()) - 3 if n_vertices else 0
    has_face_colours = bool((lengths[faces] > sizes + 1).any())
    n_behind = len(lines) - n_vertices - n_faces
    return _Parsed(lines[vertices], corners, sizes, has_face_colours, extra, n_behind)


def _by_words(words: Words, start: int, n_vertices: int, n_faces: int, width: int) -> _Parsed:
    """Words one behind the other; what stands on a line behind a face is its colour."""
    words.require(start + n_vertices * width, f"{n_vertices} vertices")
    at = start + np.arange(n_vertices, dtype=np.int64) * width
    first_of_faces = next_word = start + n_vertices * width
    words.require(next_word + n_faces, f"{n_faces} faces")
    numbers = words.integers(slice(next_word, None))
    sizes_or_corners = numbers.tolist()
    first = np.empty(n_faces, dtype=np.int64)
    for k in range(n_faces):
        words.require(next_word + 1, f"{n_faces} faces")
        first[k] = next_word
        next_word += 1 + max(sizes_or_corners[next_word - first_of_faces], 0)
    words.require(next_word, f"{n_faces} faces")
    sizes = numbers[first - first_of_faces]
    _require_sizes(sizes, words, first)
    if next_word < len(words):
        raise FormatError("more numbers than the header counts follow", hint=EXPORT_AGAIN)
    return _Parsed(at, _corners(words, first, sizes, n_vertices), sizes, False, width - 3)


def _require_sizes(sizes: Longs, words: Words, first: Longs) -> None:
    if (sizes < 0).any():
        at = int(first[int(np.argmax(sizes < 0))])
        raise ContentError(
            "a face has a negative number of corners", where=words.where(at), hint=EXPORT_AGAIN
        )


def _corners(words: Words, first: Longs, sizes: Longs, n_vertices: int) -> Longs:
    """The corners (c,) of faces whose numbers of corners are these words."""
    corners = words.integers(np.repeat(first + 1, sizes) + number_within(sizes))
    require_indices(corners, n_vertices)
    return corners
