"""OBJ files: converted in one pass, and rewritten in blocks of statements."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from msal_cli.arrays import Longs
from msal_cli.codecs import obj_description
from msal_cli.codecs.decimals import usual_of_counts
from msal_cli.codecs.layout import Layout, Parse
from msal_cli.codecs.obj import NO_LIMIT, position_decimals
from msal_cli.codecs.obj_content import Arrays, Before, cut_triangles
from msal_cli.codecs.obj_errors import line_of, no_faces_error, refuse_binary
from msal_cli.codecs.obj_parser import Reading
from msal_cli.codecs.streamed.byte_ranges import read_range
from msal_cli.codecs.streamed.line_blocks import LineBlocks
from msal_cli.codecs.streamed.text_facts import (
    NORMALS,
    TRIANGLES,
    VERTICES,
    ArrayFacts,
    ArrayFiles,
    DecimalCounts,
    TextFacts,
    identify,
)
from msal_cli.codecs.streamed.text_mesh import StreamedText
from msal_cli.codecs.text_slots import Statements
from msal_cli.errors import TooLargeError, UnsupportedError
from msal_cli.kernels import obj_scan
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.gzip_streams import OnBytes

_MOST_VERTICES = 2**31 - 1
_HINT = "convert the mesh to PLY, or run on a machine with more memory"

_ADDED = (
    obj_scan.VERTICES,
    obj_scan.NORMALS,
    obj_scan.TEXTURE,
    obj_scan.FACES,
    obj_scan.BEFORE_FIRST,
    obj_scan.SHORT,
    obj_scan.WEIGHTED,
    obj_scan.COLOURED,
)
_LARGEST = (obj_scan.LARGEST_VERTEX, obj_scan.LARGEST_TEXTURE, obj_scan.LARGEST_NORMAL)


def convert(
    path: str, text: str, size: int, folder: Path, on_bytes: OnBytes | None = None
) -> TextFacts:
    """Read an OBJ of ``size`` bytes, ``text``, once, and write its numbers into a folder.

    Raises
    ------
    UnsupportedError
        for what cannot be read in pieces: normals other than one for each vertex.
    FormatError, TruncatedError, ContentError, TooLargeError
        as ``codecs.obj.read``, with the line.
    """
    with ArrayFiles(folder) as files:
        return _Conversion(path, text, size, files, on_bytes).run()


class _Conversion:
    """One pass over the text; counts of all blocks so far."""

    def __init__(
        self, path: str, text: str, size: int, files: ArrayFiles, on_bytes: OnBytes | None
    ) -> None:
        self.path, self.text, self.size, self.files = path, text, size, files
        self.lines = LineBlocks(text, size, 0, _count_lines, on_bytes, are_continued=True)
        self.state = np.zeros(obj_scan.N_STATE, dtype=np.int64)
        self.state[obj_scan.LARGEST_VERTEX] = -1
        self.keywords: dict[bytes, tuple[int, int]] = {}
        self.libraries: dict[str, None] = {}
        self.n_libraries = 0
        # Lines of the bytes that warnings are about.
        self.line_of: dict[int, int] = {}
        self.blocks: list[list[int]] = []
        self.face_marks: list[list[int]] = []
        # Blocks with faces: where each begins and ends, what is before it, its largest vertex.
        self.largest: list[tuple[int, int, Before, int]] = []
        self.n_triangles = 0
        self.positions, self.normals = DecimalCounts(), DecimalCounts()
        self.n_turns, self.last_kind = 0, -1
        self.has_normal_corners = False
        self.odd_face = -1

    def run(self) -> TextFacts:
        """Read all blocks and check what only all of them show."""
        refuse_binary(read_range(self.text, 0, min(self.size, 1 << 16)).data)
        while len(data := self.lines.peek()):
            self._add(as_bytes(data))
            self.lines.take(len(data))
        state = self.state
        n_vertices, n_normals = int(state[obj_scan.VERTICES]), int(state[obj_scan.NORMALS])
        if not n_vertices or not state[obj_scan.FACES]:
            raise no_faces_error(n_vertices, int(state[obj_scan.SHORT]), self.keywords)
        self._require_vertices(n_vertices)
        has_normals = self._require_normals(n_vertices, n_normals)
        usual = usual_of_counts(self.positions.counts)
        decimals = position_decimals(usual, self.positions.extremes)
        normals = None
        if has_normals:
            of_normals = self.normals.choose(unit_length=True, significant=NO_LIMIT)
            normals = ArrayFacts(of_normals, is_statements=True, whole_rows=False)
        return TextFacts(
            source=identify(self.path),
            text=self.text,
            format="obj",
            size=self.size,
            n_vertices=n_vertices,
            n_polygons=int(state[obj_scan.FACES]),
            n_triangles=self.n_triangles,
            properties=obj_description.properties(state, self.keywords),
            references=tuple(name for name in self.libraries if name),
            warnings=obj_description.warnings(state, self.keywords, self.line_of.__getitem__),
            blocks=self.blocks,
            face_marks=self.face_marks,
            positions=ArrayFacts(decimals, is_statements=True, whole_rows=False),
            normals=normals,
            n_turns=self.n_turns,
        )

    @property
    def _before(self) -> Before:
        state = self.state
        n_faces = int(state[obj_scan.FACES] + state[obj_scan.SHORT])
        return Before(
            self.lines.at,
            self.lines.lines,
            int(state[obj_scan.VERTICES]),
            int(state[obj_scan.NORMALS]),
            int(state[obj_scan.TEXTURE]),
            n_faces,
        )

    def _add(self, data: Any) -> None:
        """Read a block."""
        before = self._before
        reading = Reading(data.data, data, before)
        read = reading.walk()
        if before.vertices + len(read.vertices) > _MOST_VERTICES:
            raise TooLargeError(
                f"the file has more than the {_MOST_VERTICES} vertices that an OBJ may have here",
                hint="convert the mesh to binary PLY",
            )
        reading.require_whole_face()
        reading.require_finite(read.vertices)
        self._add_numbers(read, len(data))
        self._add_faces(read, reading.state, len(data), before)
        self._add_state(reading, data)

    def _add_numbers(self, read: Arrays, n_bytes: int) -> None:
        n_vertices, n_normals = len(read.vertices), len(read.normals)
        if not n_vertices and not n_normals:
            return
        before = self._before
        start = self.lines.at
        self.blocks.append(
            [start, start + n_bytes, before.vertices, n_vertices, before.normals, n_normals]
        )
        self.positions.add(read.decimals, read.vertices)
        self.normals.add_decimals(read.normal_decimals)
        self.files.append(VERTICES, read.vertices)
        self.files.append(NORMALS, read.normals)
        kinds = np.repeat([0, 1], [n_vertices, n_normals])
        kinds = kinds[np.argsort(np.concatenate([read.vertex_at, read.normal_at]))]
        self.n_turns += int(np.count_nonzero(np.diff(kinds, prepend=self.last_kind)))
        self.last_kind = int(kinds[-1])

    def _add_faces(self, read: Arrays, state: Longs, n_bytes: int, before: Before) -> None:
        if not len(read.sizes):
            return
        start = self.lines.at
        self.largest.append((start, start + n_bytes, before, int(state[obj_scan.LARGEST_VERTEX])))
        self.face_marks.append([int(self.state[obj_scan.FACES]), self.n_triangles])
        triangles = cut_triangles(read.corners, read.sizes)
        self.n_triangles += len(triangles)
        self.files.append(TRIANGLES, triangles.view(np.uint32))
        self.has_normal_corners |= bool((read.corner_normals >= 0).any())
        if self.odd_face < 0 and not np.array_equal(read.corners, read.corner_normals):
            self.odd_face = before.faces + _first_odd_face(read)

    def _add_state(self, reading: Reading, data: Any) -> None:
        """Add the counts of a block, and find the lines of what comes first in the file."""
        block, state, at = reading.state, self.state, self.lines.at
        for count, place in (
            (obj_scan.WEIGHTED, obj_scan.WEIGHTED_AT),
            (obj_scan.SHORT, obj_scan.SHORT_AT),
        ):
            if block[count] and not state[count]:
                state[place] = at + block[place]
                self._note_line(data, int(block[place]))
        for one in _ADDED:
            state[one] += block[one]
        for one in _LARGEST:
            state[one] = max(state[one], block[one])
        for keyword, (count, first) in reading.other_keywords().items():
            if keyword not in self.keywords and len(self.keywords) < obj_scan.MOST_KEYWORDS:
                self.keywords[keyword] = 0, at + first
                self._note_line(data, first)
            # As in memory, the last one stands for all that there is no room for.
            known = keyword if keyword in self.keywords else next(reversed(self.keywords))
            total, place = self.keywords[known]
            self.keywords[known] = total + count, place
        room = obj_scan.MOST_LIBRARIES - self.n_libraries
        libraries = reading.libraries[: min(room, int(block[obj_scan.LIBRARIES]))]
        self.n_libraries += len(libraries)
        self.libraries |= dict.fromkeys(obj_description.references(data.data, libraries))

    def _note_line(self, data: Any, at: int) -> None:
        self.line_of[self.lines.at + at] = self.lines.lines + line_of(data, at)

    def _require_vertices(self, n_vertices: int) -> None:
        """Raise for a face that names a vertex which the file does not have."""
        for start, stop, before, largest in self.largest:
            if largest >= n_vertices:
                data = as_bytes(read_range(self.text, start, stop))
                reading = Reading(data.data, data, before)
                read = reading.walk()
                reading.require_vertices(read.corners, read.sizes, n_vertices)

    def _require_normals(self, n_vertices: int, n_normals: int) -> bool:
        """Whether every vertex has a normal of its own, which its corners use; raises for normals
        that are used otherwise."""
        if not n_normals or not self.has_normal_corners:
            return False
        if self.odd_face >= 0 or n_normals != n_vertices:
            raise UnsupportedError(
                "an OBJ can be rewritten in pieces only if it has no vn, or vertex and normal of "
                "each corner have the same number",
                where=f"face {self.odd_face + 1}" if self.odd_face >= 0 else "",
                hint=f"export it without normals, {_HINT}",
            )
        return True


def _first_odd_face(read: Arrays) -> int:
    """The first face whose corners and their normals have different numbers."""
    corner = int(np.argmax(read.corners != read.corner_normals))
    return int(np.searchsorted(np.cumsum(read.sizes, dtype=np.int64), corner, side="right"))


def _count_lines(text: bytes) -> int:
    return line_of(text, len(text)) - 1


class StreamedObj(StreamedText):
    """A converted OBJ file; see ``codecs.streamed_mesh.StreamedMesh``."""

    def _parser(self, block: list[int]) -> Parse:
        before = Before(block[0], vertices=block[2], normals=block[4])
        return functools.partial(self._parse_block, before)

    def _parse_block(self, before: Before, data: Buffer) -> Layout:
        buf = as_bytes(data)
        read = Reading(data, buf, before).walk()
        positions = Statements(buf, read.vertex_at, read.decimals, 1, values=read.vertices)
        normals: tuple[Statements, ...] = ()
        if self.has_normals:
            at, used = read.normal_at, read.normal_decimals
            normal = Statements(
                buf, at, used, 2, values=read.normals, unit_length=True, significant=NO_LIMIT
            )
            normals = (normal,)
        return Layout("ascii", "text", (positions,), normals=normals)
