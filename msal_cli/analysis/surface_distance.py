"""A mesh against another: vertex by vertex where they correspond, and surface against surface."""

from __future__ import annotations

import numpy as np

from msal_cli.analysis.measures import DistanceStatistics, distance_statistics
from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.nearest_triangles import find_nearest_triangles
from msal_cli.mesh import Mesh, PreparedMesh

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Distances below this share of the coordinates are taken for none."""


MIN_SCALE, MAX_SCALE = 1e-50, 1e50
"""Coordinates outside are divided by the greatest: their sixth powers would vanish or overflow."""

MAX_POINTS = 4_000_000
"""Vertices and face centres of a mesh up to which the distances of all are measured."""

SAMPLED_POINTS = 1_000_000
"""How many are measured of more: every fifth, sixth and so on, evenly spread over the file."""


def distances_to_surface(points: Floats, surface: Mesh) -> Floats:
    """Distances (n,) from points (n, 3) to the nearest point of ``surface``, file units."""
    return nearest_on_surface(points, surface)[1]


def nearest_on_surface(points: Floats, surface: Mesh) -> tuple[Ints, Floats]:
    """The triangle of ``surface`` nearest to each of the points (n, 3), and its distance in file
    units, both (n,)."""
    scale = max(float(np.abs(points).max(initial=0.0)), float(np.abs(surface.vertices).max()))
    vertices, unit = surface.vertices, 1.0
    if scale and not MIN_SCALE < scale < MAX_SCALE:
        points, vertices, unit = points / scale, vertices / scale, scale
    triangles, distances = find_nearest_triangles(points, vertices, surface.faces)
    distances *= unit
    # What lies on the surface is off by the last digits of its coordinates.
    distances[distances < ROUNDING * scale] = 0.0
    return triangles, distances


def at_other_positions(ready: PreparedMesh, vertices: Floats) -> Mesh:
    """The prepared mesh with its vertices where ``vertices`` (n_file, 3) of another file are.

    Of file vertices that are one in the mesh the first counts; see ``PreparedMesh.seam_gap``.
    """
    if ready.vertex_map is None:
        return ready.mesh.with_vertices(vertices - ready.origin)
    positions = np.array(ready.mesh.vertices)
    # The first comes last, and so prevails.
    there = np.flatnonzero(ready.vertex_map >= 0)[::-1]
    positions[ready.vertex_map[there]] = vertices[there] - ready.origin
    return ready.mesh.with_vertices(positions)


def used_vertices(mesh: Mesh) -> Floats:
    """Positions (k, 3) of the vertices that faces use."""
    has_ring = mesh.topology.has_ring
    return mesh.vertices if has_ring.all() else mesh.vertices[has_ring]


def sampling_step(mesh: Mesh) -> int:
    """Every which vertex and face centre of a mesh ``surface_distances`` looks at."""
    count = len(mesh.vertices) + len(mesh.faces)
    return 1 if count <= MAX_POINTS else -(-count // SAMPLED_POINTS)


def surface_distances(
    before: Mesh, after: Mesh
) -> tuple[DistanceStatistics, DistanceStatistics, float]:
    """Distances of ``after``'s vertices to ``before``'s surface, the other way round, and the
    Hausdorff distance, file units; both meshes are about one origin.

    The Hausdorff distance is taken over the vertices and the centres of the faces of both meshes:
    what lies between them might be a little further away.  Of large meshes they are those of a
    sample, see ``sampling_step``.
    """
    figures, largest = [], 0.0
    for points_of, surface in ((after, before), (before, after)):
        step = sampling_step(points_of)
        vertices = used_vertices(points_of)[::step]
        centres = points_of.vertices[points_of.faces[::step]].mean(axis=1)
        lengths = distances_to_surface(np.concatenate([vertices, centres]), surface)
        figures.append(distance_statistics(lengths[: len(vertices)]))
        largest = max(largest, float(lengths.max()))
    return figures[0], figures[1], largest
