"""``pyvista.PolyData``."""

from __future__ import annotations

from typing import Any

import numpy as np

from msal_cli.api.memory_mesh import (
    Array,
    MemoryMesh,
    fan_triangles,
    from_arrays,
    renewed_normals,
    scalar_properties,
)
from msal_cli.arrays import Longs
from msal_cli.errors import UnsupportedError


def read(mesh: Any) -> MemoryMesh:
    """The mesh, its polygons cut into triangles for the mathematics only; the copy keeps all
    arrays, and normals follow the surface."""
    counts = {"lines": mesh.n_lines, "vertices": mesh.n_verts, "strips": mesh.n_strips}
    others = ", ".join(f"{n} {name}" for name, n in counts.items() if n)
    if others:
        raise UnsupportedError(
            f"the PolyData has cells that are no faces: {others}",
            hint="give its faces alone: pyvista.PolyData(mesh.points, mesh.faces); "
            "mesh.triangulate() makes faces of strips",
        )
    triangles, polygon_of = fan_triangles(*_split(np.asarray(mesh.faces, dtype=np.int64)))

    def copy_with(vertices: Array) -> Any:
        copy = mesh.copy(deep=True)
        copy.points = vertices
        of_cells = np.repeat(polygon_of[:, None], 3, axis=1)
        for data, entries in ((copy.point_data, triangles), (copy.cell_data, of_cells)):
            name = data.active_normals_name
            if name is not None:
                data[name] = renewed_normals(memory, vertices, entries, np.asarray(data[name]))
        return copy

    properties = scalar_properties(dict(mesh.point_data.items()), mesh.n_points)
    memory = from_arrays(np.asarray(mesh.points), triangles, "PolyData", properties, copy_with)
    return memory


def _split(faces: Longs) -> tuple[Longs, Longs]:
    """Corners (c,) and sizes (p,) of polygons that follow each other as ``[size, corners...]``."""
    if not len(faces):
        return faces, faces
    size = int(faces[0])
    if len(faces) % (size + 1) == 0 and (faces[:: size + 1] == size).all():
        rows = faces.reshape(-1, size + 1)
        return rows[:, 1:].reshape(-1), rows[:, 0]
    starts, at = [], 0
    values = faces.tolist()
    while at < len(values):
        starts.append(at)
        at += values[at] + 1
    is_corner = np.ones(len(faces), dtype=np.bool_)
    is_corner[starts] = False
    return faces[is_corner], faces[starts]
