"""``meshio.Mesh``."""

from __future__ import annotations

from typing import Any

import numpy as np

from msal_cli.api.memory_mesh import (
    Array,
    MemoryMesh,
    as_array,
    fan_triangles,
    from_arrays,
    renewed_normals,
    scalar_properties,
)
from msal_cli.errors import UnsupportedError

_KEPT = ("vertex", "line")
"""Cells that lie on the surface, and are kept: their corners move with it."""

_NORMALS = ("normal", "normals")
_COMPONENTS = ("nx", "ny", "nz")


def read(mesh: Any) -> MemoryMesh:
    """The mesh of all triangles, quads and polygons, which are cut into triangles for the
    mathematics only; the copy keeps all cells and data, and normals follow the surface."""
    blocks = []
    for block in mesh.cells:
        if block.type in ("triangle", "quad") or block.type.startswith("polygon"):
            rows = as_array(block.data, "faces").astype(np.int64, copy=False)
            sizes = np.full(len(rows), rows.shape[1], dtype=np.int64)
            blocks.append(fan_triangles(rows.reshape(-1), sizes)[0])
        elif block.type not in _KEPT:
            raise UnsupportedError(
                f"the meshio.Mesh has {len(block.data)} {block.type} cells",
                hint="msal denoises surfaces of triangles, quads and polygons of first order; "
                "extract the surface first",
            )
    triangles = np.concatenate(blocks) if blocks else np.empty((0, 3), dtype=np.int64)

    def copy_with(vertices: Array) -> Any:
        copy = mesh.copy()
        copy.points = vertices
        _renew(copy.point_data, memory, vertices, triangles)
        return copy

    properties = scalar_properties(mesh.point_data, len(mesh.points))
    memory = from_arrays(mesh.points, triangles, "meshio.Mesh", properties, copy_with)
    return memory


def _renew(data: dict[str, Any], mesh: MemoryMesh, vertices: Array, triangles: Array) -> None:
    """Replace the normals among the data of the points: an array (n, 3), or one per axis."""
    for name in data:
        values = np.asarray(data[name])
        if name.lower() in _NORMALS and values.shape == mesh.vertices.shape:
            data[name] = renewed_normals(mesh, vertices, triangles, values)
    if all(name in data for name in _COMPONENTS):
        stored = np.stack([np.asarray(data[name]) for name in _COMPONENTS], axis=1)
        renewed = renewed_normals(mesh, vertices, triangles, stored)
        data.update(zip(_COMPONENTS, renewed.T.copy(), strict=True))
