"""Binary STL files read and rewritten in pieces: vertices are the corners of facets."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Bytes, Floats, Floats32
from msal_cli.codecs.slot_file import require_finite_result, require_shape
from msal_cli.codecs.slots import require_range
from msal_cli.codecs.stl import (
    check_replaced,
    colour_properties,
    trailing_warning,
    wanted_bytes,
)
from msal_cli.codecs.stl_facets import FACET, HEADER_BYTES, check_not_empty, not_finite
from msal_cli.codecs.streamed.byte_ranges import BLOCK_BYTES, read_range, split_range
from msal_cli.codecs.streamed.limits import require_countable
from msal_cli.codecs.streamed_mesh import FaceChunk, NewNormals, NewPositions, Survey
from msal_cli.errors import InputError

_FIRST = HEADER_BYTES + 4
_SIZE = FACET.itemsize
_AT_ONCE = BLOCK_BYTES // _SIZE
_NONE = np.empty(0, dtype=bool)

_REPLACED = 1 << 16
"""Facets that are replaced at a time, so that their new corners take little memory."""


class StreamedStl:
    """A binary STL file; see ``codecs.streamed_mesh.StreamedMesh``.

    Vertex 3 f + k is corner k of facet f.  Minus zero is read as a plain zero, as in memory.
    """

    format = "stl"
    encoding = "binary_little_endian"
    precision = "float32"
    references: tuple[str, ...] = ()
    vertex_type: type[np.float32] | type[np.float64] = np.float32
    are_corners = True
    keeps_size = True
    has_normals = False

    def __init__(self, path: str, head: Bytes, size: int) -> None:
        """Open the file of ``size`` bytes that begins with ``head``."""
        self.path, self.size = path, size
        self.header = head[:HEADER_BYTES].tobytes()
        self._end = wanted_bytes(head.tobytes(), size)
        self.n_polygons = (self._end - _FIRST) // _SIZE
        self.n_vertices = 3 * self.n_polygons
        check_not_empty(self.n_polygons, size - self._end)
        require_countable(self.n_vertices, "corners of facets")
        self._properties: tuple[str, ...] | None = None

    @property
    def properties(self) -> tuple[str, ...]:
        """What the file has besides positions; the first call may read all facets."""
        if self._properties is None:
            has_normals = has_words = False
            for start, stop in split_range(0, self.n_polygons, _AT_ONCE):
                facets = self._read_facets(start, stop)
                # Neither zero nor minus zero.
                has_normals = has_normals or bool((_bits(facets["normal"]) & 0x7FFFFFFF).any())
                has_words = has_words or bool(facets["attribute"].any())
                if has_normals and has_words:
                    break
            self._properties = colour_properties(self.header, has_normals, has_words)
        return self._properties

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know."""
        return trailing_warning(self.size - self._end)

    # Reading

    def read_vertices(self, start: int, stop: int) -> Floats32:
        """See ``StreamedMesh``."""
        vertices = np.empty((stop - start, 3), dtype=np.float32)
        for low, high in split_range(start // 3, -(-stop // 3), _AT_ONCE):
            corners = _corners(self._read_facets(low, high))
            is_finite = np.asarray(np.isfinite(corners).all(axis=1))
            first, last = max(start, 3 * low), min(stop, 3 * high)
            part = slice(first - 3 * low, last - 3 * low)
            if not is_finite[part].all():
                corner = first + int(np.argmin(is_finite[part]))
                raise not_finite(corner // 3, corner % 3)
            vertices[first - start : last - start] = corners[part]
        return vertices

    def face_chunks(self, most: int) -> list[FaceChunk]:
        """See ``StreamedMesh``."""
        return [
            FaceChunk((first, stop), first, (_FIRST + first * _SIZE, _FIRST + stop * _SIZE))
            for first, stop in split_range(0, self.n_polygons, most)
        ]

    def read_triangles(self, chunk: FaceChunk) -> NDArray[np.uint32]:
        """See ``StreamedMesh``; nothing is read."""
        first, stop = chunk.polygons
        return np.arange(3 * first, 3 * stop, dtype=np.uint32).reshape(-1, 3)

    def read_property(self, name: str, start: int, stop: int) -> Floats:
        """Raise InputError: STL has no properties of vertices."""
        raise InputError(
            f"the corners of an STL file have no property {name!r}",
            code="E_PROPERTY",
            hint="give a PLY, or leave out for this file what names a property",
        )

    def read_normals(self, start: int, stop: int) -> Floats:
        """Raise InputError: STL has no normals of vertices."""
        return self.read_property("nx", start, stop)

    # Writing

    def output_pieces(self, most: int) -> list[tuple[int, int]]:
        """See ``StreamedMesh``; no facet lies in two pieces."""
        return [
            (0, _FIRST),
            *split_range(_FIRST, self._end, max(1, most // _SIZE) * _SIZE),
            *split_range(self._end, self.size, most),
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
        """See ``StreamedMesh``; facets' normals are computed from the new corners."""
        from msal_cli.kernels.facet_normals import replace_facets
        from msal_cli.kernels.parallel import over_ranges

        data = read_range(self.path, *piece)
        low = (max(piece[0], _FIRST) - _FIRST) // _SIZE
        high = (min(piece[1], self._end) - _FIRST) // _SIZE
        if high <= low:
            return data.data
        begin = _FIRST + low * _SIZE - piece[0]
        before = data[begin : begin + (high - low) * _SIZE].view(FACET)
        result, after = data, before
        for start, stop in split_range(0, high - low, _REPLACED):
            old = _corners(before[start:stop]).astype(np.float64)
            new = positions(3 * (low + start), 3 * (low + stop))
            require_shape(new, old)
            if np.array_equal(old, new):
                continue
            require_range(new, np.broadcast_to(True, new.shape), ("<f4",) * 3, 3 * (low + start))
            require_finite_result(new)
            if result is data:
                result = data.copy()
                after = result[begin : begin + (high - low) * _SIZE].view(FACET)
            part = after[start:stop]
            faces = np.arange(3 * len(part), dtype=np.int32).reshape(-1, 3)
            over_ranges(
                replace_facets, len(part), old, new, faces, part["normal"], part["corners"], _NONE
            )
            check_replaced(before[start:stop], part, old, new, faces, low + start)
        return result.data

    def _read_facets(self, start: int, stop: int) -> NDArray[np.void]:
        data = read_range(self.path, _FIRST + start * _SIZE, _FIRST + stop * _SIZE)
        return data.view(FACET)


def _corners(facets: NDArray[np.void]) -> Floats32:
    """The corners (3 m, 3) of facets (m,)."""
    # The sum makes a plain zero of a negative one.  A signalling NaN is reported elsewhere.
    with np.errstate(invalid="ignore"):
        return np.ascontiguousarray(facets["corners"]).reshape(-1, 3) + np.float32(0.0)


def _bits(values: NDArray[np.float32]) -> NDArray[np.uint32]:
    return np.ascontiguousarray(values).view(np.uint32)
