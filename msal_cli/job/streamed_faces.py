"""The faces of a mesh that is read in pieces, with the positions of their corners.

Faces name vertices anywhere in the file.  Blocks of vertices are kept in memory up to a bound, so
that a file whose faces name vertices that are near one another, as those of scans do, is read
once.  Where they do not, the vertices are read once for every piece of the faces: slow, but in as
little memory.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Flags
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.errors import MsalError
from msal_cli.kernels.corner_gathering import BLOCK_BITS, blocks_of, gather_corners

BLOCK_VERTICES = 1 << BLOCK_BITS

CACHE_BYTES = 48 << 20
"""Bytes of vertices of one mesh that are kept in memory."""

PIECE_FACES = 1 << 19
"""Faces that are worked on at a time."""

PIECE_VERTICES = 1 << 19
"""Vertices that are read at a time where they are read one after another."""

OnStep = Callable[[int], None]
"""Called with the number of vertices or faces that were done since the last call."""


@contextmanager
def errors_of(mesh: StreamedMesh) -> Iterator[None]:
    """Errors while a mesh is read name its file."""
    try:
        yield
    except MsalError as error:
        error.path = error.path or mesh.path
        raise


class FacePiece(NamedTuple):
    """Consecutive triangles of a file.

    Attributes
    ----------
    first_triangle : the number of the first.
    triangles : (m, 3) numbers of vertices.
    corners : their positions (m, 9) in file units, of the type that the file stores.
    """

    first_triangle: int
    triangles: NDArray[np.uint32]
    corners: NDArray[np.floating]


class VertexBlocks:
    """Blocks of a mesh's vertices, of which the last ones used are kept in memory."""

    def __init__(self, mesh: StreamedMesh, most_bytes: int | None = None) -> None:
        self._mesh = mesh
        self.n_blocks = -(-mesh.n_vertices // BLOCK_VERTICES)
        block_bytes = 3 * np.dtype(mesh.vertex_type).itemsize * BLOCK_VERTICES
        n_slots = max(1, (most_bytes or CACHE_BYTES) // block_bytes)
        self._blocks = np.empty(
            (min(n_slots, max(1, self.n_blocks)), BLOCK_VERTICES, 3), dtype=mesh.vertex_type
        )
        self._slots = np.full(self.n_blocks, -1, dtype=np.int32)
        self._kept = np.full(len(self._blocks), -1, dtype=np.int64)
        self._last_use = np.zeros(len(self._blocks), dtype=np.int64)
        self._now = 0

    def corners(self, triangles: NDArray[np.uint32]) -> NDArray[np.floating]:
        """The positions (m, 9) of the corners of triangles (m, 3)."""
        corners = np.empty((len(triangles), 9), dtype=self._mesh.vertex_type)
        if self._mesh.are_corners and len(triangles):
            # Corners of facets follow one another.
            start = int(triangles[0, 0])
            return self._mesh.read_vertices(start, start + 3 * len(triangles)).reshape(-1, 9)
        needed = np.flatnonzero(blocks_of(triangles, self.n_blocks))
        # What is there comes first, so that it is used before it has to go.
        needed = needed[np.argsort(self._slots[needed] < 0, kind="stable")]
        for first in range(0, len(needed), len(self._blocks)):
            self._load(needed[first : first + len(self._blocks)])
            gather_corners(triangles, self._slots, self._blocks, corners)
        return corners

    def _load(self, wanted: NDArray[np.intp]) -> None:
        """Have these blocks in memory; they are no more than there are slots."""
        self._now += 1
        there = self._slots[wanted]
        self._last_use[there[there >= 0]] = self._now
        missing = wanted[there < 0]
        slots = np.argsort(self._last_use, kind="stable")[: len(missing)]
        for block, slot in zip(missing.tolist(), slots.tolist(), strict=True):
            if self._kept[slot] >= 0:
                self._slots[self._kept[slot]] = -1
            start = block * BLOCK_VERTICES
            stop = min(start + BLOCK_VERTICES, self._mesh.n_vertices)
            self._blocks[slot, : stop - start] = self._mesh.read_vertices(start, stop)
            self._kept[slot], self._slots[block], self._last_use[slot] = block, slot, self._now


def pieces_of(mesh: StreamedMesh, on_step: OnStep) -> Iterator[FacePiece]:
    """All faces of a mesh, cut into triangles, in their order."""
    blocks = VertexBlocks(mesh)
    with errors_of(mesh):
        chunks = mesh.face_chunks(PIECE_FACES)
    for chunk in chunks:
        with errors_of(mesh):
            triangles = mesh.read_triangles(chunk)
        yield FacePiece(chunk.first_triangle, triangles, blocks.corners(triangles))
        on_step(chunk.polygons[1] - chunk.polygons[0])


class TriangleReader:
    """The triangles of a mesh in pieces of the sizes that are asked for."""

    def __init__(self, mesh: StreamedMesh, on_step: OnStep) -> None:
        self._mesh = mesh
        with errors_of(mesh):
            self._chunks = iter(mesh.face_chunks(PIECE_FACES))
        self._on_step = on_step
        self._rest = np.empty((0, 3), dtype=np.uint32)

    def take(self, count: int) -> NDArray[np.uint32]:
        """The next ``count`` triangles (count, 3); fewer where there are no more."""
        parts, n_found = [self._rest], len(self._rest)
        while n_found < count and (chunk := next(self._chunks, None)) is not None:
            with errors_of(self._mesh):
                parts.append(self._mesh.read_triangles(chunk))
            n_found += len(parts[-1])
            self._on_step(chunk.polygons[1] - chunk.polygons[0])
        triangles = np.concatenate(parts)
        self._rest = triangles[count:]
        return triangles[:count]


def vertex_ranges(mesh: StreamedMesh) -> Iterator[tuple[int, int]]:
    """The vertices of a mesh in ranges: the first and the one behind the last."""
    for start in range(0, mesh.n_vertices, PIECE_VERTICES):
        yield start, min(start + PIECE_VERTICES, mesh.n_vertices)


def used_flags(used: NDArray[np.uint8], start: int, stop: int) -> Flags:
    """Which vertices from ``start`` to ``stop`` are marked among the bits ``used``; all of them
    where there are no bits."""
    if not len(used):
        return np.ones(stop - start, dtype=bool)
    bits = np.unpackbits(used[start // 8 : -(-stop // 8)], bitorder="little")
    first = start - start // 8 * 8
    flags: Flags = bits[first : first + stop - start].astype(bool)
    return flags
