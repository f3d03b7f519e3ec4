"""A mesh against another: vertex by vertex where they correspond, and surface against surface."""

from __future__ import annotations

import numpy as np

from msal_cli.analysis.measures import (
    DisplacementStatistics,
    DistanceStatistics,
    displacement_statistics,
    distance_statistics,
)
from msal_cli.analysis.surface_distance import distances_to_surface
from msal_cli.arrays import Floats, Ints
from msal_cli.mesh import Mesh, PreparedMesh


def have_same_faces(
    vertices: Floats, faces: Ints, other_vertices: Floats, other_faces: Ints
) -> bool:
    """Whether two files have as many vertices and the very same faces, in the same order."""
    return len(vertices) == len(other_vertices) and np.array_equal(faces, other_faces)


def at_other_positions(ready: PreparedMesh, vertices: Floats) -> Mesh:
    """The prepared mesh with its vertices where ``vertices`` (n_file, 3) of another file are.

    Of file vertices that are one in the mesh the first counts; see ``Prepared.seam_gap``.
    """
    if ready.vertex_map is None:
        return ready.mesh.with_vertices(vertices - ready.origin)
    positions = np.array(ready.mesh.vertices)
    # The first comes last, and so prevails.
    there = np.flatnonzero(ready.vertex_map >= 0)[::-1]
    positions[ready.vertex_map[there]] = vertices[there] - ready.origin
    return ready.mesh.with_vertices(positions)


def vertex_error_percent(reference: Mesh, statistics: DisplacementStatistics) -> float:
    """Mean distance between corresponding vertices in % of the reference's mean edge length."""
    return 100.0 * statistics.mean / reference.mean_edge_length


def displacement_of_moved(before: Mesh, after: Mesh) -> DisplacementStatistics:
    """How far the vertices that faces use are apart in two meshes with the same faces."""
    return displacement_statistics(before.vertices, after.vertices, before.topology.has_ring)


def vertex_distances(before: Floats, after: Floats) -> Floats:
    """Distances (n,) between corresponding positions (n, 3)."""
    from msal_cli.kernels.geometry import distances

    return distances(before, after)


def used_vertices(mesh: Mesh) -> Floats:
    """Positions (k, 3) of the vertices that faces use."""
    has_ring = mesh.topology.has_ring
    return mesh.vertices if has_ring.all() else mesh.vertices[has_ring]


def surface_distances(
    before: Mesh, after: Mesh
) -> tuple[DistanceStatistics, DistanceStatistics, float]:
    """Distances of ``after``'s vertices to ``before``'s surface, the other way round, and the
    Hausdorff distance, file units; both meshes are about one origin.

    The Hausdorff distance is taken over the vertices and the centres of the faces of both meshes:
    what lies between them might be a little further away.

    Raises
    ------
    UnsupportedError
        with code ``E_NO_LIBRARY``; see ``surface_distance``.
    """
    figures, largest = [], 0.0
    for points_of, surface in ((after, before), (before, after)):
        vertices = used_vertices(points_of)
        centres = points_of.vertices[points_of.faces].mean(axis=1)
        lengths = distances_to_surface(np.concatenate([vertices, centres]), surface)
        figures.append(distance_statistics(lengths[: len(vertices)]))
        largest = max(largest, float(lengths.max()))
    return figures[0], figures[1], largest
