"""What AL and MSAL share: the choice of weights and scales in eqs. (4) and (5)."""

from __future__ import annotations

from dataclasses import dataclass

from msal_cli.kernels.operators import DEVIATIONS, WEIGHTS, Operator, RobustLaplacian
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import parameter
from msal_cli.methods._sweeps import NormalParameters, anisotropic_laplacian, free_vertices


@dataclass(frozen=True)
class HeightParameters(NormalParameters):
    """Parameters of the anisotropic Laplacian and its variants."""

    weights: str = parameter(
        "gauss",
        "how the weight of a neighbour falls with its height: to nothing at a height (tukey), "
        "to almost nothing (gauss), slowly (lorentz, huber), or not at all (none)",
        choices=WEIGHTS,
    )
    deviation: str = parameter(
        "mean",
        "scale of the heights: 2 mean or 1.4826 median absolute deviations; the median keeps "
        "sharper edges under weak noise, and leaves strong noise in place",
        choices=DEVIATIONS,
    )


def height_operator(
    mesh: Mesh, parameters: HeightParameters, scaling: str = "none", time_step: float = 0.0
) -> Operator:
    """The operator of eq. (5) with the chosen weights and scales.

    ``scaling`` is that of section 4.3, with ``time_step`` in squared file units.
    """
    chosen = (parameters.weights, parameters.deviation, scaling)
    if chosen == ("gauss", "mean", "none"):
        return anisotropic_laplacian(mesh, parameters)
    return RobustLaplacian(
        mesh.vertex_normals(parameters.normals, parameters.mollify),
        mesh.faces,
        mesh.topology,
        free_vertices(mesh, parameters.boundary),
        mesh.mean_edge_length,
        *chosen,
        time_step,
    )
