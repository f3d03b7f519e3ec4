"""Binary PLY files read and rewritten in pieces."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats
from msal_cli.codecs.layout import require_finite
from msal_cli.codecs.ply_ascii import Before
from msal_cli.codecs.ply_description import (
    check_strays,
    has_normals,
    precision_of,
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
from msal_cli.codecs.ply_header import NORMAL, POSITION, Element, Header, parsed
from msal_cli.codecs.ply_sections import cut_off, section_at
from msal_cli.codecs.record_slots import Overwrite, Strided, check_overwritten, overwrite
from msal_cli.codecs.slot_file import require_finite_result, require_shape
from msal_cli.codecs.slots import require_range
from msal_cli.codecs.streamed.byte_ranges import BLOCK_BYTES, read_range, split_range
from msal_cli.codecs.streamed.limits import require_countable
from msal_cli.codecs.streamed.ply_ids import Ids, cut_polygons
from msal_cli.codecs.streamed.ply_walk import Run, fixed_stride, walk_element
from msal_cli.codecs.streamed_mesh import FaceChunk, NewNormals, NewPositions, Survey
from msal_cli.errors import UnsupportedError

_AT_ONCE = 1 << 17
"""Vertices that are replaced at a time, so that their new positions take little memory."""

_IN_MEMORY = "run on a machine with more memory"


class StreamedPly:
    """A binary PLY file; see ``codecs.streamed_mesh.StreamedMesh``.

    Where records of ``vertex`` and ``face`` lie is all that is kept.
    """

    format = "ply"
    are_corners = False
    keeps_size = True

    def __init__(self, path: str, head: Bytes, size: int) -> None:
        """Open the file of ``size`` bytes that begins with ``head``."""
        self.path, self.size = path, size
        self.header: Header = parsed(memoryview(head.tobytes()), len(head) == size)
        vertex = self.vertex = vertex_element(self.header)
        refuse_others(self.header)
        self.encoding = self.header.encoding
        self.precision = precision_of(self.header, vertex)
        self.properties = properties_of(self.header)
        self.references = self.header.textures
        self.n_vertices = vertex.count
        face = self.face = self.header.find("face")
        self.corners = corner_list(face) if face is not None else ""
        self.n_polygons = face.count if face is not None else 0
        if face is None or not self.corners or not face.count:
            raise no_faces(face, vertex.count)
        require_countable(vertex.count, "vertices")
        self.has_normals = has_normals(vertex)
        codes = [one.code for one in vertex.find_all(POSITION)]
        is_single = all(np.can_cast(code, np.float32) for code in codes)
        self.vertex_type: type[np.float32] | type[np.float64] = (
            np.float32 if is_single else np.float64
        )
        self._stride = fixed_stride(vertex) or 0
        self._start = self._vertex_start()
        self._n_few: int | None = None
        self._n_behind = 0

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know; the first call reads all faces, unless they are known."""
        if self._n_few is None:
            self.face_chunks(self.n_polygons)
        face, n_few = self.face, self._n_few
        assert face is not None
        has_both = all(face.find(one) for one in CORNERS)
        return (
            *warnings_of(self.header, self.vertex),
            *((warn_of_two_lists(self.corners),) * has_both),
            *((warn_of_few(n_few),) if n_few else ()),
            *((warn_of_rest(self._n_behind),) if self._n_behind else ()),
        )

    # Reading

    def read_vertices(self, start: int, stop: int) -> NDArray[Any]:
        """See ``StreamedMesh``."""
        vertices: NDArray[Any] = np.empty((stop - start, 3), dtype=self.vertex_type)
        self._read_columns(POSITION, start, vertices)
        require_finite(vertices, first=start)
        return vertices

    def read_property(self, name: str, start: int, stop: int) -> Floats:
        """See ``StreamedMesh``."""
        scalar_property(self.vertex, name)
        values = np.empty((stop - start, 1))
        self._read_columns((name,), start, values)
        return values[:, 0]

    def read_normals(self, start: int, stop: int) -> Floats:
        """See ``StreamedMesh``."""
        normals = np.empty((stop - start, 3))
        self._read_columns(NORMAL, start, normals)
        return normals

    def face_chunks(self, most: int) -> list[FaceChunk]:
        """See ``StreamedMesh``; reads the lengths of all lists, and looks for the file's end.

        Raises TruncatedError and FormatError with the record, and ContentError (``E_NO_FACES``).
        """
        chunks = []
        at, first, n_few = self.header.size, 0, 0
        for element in self.header.elements:
            is_face = element is self.face
            for run in self._walk(element, at, most if is_face else 0):
                at = run.place[1]
                if is_face:
                    chunks.append(FaceChunk((run.first, run.stop), first, run.place))
                    first += run.n_triangles
                    n_few += run.n_few
        check_strays(self.header, self.size - at)
        if not first:
            raise no_faces(self.face, self.n_vertices)
        self._n_few, self._n_behind = n_few, self.size - at
        return chunks

    def read_triangles(self, chunk: FaceChunk) -> Ids:
        """See ``StreamedMesh``."""
        assert self.face is not None
        data = read_range(self.path, *chunk.place)
        first, stop = chunk.polygons
        part = dataclasses.replace(self.face, count=stop - first)
        section = section_at(data, self.header, part, 0, wanted_names(part))
        section = dataclasses.replace(section, before=Before(first))
        return cut_polygons(section, self.corners, self.n_vertices)

    # Writing

    def output_pieces(self, most: int) -> list[tuple[int, int]]:
        """See ``StreamedMesh``; no vertex lies in two pieces."""
        end = self._start + self.n_vertices * self._stride
        whole = max(1, most // self._stride) * self._stride
        return [
            *split_range(0, self._start, most),
            *split_range(self._start, end, whole),
            *split_range(end, self.size, most),
        ]

    def survey(self, positions: NewPositions, normals: NewNormals | None) -> None:
        """See ``StreamedMesh``."""

    def replace(
        self,
        piece: tuple[int, int],
        positions: NewPositions,
        normals: NewNormals | None,
        survey: Survey | None = None,
    ) -> memoryview:
        """See ``StreamedMesh``."""
        data = read_range(self.path, *piece)
        first = max(0, piece[0] - self._start) // self._stride
        end = self._start + self.n_vertices * self._stride
        stop = max(0, min(piece[1], end) - self._start) // self._stride
        result = data
        for low, high in split_range(first, stop, _AT_ONCE):
            local = self._start + low * self._stride - piece[0]
            part = slice(local, local + (high - low) * self._stride)
            changes = self._changed_positions(data[part], low, positions(low, high))
            if normals is not None and self.has_normals:
                changes += self._changed_normals(data[part], normals(low, high))
            if changes:
                new = np.frombuffer(overwrite(data[part], changes), dtype=np.uint8)
                check_overwritten(data[part], new, changes)
                if result is data:
                    result = data.copy()
                result[part] = new
        return result.data

    def _changed_positions(self, data: Bytes, first: int, new: Floats) -> list[Overwrite]:
        """New positions (n, 3) of vertices from ``first`` on, whose records are ``data``."""
        slots = self._slots(data, POSITION)
        old = slots.values
        require_shape(new, old)
        is_moved = new != old
        if not is_moved.any():
            return []
        require_range(new, is_moved, slots.codes, first)
        require_finite_result(new)
        return [Overwrite(slots, new, is_moved)]

    def _changed_normals(self, data: Bytes, new: Floats) -> list[Overwrite]:
        """The same for their normals."""
        slots = self._slots(data, NORMAL)
        is_new = np.asarray(~np.isnan(new).any(axis=1))
        if not is_new.any():
            return []
        return [Overwrite(slots, new, np.broadcast_to(is_new[:, None], new.shape))]

    # Places

    def _vertex_start(self) -> int:
        """The first byte of the first vertex; elements before it are walked over."""
        at = self.header.size
        for element in self.header.elements:
            if element is self.vertex:
                break
            for run in self._walk(element, at):
                at = run.place[1]
        if self.vertex.count * self._stride > self.size - at:
            raise cut_off(self.vertex, self._stride, self.size - at)
        return at

    def _walk(self, element: Element, at: int, most: int = 0) -> list[Run]:
        order = self.header.byte_order
        corners = self.corners if element is self.face else ""
        return list(walk_element(self.path, self.size, element, order, at, corners, most))

    def _read_columns(self, names: Sequence[str], start: int, values: NDArray[Any]) -> None:
        """Read scalars of vertices from ``start`` on into ``values`` (n, k), some at a time."""
        for low, high in split_range(0, len(values), max(1, BLOCK_BYTES // self._stride)):
            first = self._start + (start + low) * self._stride
            data = read_range(self.path, first, first + (high - low) * self._stride)
            self._slots(data, names).read_into(data, values[low:high])

    def _slots(self, data: Bytes, names: Sequence[str]) -> Strided:
        """Where scalars of vertices are in ``data``, which are records of theirs."""
        places, order = [], self.header.byte_order
        for name in names:
            before = self.vertex.properties[: self.vertex.index(name)]
            places.append(sum(one.least_bytes() for one in before))
        codes = tuple(order + one.code for one in self.vertex.find_all(names))
        is_normal = names == NORMAL
        return Strided(
            data, 0, len(data) // self._stride, self._stride, tuple(places), codes, is_normal
        )


def refuse_others(header: Header) -> None:
    """Raise UnsupportedError for what cannot be read, or not be rewritten, in pieces."""
    vertex, face, strips = (header.find(name) for name in ("vertex", "face", "tristrips"))
    if vertex is not None and fixed_stride(vertex) is None:
        lists = [one for one in vertex.properties if one.is_list]
        raise UnsupportedError(
            f"a PLY file whose vertices have lists ({lists[0].name!r}) cannot be read in pieces",
            where=f"line {lists[0].line + 1}",
            hint=f"export it without them, or {_IN_MEMORY}",
        )
    if strips is not None and strips.count and corner_list(strips):
        raise UnsupportedError(
            "a PLY file with triangle strips cannot be read in pieces",
            where="element tristrips",
            hint=f"export it with faces, or {_IN_MEMORY}",
        )
    if face is not None and face.count and has_normals(face):
        raise UnsupportedError(
            "a PLY file whose faces store normals cannot be rewritten in pieces",
            where="element face",
            hint=f"export it without them, or {_IN_MEMORY}",
        )
