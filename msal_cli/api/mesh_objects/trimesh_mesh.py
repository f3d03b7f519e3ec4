"""``trimesh.Trimesh``."""

from __future__ import annotations

from typing import Any

from msal_cli.api.memory_mesh import Array, MemoryMesh, from_arrays, scalar_properties
from msal_cli.errors import UnsupportedError


def read(mesh: Any) -> MemoryMesh:
    """The mesh; the copy keeps colours, UVs, attributes and metadata, and trimesh makes its normals
    anew."""
    if any(one.__module__ == "trimesh.primitives" for one in type(mesh).__mro__):
        raise UnsupportedError(
            "the vertices of a trimesh.primitives object cannot be replaced",
            hint="give mesh.to_mesh()",
        )

    def copy_with(vertices: Array) -> Any:
        copy = mesh.copy()
        copy.vertices = vertices
        return copy

    properties = scalar_properties(mesh.vertex_attributes, len(mesh.vertices))
    return from_arrays(mesh.vertices, mesh.faces, "Trimesh", properties, copy_with)
