"""Two files that are larger than memory against each other, vertex by vertex and face by face."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.enclosure import INSIDE_OUT
from msal_cli.analysis.measures import SurfaceChange, is_negative, surface_change_of
from msal_cli.arrays import Floats
from msal_cli.codecs.streamed_mesh import StreamedMesh
from msal_cli.errors import UnsupportedError
from msal_cli.job import changes
from msal_cli.job.comparison_record import ComparisonRecord
from msal_cli.job.records import Area, Volume
from msal_cli.job.streamed_distances import displacement_in_pieces
from msal_cli.job.streamed_faces import FacePiece, OnStep, TriangleReader, VertexBlocks
from msal_cli.job.streamed_progress import Steps
from msal_cli.job.streamed_totals import Bounds, Totals, measure_bounds, measure_faces
from msal_cli.kernels import surface_change as core
from msal_cli.kernels.edge_sketch import EdgeSketch
from msal_cli.version import __version__

if TYPE_CHECKING:
    from msal_cli.job.streamed_progress import ReadingListener

AT_ONCE = 1 << 17
"""Faces that are measured at a time, in double precision before and after."""

NO_DISTANCES = (
    "larger than memory: no Hausdorff distance and no distances to the surfaces; what needs "
    "corresponding vertices is measured"
)


def compare_streamed(
    before: StreamedMesh,
    after: StreamedMesh,
    names: tuple[str, str],
    listener: ReadingListener | None,
) -> ComparisonRecord:
    """What became of ``before``, the reference; see ``comparison.compare_meshes``.

    Raises
    ------
    UnsupportedError
        if the faces are not the same: distances between surfaces need all of them in memory.
    """
    require_same_counts(before, after, names[1])
    steps = Steps(listener, names, (before, after), vertex_passes=3)
    return compare_in_steps(before, after, names, measure_bounds(before, steps.add), steps.add)


def require_same_counts(before: StreamedMesh, after: StreamedMesh, name: str) -> None:
    """Raise UnsupportedError, with the ``name`` of the mesh after, if the headers show that the
    faces are not the same."""
    counts = [(one.n_vertices, one.n_polygons, one.are_corners) for one in (before, after)]
    if counts[0] != counts[1]:
        raise _other_faces(name, "other numbers of vertices or faces")


def compare_in_steps(
    before: StreamedMesh,
    after: StreamedMesh,
    names: tuple[str, ...],
    bounds: Bounds,
    on_step: OnStep,
    on_piece: Callable[[FacePiece], None] | None = None,
) -> ComparisonRecord:
    """The same where the ``bounds`` before are known; ``on_piece`` gets the faces before, too."""
    measure_bounds(after, on_step)
    pair = _FacePairs(before, after, bounds, names[1], on_step)

    def add(piece: FacePiece) -> None:
        pair.add(piece)
        if on_piece is not None:
            on_piece(piece)

    totals = measure_faces(before, bounds, on_step, add)
    pair.check_seams(totals)
    change = surface_change_of(pair.figures)
    displacement = displacement_in_pieces(before, after, totals.used, on_step)
    edge = totals.mean_edge_length
    normals = change.normals
    volume, area, sides = _volume_and_area(totals, change)
    warnings = [f"{word}: {INSIDE_OUT}" for word, is_inside_out in sides.items() if is_inside_out]
    return ComparisonRecord(
        before=names[0],
        after=names[1],
        version=__version__,
        correspondence="vertices",
        vertices_before=None if before.are_corners else before.n_vertices,
        vertices_after=None if after.are_corners else after.n_vertices,
        corners_before=before.n_vertices if before.are_corners else None,
        corners_after=after.n_vertices if after.are_corners else None,
        faces_before=totals.n_triangles,
        faces_after=totals.n_triangles,
        read_in_pieces=True,
        mean_edge_length=edge,
        mean_angular_error_deg=normals.mean_angular_error_deg,
        max_angular_error_deg=normals.max_angular_error_deg,
        flipped_faces=normals.flipped_faces,
        vertex_error_percent=100.0 * displacement.mean / edge,
        displacement=changes.displacement_field(displacement, edge),
        volume=volume,
        area=area,
        volume_change_percent=volume.change_percent,
        area_change_percent=area.change_percent,
        inside_out_before=sides["before"],
        inside_out_after=sides["after"],
        warnings=(*warnings, NO_DISTANCES),
    )


class _FacePairs:
    """The figures of all faces before and after, which come in the pieces of those before."""

    def __init__(
        self,
        before: StreamedMesh,
        after: StreamedMesh,
        bounds: Bounds,
        name: str,
        on_step: OnStep,
    ) -> None:
        self._bounds, self._name = bounds, name
        self._reader = TriangleReader(after, on_step)
        self._blocks = VertexBlocks(after)
        # Facets share no vertices: what meets before must meet after.
        self._seams = EdgeSketch(bounds.origin, bounds.diagonal, 0) if before.are_corners else None
        self.figures: Floats = np.zeros(core.N_FIGURES)

    def add(self, piece: FacePiece) -> None:
        """Add the faces of a piece; UnsupportedError if they are others after."""
        triangles = self._reader.take(len(piece.triangles))
        if len(triangles) < len(piece.triangles):
            raise _other_faces(self._name, "it has fewer triangles")
        is_other = (triangles != piece.triangles).any(axis=1)
        if is_other.any():
            first = piece.first_triangle + int(is_other.argmax())
            raise _other_faces(self._name, f"triangle {first} is another one")
        corners = self._blocks.corners(triangles)
        if self._seams is not None:
            self._seams.add(piece.corners, triangles, corners)
        for start in range(0, len(corners), AT_ONCE):
            part = slice(start, start + AT_ONCE)
            self._measure(piece.corners[part], corners[part])

    def _measure(self, before: NDArray[np.floating], after: NDArray[np.floating]) -> None:
        a, b, c = before[:, 0:3], before[:, 3:6], before[:, 6:9]
        # Faces with a repeated corner are no part of the surface, wherever they are after.
        is_face = (a != b).any(axis=1) & (b != c).any(axis=1) & (c != a).any(axis=1)
        if not is_face.all():
            before, after = before[is_face], after[is_face]
        origin = self._bounds.origin
        first = before.reshape(-1, 3).astype(np.float64) - origin
        second = after.reshape(-1, 3).astype(np.float64) - origin
        faces = np.arange(len(first), dtype=np.int32).reshape(-1, 3)
        figures = core.surface_figures(first, second, faces)
        largest = max(self.figures[core.LARGEST_ANGLE], figures[core.LARGEST_ANGLE])
        self.figures += figures
        self.figures[core.LARGEST_ANGLE] = largest

    def check_seams(self, totals: Totals) -> None:
        """Raise UnsupportedError if facets that meet before do not meet after."""
        if self._seams is None:
            return
        left = self._seams.left_edges()
        if left is None or totals.edges is None:
            raise _other_faces(self._name, "facets that meet cannot be told")
        if left.boundary_edges != totals.edges.boundary_edges:
            raise _other_faces(self._name, "facets that meet before are apart after")


def _volume_and_area(totals: Totals, change: SurfaceChange) -> tuple[Volume, Area, dict[str, bool]]:
    """The volumes that are enclosed, the areas, and whether before and after are inside out."""
    objection = totals.volume_objection
    sides = {
        "before": totals.is_inside_out,
        "after": not objection and is_negative(change.volume_after, change.area_after),
    }
    sign = -1.0 if sides["before"] else 1.0
    volume = changes.volume_changed(
        sign * change.volume_before, sign * change.volume_after, change.area_before, objection
    )
    return volume, changes.area_changed(change.area_before, change.area_after), sides


def _other_faces(name: str, why: str) -> UnsupportedError:
    return UnsupportedError(
        f"the faces are not those of the reference ({why}), and distances between surfaces that "
        "are larger than memory are not measured",
        path=name,
        hint="compare files with the same faces, such as the input and the output of msal "
        "denoise, or use a machine with more memory",
    )
