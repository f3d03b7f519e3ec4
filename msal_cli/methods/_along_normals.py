"""What the methods that move vertices along fixed normals share: parameters and the run."""

from __future__ import annotations

import time
from dataclasses import dataclass

from msal_cli.core.operators import AnisotropicLaplacian
from msal_cli.core.schedules import Schedule
from msal_cli.core.sweeps import swept
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result, parameter


@dataclass(frozen=True)
class NormalParameters:
    """Parameters of a sweep along normals; every default is free of scale."""

    iterations: int = parameter(
        4,
        "sweeps over all vertices",
        symbol="n",
        low=0,
        high=1000,
        more="smoother (with al); msal comes back to the input after many",
    )
    mollify: int = parameter(
        1,
        "passes that average the normals over the one-ring before the first sweep",
        low=0,
        high=100,
        more="smoother normals: flatter flats under heavy noise, softer edges",
    )
    normals: str = parameter(
        "uniform",
        "how face normals count in a vertex normal: alike, or by face area",
        choices=("uniform", "area"),
    )
    boundary: str = parameter(
        "free",
        "vertices at open edges: filtered like the others with the neighbours they have, or fixed",
        choices=("free", "fixed"),
    )


def swept_along_normals(
    mesh: Mesh, parameters: NormalParameters, schedule: Schedule, on_sweep: OnSweep | None
) -> Result:
    """Sweeps of the anisotropic Laplacian under ``schedule``; see ``core.sweeps.swept``.

    The result's field ``fidelity`` is lambda of the first sweep.
    """
    started = time.perf_counter()
    normals = mesh.vertex_normals(parameters.normals, parameters.mollify)
    links = mesh.links
    free = ~links.boundary if parameters.boundary == "fixed" else links.boundary | True
    operator = AnisotropicLaplacian(
        normals, links.ring_start, links.ring, free, mesh.mean_edge_length
    )
    ready = time.perf_counter()
    result = swept(mesh.vertices, operator, schedule, parameters.iterations, on_sweep)
    finished = time.perf_counter()
    return Result(
        result.vertices,
        fields={"fidelity": result.fidelity},
        seconds={"normals": ready - started, "sweeps": finished - ready},
    )
