"""What one pass over the vertices and one over the faces of a mesh tell: bounds, sums, edges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import is_negative
from msal_cli.arrays import Floats
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.errors import ContentError
from msal_cli.job.streamed_faces import (
    PIECE_VERTICES,
    FacePiece,
    OnStep,
    errors_of,
    pieces_of,
    vertex_ranges,
)
from msal_cli.kernels import edge_sketch
from msal_cli.kernels.edge_sketch import EdgeSketch, LeftEdges
from msal_cli.mesh import LARGEST_EXTENT, Defects

MOST_MARKED = 1 << 31
"""Vertices up to which those that faces use are marked, a bit for each."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Least and greatest coordinates (3,) of the vertices."""

    low: Floats
    high: Floats

    @property
    def origin(self) -> Floats:
        """The middle, which volumes are seen from."""
        middle: Floats = (self.low + self.high) / 2.0
        return middle

    @property
    def diagonal(self) -> float:
        """No edge is longer."""
        return float(np.linalg.norm(self.high - self.low))


@dataclass(frozen=True, eq=False)
class Totals:
    """What a pass over all faces tells.

    Attributes
    ----------
    n_triangles : polygons cut.
    degenerate_faces : see ``mesh.Defects``.
    area, volume : squared and cubed file units; the volume is signed.
    mean_edge_length : over the edges, each once; over the sides of all faces where ``edges`` is
        None.
    edges : those without an opposite; None if there are too many to tell.
    used : a bit for each vertex that a face uses, the lowest first; empty if they are not marked.
    unreferenced_vertices : those that are not marked; None if they are not known.
    """

    n_triangles: int
    degenerate_faces: int
    area: float
    volume: float
    mean_edge_length: float
    edges: LeftEdges | None
    used: NDArray[np.uint8]
    unreferenced_vertices: int | None

    @property
    def volume_objection(self) -> str:
        """Why the volume is not to be trusted; empty if it is."""
        edges = self.edges
        if edges is None:
            return "open (too many open edges to count them)"
        if edges.inconsistent_edges:
            return "wound inconsistently, which is put right in memory only"
        known = Defects(
            boundary_edges=edges.boundary_edges,
            non_manifold_edges=edges.crowded_edges,
            inconsistent_edges=0,
            welded_vertices=0,
            unreferenced_vertices=0,
            degenerate_faces=0,
            duplicate_faces=0,
            turned_faces=0,
            unorientable_parts=0,
            components=0,
        )
        return known.volume_objection

    @property
    def is_inside_out(self) -> bool:
        """Whether the surface as a whole is closed and its normals point inwards."""
        return not self.volume_objection and is_negative(self.volume, self.area)


def measure_bounds(
    mesh: StreamedMesh,
    on_step: OnStep,
    on_vertices: Callable[[int, NDArray[np.floating]], None] | None = None,
) -> Bounds:
    """Read all vertices once; ``on_vertices`` gets the number of the first and the positions of
    each piece."""
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for start, stop in vertex_ranges(mesh):
        with errors_of(mesh):
            vertices = mesh.read_vertices(start, stop)
        low = np.minimum(low, vertices.min(axis=0)).astype(np.float64)
        high = np.maximum(high, vertices.max(axis=0)).astype(np.float64)
        if on_vertices is not None:
            on_vertices(start, vertices)
        on_step(stop - start)
    extent = float((high - low).max(initial=-np.inf))
    if mesh.n_vertices and not 1.0 / LARGEST_EXTENT < extent < LARGEST_EXTENT:
        raise ContentError(
            f"the mesh extends over {extent:g} units, too far or too little to compute with",
            code="E_RANGE",
            hint="scale the mesh, or look for a stray vertex",
        )
    return Bounds(low, high)


def measure_faces(
    mesh: StreamedMesh,
    bounds: Bounds,
    on_step: OnStep,
    on_piece: Callable[[FacePiece], None] | None = None,
) -> Totals:
    """Read all faces once, with the positions of their corners.

    Raises
    ------
    ContentError
        with code ``E_NO_FACES`` if there is no face with three different corners; and see
        ``StreamedMesh``.
    """
    marked = 0 if mesh.are_corners or mesh.n_vertices > MOST_MARKED else mesh.n_vertices
    sketch = EdgeSketch(bounds.origin, bounds.diagonal or 1.0, marked)
    n_triangles = 0
    for piece in pieces_of(mesh, on_step):
        n_triangles += len(piece.triangles)
        sketch.add(piece.corners, piece.triangles)
        if on_piece is not None:
            on_piece(piece)
    if not sketch.sums[edge_sketch.FACES]:
        raise ContentError(
            "every face is degenerate: its corners are not three different points"
            if n_triangles
            else "the file has no faces",
            code="E_NO_FACES",
            hint="check the file in a viewer; there is no surface to work on",
        )
    edges = sketch.left_edges()
    # An edge inside is a side of two faces, and one of a boundary the side of one.
    n_sides, sides = 3.0 * sketch.sums[edge_sketch.FACES], sketch.sums[edge_sketch.SIDES]
    if edges is not None:
        n_sides, sides = n_sides + edges.boundary_edges, sides + edges.boundary_length
    return Totals(
        n_triangles=n_triangles,
        degenerate_faces=int(sketch.sums[edge_sketch.FLAT]),
        area=float(sketch.sums[edge_sketch.DOUBLED_AREA]) / 2.0,
        volume=float(sketch.sums[edge_sketch.SIXFOLD_VOLUME]) / 6.0,
        mean_edge_length=float(sides / n_sides),
        edges=edges,
        used=sketch.used,
        unreferenced_vertices=marked - _count_bits(sketch.used) if marked else None,
    )


def _count_bits(bits: NDArray[np.uint8]) -> int:
    return sum(
        int(np.unpackbits(bits[start : start + PIECE_VERTICES]).sum(dtype=np.int64))
        for start in range(0, len(bits), PIECE_VERTICES)
    )
