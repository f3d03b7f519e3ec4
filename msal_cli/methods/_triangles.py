"""Triangles made even within the surface, before a filter that moves vertices across it."""

from __future__ import annotations

from msal_cli.mesh import Mesh

STEP = 0.5
"""Share of the way to the mean of the neighbours, within the surface."""

MOLLIFY = 3
"""Passes that average the normals of the tangent planes."""


def even_out(mesh: Mesh, passes: int) -> Mesh:
    """The mesh with each vertex ``passes`` times half of the way to the mean of its one-ring,
    within the tangent plane of its averaged normal.

    Noise in all directions makes jagged triangles, across which normals err whatever the heights
    are.  Heights along the normal stay as they are, and so do vertices at open edges.
    """
    from msal_cli.kernels.geometry import slide

    if not passes:
        return mesh
    links = mesh.topology
    normals = mesh.vertex_normals("uniform", MOLLIFY)
    free = links.has_ring & ~links.boundary
    if mesh.fixed_vertices is not None:
        free &= ~mesh.fixed_vertices
    positions = mesh.vertices
    for _ in range(passes):
        positions = slide(positions, normals, free, STEP, *links.one_ring)
    return mesh.with_vertices(positions)
