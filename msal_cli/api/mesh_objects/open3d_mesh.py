"""``open3d.geometry.TriangleMesh`` and ``open3d.t.geometry.TriangleMesh``."""

from __future__ import annotations

from typing import Any

import numpy as np

from msal_cli.api.memory_mesh import (
    Array,
    MemoryMesh,
    from_arrays,
    renewed_normals,
    scalar_properties,
)


def read(mesh: Any) -> MemoryMesh:
    """The mesh; the copy keeps colours, UVs and textures, and normals follow the surface."""
    return _read_tensors(mesh) if hasattr(mesh, "vertex") else _read_legacy(mesh)


def _read_legacy(mesh: Any) -> MemoryMesh:
    triangles = np.asarray(mesh.triangles)

    def copy_with(vertices: Array) -> Any:
        copy = type(mesh)(mesh)
        copy.vertices = type(mesh.vertices)(vertices)
        if mesh.has_vertex_normals():
            normals = renewed_normals(memory, vertices, triangles, np.asarray(mesh.vertex_normals))
            copy.vertex_normals = type(mesh.vertex_normals)(normals)
        if mesh.has_triangle_normals():
            stored = np.asarray(mesh.triangle_normals)
            normals = renewed_normals(memory, vertices, _own_entries(triangles), stored)
            copy.triangle_normals = type(mesh.triangle_normals)(normals)
        return copy

    vertices = np.array(mesh.vertices)
    memory = from_arrays(vertices, triangles, "TriangleMesh", copy_with=copy_with)
    return memory


def _read_tensors(mesh: Any) -> MemoryMesh:
    vertex = {name: mesh.vertex[name] for name in mesh.vertex}
    triangles = mesh.triangle["indices"].cpu().numpy()

    def renew(data: Any, vertices: Array, entries: Array) -> None:
        if "normals" in data:
            stored = data["normals"]
            values = renewed_normals(memory, vertices, entries, stored.cpu().numpy())
            data["normals"] = type(stored)(values, stored.dtype, stored.device)

    def copy_with(vertices: Array) -> Any:
        copy = mesh.clone()
        stored = vertex["positions"]
        copy.vertex["positions"] = type(stored)(vertices, stored.dtype, stored.device)
        renew(copy.vertex, vertices, triangles)
        renew(copy.triangle, vertices, _own_entries(triangles))
        return copy

    arrays = {name: tensor.cpu().numpy() for name, tensor in vertex.items()}
    positions = arrays["positions"]
    properties = scalar_properties(arrays, len(positions))
    memory = from_arrays(positions, triangles, "TriangleMesh", properties, copy_with)
    return memory


def _own_entries(triangles: Array) -> Array:
    """Each triangle's own normal at all its corners (m, 3)."""
    return np.repeat(np.arange(len(triangles))[:, None], 3, axis=1)
