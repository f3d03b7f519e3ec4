"""A mesh against another: vertex by vertex where they correspond, and surface against surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import (
    DisplacementStatistics,
    DistanceStatistics,
    displacement_statistics,
    distance_statistics,
)
from msal_cli.arrays import Floats, Ints
from msal_cli.errors import ResourceError, UnsupportedError
from msal_cli.kernels import array_files
from msal_cli.mesh import Mesh, PreparedMesh

ROUNDING = 4.0 * float(np.finfo(np.float64).eps)
"""Distances below this share of the coordinates are taken for none."""

AT_ONCE = 1 << 17
"""Points that are looked up at a time: the library answers with an object for each."""


def find_obstacle() -> str:
    """Why no nearest triangle can be found: the library is not installed, or its search tree would
    not fit into memory; empty where it can."""
    import importlib.util

    if array_files.are_used():
        return "they need a search tree, which does not fit into memory"
    is_installed = importlib.util.find_spec("fcpw") is not None
    return "" if is_installed else "they need the package fcpw (pip install fcpw)"


def distances_to_surface(points: Floats, surface: Mesh) -> Floats:
    """Distances (n,) from points (n, 3) to the nearest point of ``surface``, file units; errors as
    of ``build_scene``."""
    return nearest_on_surface(points, surface)[1]


def nearest_on_surface(points: Floats, surface: Mesh) -> tuple[Ints, Floats]:
    """The triangle of ``surface`` nearest to each of the points (n, 3), and its distance in file
    units, both (n,); errors as of ``build_scene``."""
    vertices, faces = surface.vertices, surface.faces
    # In single precision, coordinates of 1e25 would overflow when squared, and 1e-25 vanish.
    scale = max(float(np.abs(points).max(initial=0.0)), float(np.abs(vertices).max()))
    scene = build_scene(surface, scale)
    import fcpw

    triangles = np.empty(len(points), dtype=np.int32)
    distances = np.empty(len(points))
    for start in range(0, len(points), AT_ONCE):
        some = points[start : start + AT_ONCE]
        end = start + len(some)
        found = fcpw.interaction_3D_list()
        reach = np.full(len(some), np.inf, dtype=np.float32)
        scene.find_closest_points(single(some, scale), reach, found)
        nearest = np.fromiter((hit.primitive_index for hit in found), np.int32, len(some))
        triangles[start:end] = nearest
        distances[start:end] = distances_to_triangles(some, vertices[faces[nearest]])
    # What lies on the surface is off by the last digits of its coordinates.
    distances[distances < ROUNDING * scale] = 0.0
    return triangles, distances


def build_scene(surface: Mesh, scale: float) -> Any:
    """The library's search tree over a mesh, whose coordinates are divided by ``scale``.

    Raises
    ------
    UnsupportedError
        with code ``E_NO_LIBRARY`` where FCPW is not installed.
    ResourceError
        where the tree would not fit into memory.
    """
    if array_files.are_used():
        raise ResourceError(
            "distances to a surface and rays need a search tree, which does not fit into memory",
            code="E_MEMORY",
            hint="use a machine with more memory",
        )
    try:
        import fcpw
    except ImportError:
        raise UnsupportedError(
            "distances to a surface and rays need the package fcpw, which is not installed",
            code="E_NO_LIBRARY",
            hint="install it with pip install fcpw; where it has no wheel it must be built",
        ) from None
    scene = fcpw.scene_3D()
    scene.set_object_count(1)
    scene.set_object_vertices(single(surface.vertices, scale), 0)
    scene.set_object_triangles(np.asfortranarray(surface.faces), 0)
    scene.build(fcpw.aggregate_type.bvh_surface_area, True)
    return scene


def single(positions: Floats, scale: float) -> NDArray[np.float32]:
    """Positions divided by ``scale``, as the library takes them."""
    return np.asfortranarray(positions / scale, dtype=np.float32)


def distances_to_triangles(points: Floats, corners: Floats) -> Floats:
    """Distances (n,) from points (n, 3) each to its own triangle, (n, 3, 3).

    The nearest point lies on one of the edges, or within where the foot of the point on the plane
    does.  Triangles without area are their edges.
    """
    best = np.full(len(points), np.inf)
    first, second, third = corners[:, 0], corners[:, 1], corners[:, 2]
    normals = np.cross(second - first, third - first)
    squared = _dot_rows(normals, normals)
    within = squared > 0.0
    for start, end in ((first, second), (second, third), (third, first)):
        edge, offset = end - start, points - start
        length = _dot_rows(edge, edge)
        share = _dot_rows(offset, edge) / np.where(length > 0.0, length, 1.0)
        rest = offset - np.clip(share, 0.0, 1.0)[:, None] * edge
        np.minimum(best, _dot_rows(rest, rest), out=best)
        within &= _dot_rows(np.cross(edge, offset), normals) >= 0.0
    height = _dot_rows(points - first, normals)
    flat = height * height / np.where(squared > 0.0, squared, 1.0)
    return np.sqrt(np.where(within, np.minimum(flat, best), best))


def _dot_rows(first: Floats, second: Floats) -> Floats:
    products: Floats = np.einsum("ij,ij->i", first, second)
    return products


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


def vertex_error_percent(reference: Mesh, statistics: DisplacementStatistics) -> float:
    """Mean distance between corresponding vertices in % of the reference's mean edge length."""
    return 100.0 * statistics.mean / reference.mean_edge_length


def displacement_of_moved(before: Mesh, after: Mesh) -> DisplacementStatistics:
    """How far the vertices that faces use are apart in two meshes with the same faces."""
    return displacement_statistics(before.vertices, after.vertices, before.topology.has_ring)


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
    what lies between them might be a little further away.  Errors as of ``build_scene``.
    """
    figures, largest = [], 0.0
    for points_of, surface in ((after, before), (before, after)):
        vertices = used_vertices(points_of)
        centres = points_of.vertices[points_of.faces].mean(axis=1)
        lengths = distances_to_surface(np.concatenate([vertices, centres]), surface)
        figures.append(distance_statistics(lengths[: len(vertices)]))
        largest = max(largest, float(lengths.max()))
    return figures[0], figures[1], largest
