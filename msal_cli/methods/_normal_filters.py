"""What filters of face normals share: parameters, the two stages, and their progress."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from msal_cli.arrays import Floats
from msal_cli.kernels.vertex_update import updated_vertices
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result, parameter
from msal_cli.methods._sliding import sliding_parameter, undo_sliding
from msal_cli.methods._sweeps import free_vertices


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
    sliding: str = sliding_parameter()


@dataclass()
class Passes:
    """Progress of a run: its passes of either kind are equal shares of ``iterations``.

    What ``on_sweep`` raises ends the run.
    """

    on_sweep: OnSweep | None
    iterations: int
    passes: int
    done: int = field(default=0, init=False)

    def passed(self) -> None:
        """One more pass is done."""
        self.done += 1
        self.going_on()

    def going_on(self) -> None:
        """Still within the same pass: time to look for an interruption."""
        if self.on_sweep is not None:
            self.on_sweep(self.iterations * self.done // self.passes, self.iterations)


def run(
    mesh: Mesh,
    parameters: NormalFilterParameters,
    filtered_normals: Callable[[Passes], Floats],
    on_sweep: OnSweep | None,
    normal_passes: int | None = None,
) -> Result:
    """The two stages: ``filtered_normals`` gives the normals (m, 3) that the vertices then fit.

    It tells its argument of each of its ``normal_passes``, by default ``iterations``.
    """
    if not parameters.iterations:
        return Result(mesh.vertices.copy(), seconds={"normals": 0.0, "sweeps": 0.0})
    if normal_passes is None:
        normal_passes = parameters.iterations
    passes = Passes(on_sweep, parameters.iterations, normal_passes + parameters.vertex_iterations)
    started = time.perf_counter()
    normals = filtered_normals(passes)
    ready = time.perf_counter()
    vertices = updated_vertices(
        mesh.vertices,
        normals,
        mesh.faces,
        mesh.topology,
        free_vertices(mesh, parameters.boundary),
        parameters.vertex_iterations,
        passes.passed,
    )
    vertices = undo_sliding(mesh, vertices, parameters.sliding, parameters.boundary)
    finished = time.perf_counter()
    return Result(vertices, seconds={"normals": ready - started, "sweeps": finished - ready})
