"""A mesh that is read and written in pieces, so that it is never in memory whole."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats

NewPositions = Callable[[int, int], Floats]
"""Called as ``(start, stop)``: the new positions (stop - start, 3) of these vertices, float64, file
units; that of a vertex which did not move is exactly the stored one."""

NewNormals = Callable[[int, int], Floats]
"""The same for the unit normals of vertices, where the file stores such: those that are computed
anew, and NaN for those that are kept."""


class Survey(NamedTuple):
    """What the new numbers of a whole file decide about the text of each.

    Attributes
    ----------
    is_moved : whether any vertex moved.
    has_new_normals : whether any normal changed.
    largest : the largest magnitude of a new position.
    """

    is_moved: bool
    has_new_normals: bool
    largest: float


@dataclass(frozen=True)
class FaceChunk:
    """Consecutive faces of a file.

    Attributes
    ----------
    polygons : numbers of the first face and of the one behind the last, as the file counts.
    first_triangle : number of the first triangle among those of the whole file.
    place : where they are, in terms of the codec: bytes, mostly.
    """

    polygons: tuple[int, int]
    first_triangle: int
    place: tuple[int, int]


class StreamedMesh(Protocol):
    """An opened mesh file of which only the header is in memory.

    Opening checks what the header and the size of the file show.  Instances can be pickled: a
    worker opens the file anew.

    Attributes
    ----------
    path, format, encoding, precision, properties, references, warnings : see
        ``codecs.mesh_file.MeshFile``.
    n_vertices : positions that the file stores: for STL three for each facet.
    n_polygons : faces as the file counts them.
    size : bytes of the file.
    vertex_type : float32 or float64, what holds every stored coordinate exactly.
    are_corners : vertices are the corners of facets (STL), so that welding is how faces meet.
    has_normals : the file stores normals of its vertices, which follow them.
    keeps_size : new numbers take as many bytes as old ones, as in all binary files.
    """

    path: str
    format: str
    encoding: str
    precision: str
    references: tuple[str, ...]
    n_vertices: int
    n_polygons: int
    size: int
    vertex_type: type[np.float32] | type[np.float64]
    are_corners: bool
    has_normals: bool
    keeps_size: bool

    @property
    def properties(self) -> tuple[str, ...]:
        """See above; it may read the whole file once."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """See above; it may read the whole file once."""
        ...

    def read_vertices(self, start: int, stop: int) -> NDArray[Any]:
        """The positions (stop - start, 3) of ``vertex_type``.

        Raises ContentError (``E_NONFINITE`` with the vertex) and TruncatedError.
        """
        ...

    def face_chunks(self, most: int) -> list[FaceChunk]:
        """All faces in pieces of ``most`` polygons or so."""
        ...

    def read_triangles(self, chunk: FaceChunk) -> NDArray[np.uint32]:
        """The triangles (m, 3) of a chunk, polygons cut as in memory: numbers of vertices, checked.

        Raises ContentError (``E_INDEX`` with the face), TruncatedError and FormatError.
        """
        ...

    def read_property(self, name: str, start: int, stop: int) -> Floats:
        """A scalar property of vertices (stop - start,); InputError (``E_PROPERTY``)."""
        ...

    def read_normals(self, start: int, stop: int) -> Floats:
        """The stored normals (stop - start, 3), where the file has them."""
        ...

    def output_pieces(self, most: int) -> list[tuple[int, int]]:
        """The whole file in pieces of ``most`` bytes or so, first byte and the one behind the last;
        each can be replaced on its own."""
        ...

    def survey(self, positions: NewPositions, normals: NewNormals | None) -> Survey | None:
        """What all new numbers decide about the text of each; None for binary files.

        It calls both for all vertices, some at a time.
        """
        ...

    def replace(
        self,
        piece: tuple[int, int],
        positions: NewPositions,
        normals: NewNormals | None,
        survey: Survey | None = None,
    ) -> memoryview:
        """The bytes of a piece with new positions and normals: those that the codec for whole
        files would write.  They are checked against the input before they are returned.
        ``survey`` is what the method of that name returned.

        Raises ContentError (``E_RANGE``) and InternalError.
        """
        ...
