"""Ascii STL files: converted in one pass, and rewritten in blocks of facets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Longs
from msal_cli.codecs.detection import BYTE_ORDER_MARK
from msal_cli.codecs.layout import Parse
from msal_cli.codecs.stl_ascii import (
    StlTextFile,
    choose_decimals,
    count_bad,
    list_properties,
    list_warnings,
)
from msal_cli.codecs.stl_facets import check_not_empty
from msal_cli.codecs.stl_numbers import (
    Facets,
    Scan,
    decide_numbers,
    read_numbers,
    scan_error,
    scan_facets,
    without_end_mark,
)
from msal_cli.codecs.streamed.byte_ranges import read_range, split_range
from msal_cli.codecs.streamed.limits import require_countable
from msal_cli.codecs.streamed.line_blocks import LineBlocks
from msal_cli.codecs.streamed.text_facts import (
    VERTICES,
    ArrayFacts,
    ArrayFiles,
    TextFacts,
    identify,
)
from msal_cli.codecs.streamed.text_mesh import StreamedText
from msal_cli.codecs.streamed_mesh import FaceChunk, NewNormals, NewPositions, Survey
from msal_cli.errors import InternalError
from msal_cli.kernels import stl_scan
from msal_cli.kernels.digit_writing import FIXED_BELOW
from msal_cli.kernels.text import as_bytes
from msal_cli.storage.buffers import Buffer
from msal_cli.storage.gzip_streams import OnBytes

_AT_ONCE = 1 << 18


def convert(
    path: str, text: str, size: int, folder: Path, on_bytes: OnBytes | None = None
) -> TextFacts:
    """Read an ascii STL of ``size`` bytes, ``text``, once, and write its corners into a folder.

    Raises
    ------
    FormatError, TruncatedError, ContentError, TooLargeError
        as ``codecs.stl_ascii.read``, with the facet and the line.
    """
    with ArrayFiles(folder) as files:
        return _Conversion(path, text, size, files, on_bytes).run()


class _Conversion:
    """One pass over the text; counts of all blocks so far."""

    def __init__(
        self, path: str, text: str, size: int, files: ArrayFiles, on_bytes: OnBytes | None
    ) -> None:
        self.path, self.text, self.size, self.files = path, text, size, files
        self.lines = LineBlocks(text, size, 0, _count_lines, on_bytes)
        self.is_inside = False
        self.n_facets = self.n_bare = self.n_bad = self.n_solids = 0
        self.names: list[str] = []
        self.decimals = np.zeros(4, dtype=np.int64)
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)
        self.blocks: list[list[int]] = []

    def run(self) -> TextFacts:
        """Read all blocks."""
        for data, facets, stop in self._parts():
            self._add(data, facets, stop)
        check_not_empty(self.n_facets)
        trailing = self.size - self.lines.at
        has_normals = self.n_bare != self.n_facets
        normal, corner = choose_decimals(self.decimals, self.low, self.high)
        return TextFacts(
            source=identify(self.path),
            text=self.text,
            format="stl",
            size=self.size,
            n_vertices=3 * self.n_facets,
            n_polygons=self.n_facets,
            n_triangles=self.n_facets,
            properties=list_properties(has_normals, self.n_solids, self.names),
            references=(),
            warnings=list_warnings(self.n_bare, self.n_bad - self.n_bare, trailing),
            blocks=self.blocks,
            face_marks=[],
            positions=ArrayFacts(corner, is_statements=False, whole_rows=False),
            normals=None,
            n_turns=0,
            details={"normal_decimals": normal},
        )

    def _parts(self) -> Iterator[tuple[Bytes, Facets, int]]:
        """Blocks with their whole facets, and how many bytes of each these end behind."""
        data = self.lines.peek()
        while len(data):
            is_last = self.lines.is_last
            buf = as_bytes(without_end_mark(data) if is_last else data)
            state = np.zeros(stl_scan.N_STATE, dtype=np.int64)
            state[stl_scan.INSIDE] = self.is_inside
            if not self.lines.at and bytes(buf[:3]) == BYTE_ORDER_MARK:
                state[stl_scan.AT] = len(BYTE_ORDER_MARK)
            facets = scan_facets(buf, state, self.decimals)
            status, at, word = facets.status
            stop = int(state[stl_scan.AT])
            if status != stl_scan.WHOLE and (is_last or not _is_cut(facets, buf)):
                facet = self.n_facets + len(facets.facet_at)
                raise scan_error(buf, status, at, word, facet, self.lines.lines)
            if not stop and not is_last:
                # One facet is longer than a block.
                data = self.lines.peek_more()
                continue
            yield buf, facets, stop
            self._carry_on(state, facets)
            self.lines.take(stop)
            if is_last:
                return
            data = self.lines.peek()

    def _carry_on(self, state: Longs, facets: Facets) -> None:
        self.is_inside = bool(state[stl_scan.INSIDE])
        self.n_facets += len(facets.facet_at)
        room = stl_scan.MOST_SOLIDS - len(self.names)
        self.names += facets.names[:room]
        self.n_solids += int(state[stl_scan.SOLIDS])

    def _add(self, data: Bytes, facets: Facets, stop: int) -> None:
        """Write the corners of a block's facets."""
        n = len(facets.facet_at)
        require_countable(3 * (self.n_facets + n), "corners of facets")
        if not n:
            return
        offsets, numbers = facets.offsets, facets.numbers
        decide_numbers(
            data.data, facets.facet_at, offsets, numbers, self.n_facets, self.lines.lines
        )
        # The sum makes a plain zero of a negative one.
        corners = numbers[:, 3:].reshape(-1, 3) + 0.0
        self.files.append(VERTICES, corners)
        self.low = np.minimum(self.low, corners.min(axis=0))
        self.high = np.maximum(self.high, corners.max(axis=0))
        self.n_bad += count_bad(numbers[:, :3])
        # A facet without a normal has all of its numbers at one place.
        self.n_bare += int(np.count_nonzero(offsets[:, 0] == offsets[:, 1]))
        start = self.lines.at
        self.blocks.append([start, start + stop, 3 * self.n_facets, 3 * n, 0, 0])


def _is_cut(facets: Facets, buf: Bytes) -> bool:
    """Whether a block may end within a facet, and nothing else be wrong."""
    status, at, _ = facets.status
    # The last words of a facet may be written as two, of which the block has one.
    return status == stl_scan.CUT or (
        status == stl_scan.WRONG and len(buf[at:].tobytes().split()) <= 1
    )


def _count_lines(text: bytes) -> int:
    return text.count(b"\n") or text.count(b"\r")


class StreamedStlText(StreamedText):
    """A converted ascii STL; see ``codecs.streamed_mesh.StreamedMesh``.

    Vertex 3 f + k is corner k of facet f.
    """

    are_corners = True

    def face_chunks(self, most: int) -> list[FaceChunk]:
        """See ``StreamedMesh``."""
        return [
            FaceChunk((first, stop), first, (first, stop))
            for first, stop in split_range(0, self.n_polygons, most)
        ]

    def read_triangles(self, chunk: FaceChunk) -> NDArray[np.uint32]:
        """See ``StreamedMesh``; nothing is read."""
        first, stop = chunk.polygons
        return np.arange(3 * first, 3 * stop, dtype=np.uint32).reshape(-1, 3)

    def survey(self, positions: NewPositions, normals: NewNormals | None) -> Survey:
        """See ``StreamedMesh``; only what is written anew counts."""
        largest = 0.0
        is_moved = False
        for start, stop in split_range(0, self.n_vertices, _AT_ONCE):
            new = positions(start, stop)
            is_new = new != self.read_vertices(start, stop)
            is_moved = is_moved or bool(is_new.any())
            largest = max(largest, float(np.abs(new).max(where=is_new, initial=0.0)))
        return Survey(is_moved, has_new_normals=False, largest=largest)

    def replace(
        self,
        piece: tuple[int, int],
        positions: NewPositions,
        normals: NewNormals | None,
        survey: Survey | None = None,
    ) -> memoryview:
        """See ``StreamedMesh``; facets' normals are computed from the new corners."""
        if survey is None:
            raise InternalError("a text is replaced without a survey of all new numbers")
        blocks = list(self._blocks_in(piece))
        if not survey.is_moved or not blocks:
            return read_range(self.path, *piece).data
        parts: list[Any] = []
        for start, stop, first, count, *_ in blocks:
            new = positions(first, first + count)
            text = _Block(read_range(self.path, start, stop).data, self.facts, survey)
            result = text.replaced(new)
            text.check(result, new)
            parts.append(result)
        return memoryview(b"".join(parts))

    def _parser(self, block: list[int]) -> Parse:
        raise InternalError("the facets of an STL are no statements")


class _Block(StlTextFile):
    """Whole facets of a text; each has vertices of its own."""

    def __init__(self, data: Buffer, facts: TextFacts, survey: Survey) -> None:
        scan, numbers = read_numbers(data, is_part=True)
        corners = numbers[:, 3:].reshape(-1, 3) + 0.0
        faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
        super().__init__(data, scan, corners, np.ascontiguousarray(numbers[:, :3]), faces)
        self._known = facts.details["normal_decimals"], facts.positions.decimals
        self._largest = survey.largest

    def _decimals(self) -> tuple[int, int]:
        return self._known

    def _is_beyond_fixed(self, largest: float) -> bool:
        return self._largest >= FIXED_BELOW

    def _read(self, data: Buffer) -> tuple[Scan, Floats]:
        return read_numbers(data, is_part=True)
