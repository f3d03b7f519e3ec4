"""The common part of filters of face normals: parameters, the two stages, and their progress."""

from collections.abc import Callable
from functools import partial
from typing import Any

from msal_cli.arrays import Floats
from msal_cli.kernels.vertex_update import update_vertices
from msal_cli.light_dataclass import dataclass, field
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._sliding import undo_sliding
from msal_cli.methods._sweeps import free_vertices


@dataclass(frozen=True)
class NormalFilterParameters:
    """Parameters of a method that filters face normals and fits the vertices to them."""

    iterations: int = fields.iterations(
        20,
        "passes over the face normals; 0 returns the mesh as it is",
        "smoother normals, larger flat pieces",
    )
    vertex_iterations: int = fields.vertex_passes(10)
    neighbours: str = fields.parameter(
        "vertex",
        "the neighbours of a face: those that share a vertex with it, or an edge",
        choices=("vertex", "edge"),
    )
    boundary: str = fields.boundary("fixed")
    sliding: str = fields.sliding()


@dataclass()
class Passes:
    """Progress of a run: passes over normals and vertices are equal shares of ``iterations``.

    An exception that ``on_sweep`` raises ends the run.
    """

    on_sweep: OnSweep
    iterations: int
    passes: int
    done: int = field(default=0, init=False)

    def count_pass(self) -> None:
        self.done += 1
        self.on_step()

    def on_step(self) -> None:
        """Report progress within a pass, where the caller may raise an exception to end the run."""
        self.on_sweep(self.iterations * self.done // self.passes, self.iterations)


def run(
    mesh: Mesh,
    parameters: NormalFilterParameters,
    filtered_normals: Callable[[Passes], Floats],
    on_sweep: OnSweep,
    normal_passes: int | None = None,
) -> Result:
    """Run both stages: ``filtered_normals`` returns normals (m, 3), and vertices are fitted.

    It counts each of its ``normal_passes``, ``iterations`` by default, on its argument.
    """
    if not parameters.iterations:
        return Result(mesh.vertices.copy(), seconds={"normals": 0.0, "sweeps": 0.0})
    if normal_passes is None:
        normal_passes = parameters.iterations
    passes = Passes(on_sweep, parameters.iterations, normal_passes + parameters.vertex_iterations)
    timer = Timer()
    normals = filtered_normals(passes)
    timer.start_sweeps()
    vertices = update_vertices(
        mesh.vertices,
        normals,
        mesh.faces,
        mesh.topology,
        free_vertices(mesh, parameters.boundary),
        parameters.vertex_iterations,
        passes.count_pass,
    )
    vertices = undo_sliding(mesh, vertices, parameters.sliding, parameters.boundary)
    return timer.finish(vertices)


def run_rounds(
    mesh: Mesh,
    parameters: Any,
    filtered_normals: Callable[[Floats, Callable[[], None]], Floats],
    on_sweep: OnSweep,
    timer: Timer,
) -> Result:
    """Run ``iterations`` rounds: normals (m, 3) from positions (n, 3), and vertices fitted to them.

    The second argument of ``filtered_normals`` reports progress, where the caller may raise an
    exception to end the run.
    """
    free = free_vertices(mesh, parameters.boundary)
    timer.start_sweeps()
    positions = mesh.vertices.copy()
    for done in range(parameters.iterations):
        on_step = partial(on_sweep, done, parameters.iterations)
        positions = update_vertices(
            positions,
            filtered_normals(positions, on_step),
            mesh.faces,
            mesh.topology,
            free,
            parameters.vertex_iterations,
            on_step,
        )
        on_sweep(done + 1, parameters.iterations)
    if parameters.iterations:
        positions = undo_sliding(mesh, positions, parameters.sliding, parameters.boundary)
    return timer.finish(positions)
