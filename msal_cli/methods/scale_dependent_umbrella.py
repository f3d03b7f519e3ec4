"""Scale-dependent umbrella: Laplacian smoothing that allows for unequal edge lengths.

The umbrella operator takes all edges for equally long, and distorts a mesh of mixed triangle sizes.
Fujiwara's operator divides each edge e by its length l:

    L_i = (2 / E_i) sum(e_ik / l_ik),  E_i = sum(l_ik)
    dx_i = min(tau, t_i) L_i,  t_i = E_i / (2 sum(1 / l_ik))

L has the unit 1 / length, so the step tau is an area: ``time_step`` times the square of the mean
edge length.  A short edge allows only short steps: each vertex takes tau or its own limit t_i,
whichever is less; at the limit it goes to the mean of its neighbours with weights 1 / l, and no
step can overshoot.  On a regular mesh a time step of 0.25 does the same as ``umbrella`` with 0.5.
Where triangles are large it smooths less, and meshes of mixed sizes take more sweeps.

As with ``umbrella`` edges are smeared, the surface shrinks, and vertices slide, though less where
edge lengths differ.  Edges of length zero are left out.

Source: K. Fujiwara, Eigenvalues of Laplacians on a closed Riemannian manifold and its nets,
Proceedings of the AMS 123 (1995), 2585-2594; as a smoother: M. Desbrun, M. Meyer, P. Schroeder and
A. Barr, Implicit fairing of irregular meshes using diffusion and curvature flow, SIGGRAPH 1999.
"""

from msal_cli.kernels.umbrellas import ScaleDependentUmbrella
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import ScheduledRingParameters, ring_of, run


@dataclass(frozen=True)
class Parameters(ScheduledRingParameters):
    has_own_step = True

    iterations: int = fields.iterations(
        4,
        "sweeps over all vertices",
        "smoother, and smaller; under the multiscale schedule many lead back to the input",
    )
    time_step: float = fields.step(0.25, high=100.0)


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    time_step = parameters.time_step * mesh.mean_edge_length**2
    return run(
        mesh,
        parameters,
        lambda: ScaleDependentUmbrella(*ring_of(mesh, parameters.boundary), time_step),
        on_sweep,
    )
