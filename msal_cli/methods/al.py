"""Anisotropic Laplacian (AL): fast smoothing along normals that spares sharp features.

Each sweep moves a vertex along its normal n by a weighted mean of the heights h of its one-ring
above its tangent plane:

    h_k = (x_k - x_i) . n_i
    sigma_i = 2 mean|h - mean h|                        eq. (4)
    g_k = exp(-h_k^2 / (2 sigma_i^2))
    d_i = sum(g h) / sum(g),  x_i <- x_i + tau d_i n_i  eq. (5), eq. (2) with lambda = 0

All vertices move at once.  The normals are those of the input, mollified and kept, so that no
vertex drifts sideways.  A neighbour far from the tangent plane counts less, which keeps edges: one
of six with a weight of 0.2, two with 0.5, however far.  Three or four sweeps are usual; up to eight
smooth more, and shrink; then folds grow.  Where texture matters use ``msal``.

Not in the paper: ``weights``, each kind scaled so that its influence h g(h) is greatest at sigma.
Gauss, Tukey and Lorentz keep edges about alike, Huber less; ``none`` is the umbrella along the
normals.  ``deviation=median`` takes sigma = 1.4826 median|h - median h|: sharper edges under weak
noise, but strong noise is taken for features.

On mixed triangle sizes vertices beside large triangles move faster.  Section 4.3 scales by the
lumped mass A/3, A the area of the faces around the vertex, or by edge lengths l:

    scaling=mass    dx = d n / (A / 3)
    scaling=edge    dx = sum(g h / l) / sum(g l) n

Both have the unit 1 / length, so tau is an area: ``scaled_step`` times the square of the mean edge
length, or the vertex's limit of stability, A/3 or sum(g l) / sum(g / l), if that is smaller.
Take about 8 sweeps.  ``msal`` does without, at less cost, unless sizes differ a lot.

Where sigma is zero d is the mean of the heights; by the median the flattest count.  Where every
neighbour is beyond Tukey's reach all count alike.

Source: H. Huang and U. Ascher, Inverse Problems 24 (2008), sections 2.3 and 4.3; weights after M.
Black, G. Sapiro, D. Marimont and D. Heeger, Robust anisotropic diffusion, IEEE TIP 7 (1998),
421-432.
"""

from msal_cli.kernels.operators import SCALINGS
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import HeightParameters, ScheduledParameters, height_operator, run


@dataclass(frozen=True)
class Parameters(ScheduledParameters, HeightParameters):
    scaling: str = fields.parameter(
        "none",
        "for meshes of mixed triangle sizes: steps by the area around a vertex, or by edge lengths",
        choices=SCALINGS,
    )
    scaled_step: float = fields.step(
        0.25,
        "with a scaling: the time step; vertices with a smaller limit of stability take that",
        symbol="c",
        high=100.0,
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    time_step = parameters.scaled_step * mesh.mean_edge_length**2
    return run(
        mesh,
        parameters,
        lambda: height_operator(mesh, parameters, parameters.scaling, time_step),
        on_sweep,
    )
