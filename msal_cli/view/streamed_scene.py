"""Meshes that are larger than memory, decimated to be looked at while they are read in pieces.

Of all vertices in a cell of a grid one is kept, with its place, and faces between three cells are
kept as faces between their vertices.  What is measured is measured on the whole meshes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.arrays import Floats, Ints, Longs
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.errors import ContentError
from msal_cli.job.streamed_comparison import compare_in_steps, require_same_counts
from msal_cli.job.streamed_faces import FacePiece, OnStep, vertex_ranges
from msal_cli.job.streamed_progress import Steps
from msal_cli.job.streamed_totals import measure_bounds, measure_faces
from msal_cli.kernels.cell_clusters import CellFaces, CellTable
from msal_cli.mesh import Mesh
from msal_cli.view.pictures import FullSize, Scene

if TYPE_CHECKING:
    from msal_cli.job.streamed_progress import ReadingListener
    from msal_cli.job.streamed_totals import Bounds

MOST_CELLS = 300_000
"""Cells, and so vertices, that are kept: on a surface half as many at least, and twice as many
triangles, more than the pixels of a panel."""


def scene_of_streamed(
    meshes: Sequence[StreamedMesh], names: tuple[str, ...], listener: ReadingListener | None
) -> Scene:
    """One mesh, or two with the same faces, as ``pictures.scene_of``.

    The deviation is that of the vertices that are kept, along the normals of the whole mesh.

    Raises
    ------
    ContentError, TruncatedError, FormatError
        for a file that is damaged, or without a surface to draw.
    UnsupportedError
        if the faces of two meshes are not the same.
    """
    before = meshes[0]
    if len(meshes) == 1:
        steps = Steps(listener, names, meshes, vertex_passes=2)
        bounds, cells = _gather_cells(before, steps.add)
        totals = measure_faces(before, bounds, steps.add, lambda piece: cells.add(piece.corners))
        kept, faces = _kept_faces(cells)
        size = _size(before, totals.n_triangles)
        edge = totals.mean_edge_length
        return Scene(names, _mesh(cells.vertices[kept], faces, bounds, edge), full_sizes=(size,))
    after = meshes[1]
    require_same_counts(before, after, names[1])
    steps = Steps(listener, names, meshes, vertex_passes=4)
    bounds, cells = _gather_cells(before, steps.add)

    def add(piece: FacePiece) -> None:
        cells.add(piece.corners)

    record = compare_in_steps(before, after, names, bounds, steps.add, add)
    kept, faces = _kept_faces(cells)
    drawn = _mesh(cells.vertices[kept], faces, bounds, record.mean_edge_length or 0.0)
    moved = drawn.with_vertices(_positions(after, cells.chosen[kept], steps.add) - bounds.origin)
    step = moved.vertices - drawn.vertices
    along: Floats = (step * _unit(cells.normals[kept])).sum(axis=1)
    if record.inside_out_before:
        along = -along
    n_triangles = record.faces_before or 0
    sizes = (_size(before, n_triangles), _size(after, n_triangles))
    return Scene(names, drawn, moved, along, True, record, full_sizes=sizes)


def _gather_cells(mesh: StreamedMesh, on_step: OnStep) -> tuple[Bounds, CellFaces]:
    bounds = measure_bounds(mesh, on_step)
    table = CellTable(bounds.low, float((bounds.high - bounds.low).max()), MOST_CELLS)
    measure_bounds(mesh, on_step, table.enter)
    return bounds, table.close()


def _kept_faces(cells: CellFaces) -> tuple[Longs, Ints]:
    """The vertices (k,), among those of all cells, that faces use, and the faces between them."""
    kept, faces = np.unique(cells.faces, return_inverse=True)
    if not len(kept):
        raise ContentError(
            "nothing is left to draw: no face is as large as the distance between pixels",
            code="E_NO_FACES",
            hint="look for a stray vertex far away; msal info prints the bounds",
        )
    return kept.astype(np.int64), faces.reshape(-1, 3).astype(np.int32)


def _mesh(vertices: Floats, faces: Ints, bounds: Bounds, edge: float) -> Mesh:
    """The mesh of what is kept; its mean edge length, a unit, is that of the whole, ``edge``."""
    mesh = Mesh(vertices - bounds.origin, faces)
    mesh.__dict__["mean_edge_length"] = edge
    return mesh


def _positions(mesh: StreamedMesh, chosen: Longs, on_step: OnStep) -> Floats:
    """The positions (k, 3) of vertices of these numbers (k,), which rise."""
    found = np.empty((len(chosen), 3))
    for start, stop in vertex_ranges(mesh):
        first, last = np.searchsorted(chosen, (start, stop))
        if last > first:
            found[first:last] = mesh.read_vertices(start, stop)[chosen[first:last] - start]
        on_step(stop - start)
    return found


def _unit(sums: Floats) -> Floats:
    """Sums of normals (k, 3) at unit length; zeros where there is none."""
    lengths = np.sqrt((sums * sums).sum(axis=1, keepdims=True))
    unit: Floats = np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0.0)
    return unit


def _size(mesh: StreamedMesh, n_triangles: int) -> FullSize:
    return FullSize(n_triangles, None if mesh.are_corners else mesh.n_vertices)
