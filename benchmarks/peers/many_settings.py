"""Many settings of one tool on many meshes, in one process.

    python many_settings.py TOOL JOBS.json SOURCE_FOLDER TARGET_FOLDER

TOOL is ``pymeshlab``, ``meshlib`` or ``vtk``.  JOBS.json holds, for each NAME.npz of the source
folder (arrays ``vertices`` (n, 3) and ``faces`` (m, 3)), a list of settings: a key, the name of a
filter of the tool, its parameters, and how many times it runs.  NAME.npz of the target folder then
has positions (n, 3) under each of the keys.
"""

import json
import os
import sys

import numpy as np


def run_pymeshlab(vertices, faces, name, parameters, times):
    """A filter of PyMeshLab by its name."""
    import pymeshlab

    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(vertices, faces))
    for _ in range(times):
        meshes.apply_filter(name, **parameters)
    return meshes.current_mesh().vertex_matrix()


def run_meshlib(vertices, faces, name, parameters, times):
    """``meshDenoiseViaNormals`` with its settings, or one of the relaxations with theirs."""
    from meshlib import mrmeshnumpy, mrmeshpy

    mesh = mrmeshnumpy.meshFromFacesVerts(faces, vertices)
    is_denoising = name == "meshDenoiseViaNormals"
    settings = mrmeshpy.DenoiseViaNormalsSettings() if is_denoising else mrmeshpy.MeshRelaxParams()
    for word, value in parameters.items():
        setattr(settings, word, value)
    for _ in range(times):
        getattr(mrmeshpy, name)(mesh, settings)
    # Copies of non-manifold vertices come last.
    return mrmeshnumpy.getNumpyVerts(mesh)[: len(vertices)]


def run_vtk(vertices, faces, name, parameters, times):
    """A filter of surfaces, with its setters."""
    from vtkmodules import vtkFiltersCore
    from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData

    points, cells, surface = vtkPoints(), vtkCellArray(), vtkPolyData()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(vertices, deep=True))
    offsets = np.arange(0, 3 * len(faces) + 1, 3, dtype=np.int64)
    corners = np.ascontiguousarray(faces.reshape(-1), dtype=np.int64)
    cells.SetData(
        numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(corners, deep=True)
    )
    surface.SetPoints(points)
    surface.SetPolys(cells)
    for _ in range(times):
        smoother = getattr(vtkFiltersCore, name)()
        for word, value in parameters.items():
            getattr(smoother, f"Set{word}")(value)
        smoother.SetInputData(surface)
        smoother.Update()
        surface = smoother.GetOutput()
    return vtk_to_numpy(surface.GetPoints().GetData())


TOOLS = {"pymeshlab": run_pymeshlab, "meshlib": run_meshlib, "vtk": run_vtk}


def main(tool, jobs, source, target):
    """Every job of the file."""
    with open(jobs, encoding="utf-8") as stream:
        rows = json.load(stream)
    for mesh, settings in rows.items():
        arrays = np.load(os.path.join(source, mesh + ".npz"))
        results = {}
        for key, name, parameters, times in settings:
            moved = TOOLS[tool](arrays["vertices"], arrays["faces"], name, parameters, times)
            if moved.shape != arrays["vertices"].shape:
                raise ValueError(f"{mesh}, {key}: {len(moved)} vertices")
            results[key] = np.array(moved, dtype=np.float64)
        np.savez(os.path.join(target, mesh + ".npz"), **results)


if __name__ == "__main__":
    main(*sys.argv[1:])
