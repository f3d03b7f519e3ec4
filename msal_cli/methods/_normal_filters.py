"""What filters of face normals share: parameters, the two stages, and their progress."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.vertex_update import updated_vertices
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result, parameter
from msal_cli.methods._sweeps import free_vertices

Floats = NDArray[np.float64]

OnPass = Callable[[], None]
"""Called after every pass over faces or vertices, and amid long ones; may end the run."""


@dataclass(frozen=True)
class NormalFilterParameters:
    """Parameters of a method that filters face normals and fits the vertices to them."""

    iterations: int = parameter(
        20,
        "passes over the face normals; 0 returns the mesh as it is",
        symbol="n",
        low=0,
        high=1000,
        more="smoother normals, larger flat pieces",
    )
    vertex_iterations: int = parameter(
        10,
        "passes that fit the vertices to the filtered normals",
        low=0,
        high=1000,
        more="faces closer to their normals, vertices farther from the scan",
    )
    neighbours: str = parameter(
        "vertex",
        "the neighbours of a face: those that share a vertex with it, or an edge",
        choices=("vertex", "edge"),
    )
    boundary: str = parameter(
        "fixed",
        "vertices at open edges: fixed, or fitted like the others to the faces that they have",
        choices=("fixed", "free"),
    )


def run(
    mesh: Mesh,
    parameters: NormalFilterParameters,
    filtered_normals: Callable[[OnPass], Floats],
    on_sweep: OnSweep | None,
    normal_passes: int | None = None,
) -> Result:
    """The two stages: ``filtered_normals`` gives the normals (m, 3) that the vertices then fit.

    ``filtered_normals`` calls its argument after each of its ``normal_passes``, by default
    ``iterations``.  Progress is told in iterations: each pass of either stage is an equal share
    of them.
    """
    total = parameters.iterations
    if not total:
        return Result(mesh.vertices.copy(), seconds={"normals": 0.0, "sweeps": 0.0})
    first = total if normal_passes is None else normal_passes
    done = 0

    def on_pass() -> None:
        nonlocal done
        done += 1
        if on_sweep is not None:
            on_sweep(total * done // (first + parameters.vertex_iterations), total)

    started = time.perf_counter()
    normals = filtered_normals(on_pass)
    ready = time.perf_counter()
    vertices = updated_vertices(
        mesh.vertices,
        normals,
        mesh.faces,
        mesh.links,
        free_vertices(mesh, parameters.boundary),
        parameters.vertex_iterations,
        on_pass,
    )
    finished = time.perf_counter()
    return Result(vertices, seconds={"normals": ready - started, "sweeps": finished - ready})
