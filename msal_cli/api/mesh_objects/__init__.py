"""Meshes of other libraries, known by their classes alone: none of these libraries is imported.

Each has a module here with a function ``read(mesh) -> MemoryMesh``.
"""

from __future__ import annotations

import importlib
from typing import Any

from msal_cli.api.memory_mesh import MemoryMesh
from msal_cli.errors import UnsupportedError, UsageError

_READERS = {
    ("trimesh", "Trimesh"): "trimesh_mesh",
    ("pyvista", "PolyData"): "pyvista_mesh",
    ("meshio", "Mesh"): "meshio_mesh",
    ("open3d", "TriangleMesh"): "open3d_mesh",
}
"""The module for each class, by the package that it is of and its name."""

_INSTEAD = {
    ("trimesh", "Scene"): "scene.to_mesh(), or one of scene.geometry",
    ("trimesh", "PointCloud"): "a mesh made of the points",
    ("pyvista", "DataSet"): "dataset.extract_surface()",
    ("pyvista", "MultiBlock"): "one of its blocks, as PolyData",
    ("vtkmodules", "vtkPolyData"): "pyvista.wrap(mesh)",
    ("vtkmodules", "vtkDataObject"): "its surface, as pyvista.PolyData",
    ("open3d", "PointCloud"): "a mesh made of the points",
    ("open3d", "Geometry"): "an open3d.geometry.TriangleMesh",
}
"""What to give in place of other classes of these packages."""


def read_object(mesh: Any) -> MemoryMesh:
    """The mesh of an object of trimesh, pyvista, meshio or open3d.

    Raises
    ------
    UnsupportedError
        for another class of these packages, or cells that are no faces.
    UsageError
        for anything else.
    """
    names = [(one.__module__.partition(".")[0], one.__name__) for one in type(mesh).__mro__]
    for name in names:
        if name in _READERS:
            module = importlib.import_module(f"{__name__}.{_READERS[name]}")
            found: MemoryMesh = module.read(mesh)
            return found
    for name in names:
        if name in _INSTEAD:
            raise UnsupportedError(
                f"a {'.'.join(names[0])} is not denoised", hint=f"give {_INSTEAD[name]}"
            )
    if isinstance(mesh, str | bytes) or hasattr(mesh, "__fspath__"):
        raise UsageError(
            f"{mesh!r} is a path, not a mesh", hint="denoise_file and denoise_folder read files"
        )
    raise UsageError(
        f"a {type(mesh).__name__} alone is no mesh",
        hint="give vertices (n, 3) and faces (m, 3), or an object of trimesh, pyvista, meshio or "
        "open3d",
    )
