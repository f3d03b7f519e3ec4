"""Text meshes in pieces: numbers are read from binary files, and the text is patched in blocks.

New numbers have the digits that the codec for whole files gives them.  Some of what they depend on
is a fact of the whole file, known since it was converted, and some one of all new positions.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Flags, Floats
from msal_cli.codecs.decimals import row_decimals
from msal_cli.codecs.layout import Parse
from msal_cli.codecs.slot_file import (
    Change,
    SlotFile,
    require_finite_result,
    require_shape,
    require_unit_length,
)
from msal_cli.codecs.slots import TextSlots, require_range
from msal_cli.codecs.streamed.byte_ranges import read_range, split_range
from msal_cli.codecs.streamed.text_facts import (
    NORMALS,
    TRIANGLES,
    VERTICES,
    ArrayFacts,
    TextFacts,
)
from msal_cli.codecs.streamed_mesh import FaceChunk, NewNormals, NewPositions, Survey
from msal_cli.codecs.text_slots import (
    MOST_TURNS,
    Patch,
    Statements,
    replace_statements,
    require_replaced,
)
from msal_cli.errors import InternalError, UnsupportedError
from msal_cli.storage.buffers import Buffer

_AT_ONCE = 1 << 18
"""Vertices that are compared at a time."""

_ROWS, _ALIKE, _SPLICED = "rows", "alike", "spliced"
"""New numbers have the decimals of their rows, or all the same in an array; or they take the place
of tokens one by one."""


class StreamedText:
    """A converted text mesh; see ``codecs.streamed_mesh.StreamedMesh``."""

    encoding = "ascii"
    precision = "text"
    vertex_type: type[np.float32] | type[np.float64] = np.float64
    are_corners = False
    keeps_size = False

    def __init__(self, folder: Path, facts: TextFacts) -> None:
        """The text whose numbers are in ``folder``."""
        self.folder, self.facts = folder, facts
        self.path, self.format, self.size = facts.text, facts.format, facts.size
        self.n_vertices, self.n_polygons = facts.n_vertices, facts.n_polygons
        self.properties = tuple(facts.properties)
        self.references = tuple(facts.references)
        self.warnings = tuple(facts.warnings)
        self.has_normals = facts.normals is not None

    # Reading

    def read_vertices(self, start: int, stop: int) -> NDArray[Any]:
        """See ``StreamedMesh``."""
        return self._read_rows(VERTICES, start, stop, np.float64)

    def read_normals(self, start: int, stop: int) -> Floats:
        """See ``StreamedMesh``."""
        return self._read_rows(NORMALS, start, stop, np.float64)

    def face_chunks(self, most: int) -> list[FaceChunk]:
        """See ``StreamedMesh``; chunks end where the conversion had its blocks."""
        marks = [*self.facts.face_marks, [self.n_polygons, self.facts.n_triangles]]
        chunks, (polygon, triangle) = [], marks[0]
        for (here, first), (behind, _) in zip(marks[1:], [*marks[2:], marks[-1]], strict=True):
            if behind - polygon > most or here == self.n_polygons:
                if here > polygon:
                    chunks.append(FaceChunk((polygon, here), triangle, (triangle, first)))
                polygon, triangle = here, first
        return chunks

    def read_triangles(self, chunk: FaceChunk) -> NDArray[np.uint32]:
        """See ``StreamedMesh``."""
        return self._read_rows(TRIANGLES, *chunk.place, np.uint32)

    def read_property(self, name: str, start: int, stop: int) -> Floats:
        """See ``StreamedMesh``."""
        raise UnsupportedError(
            f"vertex properties such as {name!r} are read from PLY, not from {self.format.upper()}",
            hint="give a PLY, or leave out for this file what names a property",
        )

    def _read_rows(self, name: str, start: int, stop: int, dtype: Any) -> NDArray[Any]:
        size = 3 * np.dtype(dtype).itemsize
        data = read_range(str(self.folder / name), start * size, stop * size)
        rows: NDArray[Any] = data.view(dtype).reshape(-1, 3)
        return rows

    # Writing

    def output_pieces(self, most: int) -> list[tuple[int, int]]:
        """See ``StreamedMesh``; pieces begin and end where blocks of vertices do."""
        pieces: list[tuple[int, int]] = []
        begin = end = 0
        for start, stop, *_ in self.facts.blocks:
            if start > end:
                pieces += [(begin, end)] * (end > begin)
                pieces += split_range(end, start, most)
                begin = start
            if stop - begin > most and start > begin:
                pieces.append((begin, start))
                begin = start
            end = stop
        pieces += [(begin, end)] * (end > begin)
        return [*pieces, *split_range(end, self.size, most)]

    def survey(self, positions: NewPositions, normals: NewNormals | None) -> Survey:
        """See ``StreamedMesh``."""
        is_moved = has_new_normals = False
        largest = 0.0
        for start, stop in split_range(0, self.n_vertices, _AT_ONCE):
            new = positions(start, stop)
            is_moved = is_moved or bool((new != self.read_vertices(start, stop)).any())
            largest = max(largest, float(new.max()), -float(new.min()))
            if normals is not None and self.facts.normals is not None and not has_new_normals:
                old = self.read_normals(start, stop)
                _, is_new = merge_normals(normals(start, stop), old, self.facts.normals)
                has_new_normals = bool(is_new.any())
        return Survey(is_moved, has_new_normals, largest)

    def replace(
        self,
        piece: tuple[int, int],
        positions: NewPositions,
        normals: NewNormals | None,
        survey: Survey | None = None,
    ) -> memoryview:
        """See ``StreamedMesh``."""
        if survey is None:
            raise InternalError("a text is replaced without a survey of all new numbers")
        blocks = list(self._blocks_in(piece))
        if not survey.is_moved or not blocks:
            return read_range(self.path, *piece).data
        how = self._choose_way(survey)
        parts: list[Any] = []
        for block in blocks:
            start, stop, first, count, first_normal, n_normals = block
            data = read_range(self.path, start, stop)
            new = positions(first, first + count)
            new_normals = None
            if normals is not None and self.has_normals:
                new_normals = normals(first_normal, first_normal + n_normals)
            text = TextPiece(data.data, self.format, self._parser(block))
            parts.append(self._replace_block(text, data, first, new, new_normals, how, survey))
        return memoryview(b"".join(parts))

    def _blocks_in(self, piece: tuple[int, int]) -> Iterator[list[int]]:
        starts = [block[0] for block in self.facts.blocks]
        low, high = np.searchsorted(starts, piece).tolist()
        blocks = self.facts.blocks[low:high]
        if blocks and blocks[-1][1] > piece[1]:
            raise InternalError(f"the bytes {piece[0]} to {piece[1]} are no piece of the output")
        yield from blocks

    def _choose_way(self, survey: Survey) -> str:
        """How the numbers are written; see ``codecs.slot_file``, which says the same of a whole
        file."""
        facts = self.facts
        arrays = [facts.positions]
        own = [_row_decimals(facts.positions, survey.largest) is not None]
        n_turns = 1
        if survey.has_new_normals and facts.normals is not None:
            arrays.append(facts.normals)
            own.append(_row_decimals(facts.normals, 1.0) is not None)
            n_turns = facts.n_turns
        if not all(one.is_statements for one in arrays):
            return _SPLICED
        if all(own) and n_turns <= MOST_TURNS:
            return _ROWS
        return _SPLICED if any(one.whole_rows for one in arrays) else _ALIKE

    def _replace_block(
        self,
        text: TextPiece,
        data: Bytes,
        first: int,
        new: Floats,
        new_normals: Floats | None,
        how: str,
        survey: Survey,
    ) -> Any:
        """The text of some vertices with new positions (n, 3) and normals (n, 3)."""
        changes = text.list_changes(self.facts, new, new_normals, first)
        if not changes:
            return data.data
        if len(new):
            require_finite_result(new)
        require_unit_length(changes)
        if how == _SPLICED:
            return text.splice(changes, new)
        patches = []
        for slots, values, _ in changes:
            assert isinstance(slots, Statements)
            decimals = np.full(len(values), slots.decimals, dtype=np.uint8)
            if how == _ROWS:
                used = np.zeros_like(slots.used) if slots.unit_length else slots.used
                largest = 1.0 if slots.unit_length else survey.largest
                rows = row_decimals(used, slots.decimals, largest)
                assert rows is not None
                decimals = rows
            patches.append(Patch(slots, np.require(values, np.float64, ("C", "W")), decimals))
        result = replace_statements(data, patches)
        require_replaced(data, np.frombuffer(result, dtype=np.uint8), patches)
        return result

    def _parser(self, block: list[int]) -> Parse:
        """What finds the numbers in a block; see ``TextFacts``."""
        raise NotImplementedError


class TextPiece(SlotFile):
    """Some lines of a text: vertices without faces."""

    def __init__(self, data: Buffer, format: str, parse: Parse) -> None:
        self.format = format
        self._data, self._parse = data, parse
        self._layout = parse(data)

    def list_changes(
        self, facts: TextFacts, new: Floats, normals: Floats | None, first: int
    ) -> list[Change]:
        """The arrays that change, positions (n, 3) and normals (n, 3) of vertices from ``first``
        on; their slots know the decimals of the whole file."""
        layout = self._layout
        changes = [self._position_change(layout.positions[0], facts.positions, new, first)]
        if normals is not None and facts.normals is not None:
            slots = layout.normals[0]
            assert isinstance(slots, TextSlots)
            slots.decimals = facts.normals.decimals
            changes.append(Change(slots, *merge_normals(normals, slots.values, facts.normals)))
        return [one for one in changes if one.is_changed.any()]

    def _position_change(self, slots: Any, facts: ArrayFacts, new: Floats, first: int) -> Change:
        require_shape(new, slots.values)
        slots.decimals = facts.decimals
        is_changed = np.asarray(new != slots.values)
        rounded, _ = slots.rounded(new)
        if rounded is not new:
            new, is_changed = rounded, is_changed & (rounded != slots.values)
        if slots.codes:
            require_range(new, is_changed, slots.codes, first)
        return Change(slots, new, is_changed)

    def splice(self, changes: list[Change], new: Floats) -> memoryview:
        """The text with its numbers replaced one by one, checked."""
        result = self._spliced(changes, new)
        self._check_parsed(result, changes, new)
        return result


def _row_decimals(facts: ArrayFacts, largest: float) -> Bytes | None:
    return row_decimals(np.zeros(0, dtype=np.uint8), facts.decimals, largest)


def merge_normals(new: Floats, stored: Floats, facts: ArrayFacts) -> tuple[Floats, Flags]:
    """Normals (n, 3) as they are written, those that are ``new`` and those that are kept, and which
    numbers (n, 3) are written."""
    is_new = np.asarray(~np.isnan(new).any(axis=1))[:, None]
    merged = np.where(is_new, new, stored)
    if facts.whole_rows:
        return merged, np.broadcast_to(is_new, new.shape)
    return merged, is_new & (merged != stored) & ~np.isnan(stored)
