"""Anisotropic Laplacian (AL): fast smoothing along normals that spares sharp features.

Each sweep moves a vertex along its normal n by a weighted mean of the heights h of its one-ring
above its tangent plane:

    h_k = (x_k - x_i) . n_i
    sigma_i = 2 mean|h - mean h|                        eq. (4)
    g_k = exp(-h_k^2 / (2 sigma_i^2))
    d_i = sum(g h) / sum(g),  x_i <- x_i + tau d_i n_i  eq. (5), eq. (2) with lambda = 0

All vertices move at once from the same positions.  The normals are those of the input, mollified,
and are kept through all sweeps, so that no vertex drifts sideways.  A neighbour that stands far out
of the tangent plane hardly counts, which is what keeps edges.  Three or four sweeps are usual; each
further one smooths more and shrinks the surface a little more.  Where texture matters use ``msal``.

Where sigma is zero all heights are equal and d is their mean.  A vertex without neighbours, or
whose normal cannot be told, stays.  The cost of a sweep is proportional to the number of edges.

Source: H. Huang and U. Ascher, Fast denoising of surface meshes with intrinsic texture, Inverse
Problems 24 (2008), section 2.3.
"""

from __future__ import annotations

from dataclasses import dataclass

from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import ScheduledParameters, anisotropic_laplacian, run


@dataclass(frozen=True)
class Parameters(ScheduledParameters):
    """Parameters of the anisotropic Laplacian."""


def denoised(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep | None = None) -> Result:
    """AL of ``mesh``; see the module's description."""
    return run(
        mesh,
        parameters,
        lambda: anisotropic_laplacian(mesh, parameters),
        parameters.chosen_schedule(),
        on_sweep,
    )
