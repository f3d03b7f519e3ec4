"""Ascii PLY files: converted in one pass, and rewritten in blocks of lines."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from msal_cli.arrays import Bytes, Floats
from msal_cli.codecs.layout import Layout, Parse, require_finite
from msal_cli.codecs.ply_ascii import (
    ALL_DIGITS,
    MOST_UNUSUAL,
    Before,
    Lines,
    find_lines,
    plain_lines,
)
from msal_cli.codecs.ply_description import (
    check_strays,
    has_normals,
    properties_of,
    scalar_property,
    vertex_element,
    wanted_names,
    warn_of_rest,
    warnings_of,
)
from msal_cli.codecs.ply_faces import (
    CORNERS,
    corner_list,
    no_faces,
    warn_of_few,
    warn_of_two_lists,
)
from msal_cli.codecs.ply_header import MOST_BYTES, NORMAL, POSITION, Element, Header, parsed
from msal_cli.codecs.slots import TextSlots
from msal_cli.codecs.streamed.byte_ranges import read_range
from msal_cli.codecs.streamed.limits import require_countable
from msal_cli.codecs.streamed.line_blocks import LineBlocks
from msal_cli.codecs.streamed.ply import refuse_others
from msal_cli.codecs.streamed.ply_ids import cut_polygons
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
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.gzip_streams import OnBytes


def convert(
    path: str, text: str, size: int, folder: Path, on_bytes: OnBytes | None = None
) -> TextFacts:
    """Read an ascii PLY of ``size`` bytes, ``text``, once, and write its numbers into a folder.

    Raises
    ------
    UnsupportedError
        for what cannot be read in pieces.
    FormatError, TruncatedError, ContentError, TooLargeError
        as ``codecs.ply.read``, with the place.
    """
    with ArrayFiles(folder) as files:
        return _Conversion(path, text, size, files, on_bytes).run()


class _Conversion:
    """One pass over the text."""

    def __init__(
        self, path: str, text: str, size: int, files: ArrayFiles, on_bytes: OnBytes | None
    ) -> None:
        self.path, self.text, self.size, self.files = path, text, size, files
        self.header = read_header(text, size)
        self.vertex = vertex_element(self.header)
        refuse_others(self.header)
        require_countable(self.vertex.count, "vertices")
        face = self.face = self.header.find("face")
        self.corners = corner_list(face) if face is not None else ""
        if face is None or not self.corners or not face.count:
            raise no_faces(face, self.vertex.count)
        self.has_normals = has_normals(self.vertex)
        ending = self.header.newline[-1:]
        count_lines = functools.partial(_count, ending)
        self.lines = LineBlocks(text, size, self.header.size, count_lines, on_bytes)
        self.blocks: list[list[int]] = []
        self.face_marks: list[list[int]] = []
        self.n_triangles = self.n_few = 0
        self.positions, self.normals = DecimalCounts(), DecimalCounts()
        self.is_plain = True
        self.n_unusual = 0
        # Whether positions, and normals, are statements where all is plain.
        self.are_statements = [False, False]

    def run(self) -> TextFacts:
        for element in self.header.elements:
            for section in self._sections(element):
                if element is self.vertex:
                    self._add_vertices(section)
                elif element is self.face:
                    self._add_faces(section)
        n_behind = self._count_behind()
        check_strays(self.header, n_behind)
        if not self.n_triangles:
            raise no_faces(self.face, self.vertex.count)
        if self.n_unusual > MOST_UNUSUAL:
            self.is_plain = False
        if not self.is_plain:
            self._count_tokens()
        return self._facts(n_behind)

    def _facts(self, n_behind: int) -> TextFacts:
        face = self.face
        assert face is not None
        has_both = all(face.find(one) for one in CORNERS)
        codes = [one.code for one in self.vertex.find_all(POSITION)]
        is_whole = any(code[0] in "iu" for code in codes)
        are_statements = [one and self.is_plain for one in self.are_statements]
        positions = self.positions.choose(unit_length=False, significant=ALL_DIGITS)
        normals = None
        if self.has_normals:
            decimals = self.normals.choose(unit_length=True, significant=ALL_DIGITS)
            normals = ArrayFacts(decimals, are_statements[1], whole_rows=True)
        return TextFacts(
            source=identify(self.path),
            text=self.text,
            format="ply",
            size=self.size,
            n_vertices=self.vertex.count,
            n_polygons=face.count,
            n_triangles=self.n_triangles,
            properties=properties_of(self.header),
            references=self.header.textures,
            warnings=(
                *warnings_of(self.header, self.vertex),
                *((warn_of_two_lists(self.corners),) * has_both),
                *((warn_of_few(self.n_few),) if self.n_few else ()),
                *((warn_of_rest(n_behind),) if n_behind else ()),
            ),
            blocks=self.blocks,
            face_marks=self.face_marks,
            positions=ArrayFacts(positions, are_statements[0] and not is_whole, whole_rows=False),
            normals=normals,
            # Positions and normals of a vertex are in one line.
            n_turns=2 * self.vertex.count,
            details={"is_plain": self.is_plain},
        )

    def _sections(self, element: Element) -> Iterator[Lines]:
        """The lines of an element, a block at a time."""
        from msal_cli.kernels.ply_scan import count_lines

        remaining = element.count if element.properties else 0
        while remaining:
            data = as_bytes(self.lines.peek())
            n_lines = int(count_lines(data))
            if not n_lines and not self.lines.is_last:
                self.lines.take(len(data))
                continue
            # Behind the last line of the file, those that are missing are reported.
            count = min(remaining, n_lines) if not self.lines.is_last else remaining
            part = dataclasses.replace(element, count=count)
            before = Before(element.count - remaining, self.lines.lines)
            section = self._read_lines(data, part, before)
            yield section
            self.lines.take(section.stop)
            remaining -= count

    def _read_lines(self, data: Bytes, part: Element, before: Before) -> Lines:
        wanted = wanted_names(part)
        section = plain_lines(data, _bare(self.header), part, 0, wanted, before)
        if section is None:
            if part.name == "vertex":
                self.is_plain = False
            section = find_lines(data, _bare(self.header), part, 0, wanted, before=before)
        return section

    def _add_vertices(self, section: Lines) -> None:
        first = section.before.records
        if section.read is not None:
            self.n_unusual += section.read.n_unusual
        positions = section.slots(POSITION)
        require_finite(positions.values, lambda vertex: section.where(vertex - first), first)
        self.positions.add(positions.used_decimals(), positions.values)
        self.files.append(VERTICES, positions.values)
        self.are_statements[0] = isinstance(positions, Statements)
        if self.has_normals:
            normals = section.slots(NORMAL)
            self.normals.add_decimals(normals.used_decimals())
            self.files.append(NORMALS, normals.values)
            self.are_statements[1] = isinstance(normals, Statements)
        start = self.lines.at
        count = section.element.count
        self.blocks.append([start, start + section.stop, first, count, first, count])

    def _add_faces(self, section: Lines) -> None:
        self.face_marks.append([section.before.records, self.n_triangles])
        triangles = cut_polygons(section, self.corners, self.vertex.count)
        lengths = section.items(self.corners)[1]
        self.n_few += int(np.count_nonzero(lengths < 3))
        self.n_triangles += len(triangles)
        self.files.append(TRIANGLES, triangles)

    def _count_behind(self) -> int:
        """Bytes behind the last element, without blanks around them."""
        first = last = -1
        while len(data := self.lines.peek()):
            text = data.tobytes()
            begin = len(text) - len(text.lstrip())
            if begin < len(text):
                first = self.lines.at + begin if first < 0 else first
                last = self.lines.at + len(text.rstrip())
            self.lines.take(len(data))
        return last - first

    def _count_tokens(self) -> None:
        """Count decimals number by number: some numbers are not plain, and then the codec for
        whole files looks at tokens and not at lines."""
        low, high = self.positions.low, self.positions.high
        self.positions, self.normals = DecimalCounts(), DecimalCounts()
        self.positions.low, self.positions.high = low, high
        for start, stop, _, count, *_ in self.blocks:
            data = read_range(self.text, start, stop)
            section = read_block(data, self.header, self.vertex, count, wanted_names(self.vertex))
            self.positions.add_decimals(section.slots(POSITION).used_decimals())
            if self.has_normals:
                self.normals.add_decimals(section.slots(NORMAL).used_decimals())


class StreamedPlyText(StreamedText):
    """A converted ascii PLY; see ``codecs.streamed_mesh.StreamedMesh``."""

    def __init__(self, folder: Path, facts: TextFacts) -> None:
        super().__init__(folder, facts)
        self.header = read_header(self.path, self.size)
        self.vertex = vertex_element(self.header)

    def read_property(self, name: str, start: int, stop: int) -> Floats:
        """See ``StreamedMesh``."""
        scalar_property(self.vertex, name)
        parts = []
        for first_byte, end, first, count, *_ in self.facts.blocks:
            if first < stop and first + count > start:
                data = read_range(self.path, first_byte, end)
                section = read_block(data, self.header, self.vertex, count, (name,))
                values = section.slots((name,)).values[:, 0]
                parts.append(values[max(start - first, 0) : stop - first])
        return np.concatenate(parts) if parts else np.empty(0)

    def _parser(self, block: list[int]) -> Parse:
        return functools.partial(self._parse_block, block[3])

    def _parse_block(self, count: int, data: Buffer) -> Layout:
        wanted = wanted_names(self.vertex)
        is_plain = self.facts.details["is_plain"]
        section = read_block(as_bytes(data), self.header, self.vertex, count, wanted, is_plain)
        normals: tuple[TextSlots, ...] = ()
        if self.has_normals:
            normals = (section.slots(NORMAL),)
        return Layout("ascii", "text", (section.slots(POSITION),), normals=normals)


def read_header(text: str, size: int) -> Header:
    """The header of a PLY file of ``size`` bytes."""
    head = read_range(text, 0, min(size, MOST_BYTES))
    return parsed(memoryview(head.tobytes()), len(head) == size)


def read_block(
    data: Bytes,
    header: Header,
    vertex: Element,
    count: int,
    wanted: Sequence[str],
    is_plain: bool = False,
) -> Lines:
    """``count`` lines of vertices; ``is_plain`` is known of all lines of the file."""
    part = dataclasses.replace(vertex, count=count)
    section = plain_lines(data, _bare(header), part, 0, wanted) if is_plain else None
    return section or find_lines(data, _bare(header), part, 0, wanted)


def _count(ending: bytes, text: bytes) -> int:
    return text.count(ending)


def _bare(header: Header) -> Header:
    """The header of data that it does not stand in."""
    return dataclasses.replace(header, size=0)
