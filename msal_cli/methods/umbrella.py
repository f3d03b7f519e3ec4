"""Umbrella operator: plain Laplacian smoothing, each vertex towards the mean of its one-ring.

Averaging removes the highest frequencies first:

    dx_i = (1 / m_i) sum(x_k - x_i)                     eq. (3)
    x_i <- x_i + tau dx_i + lambda_i (v_i - x_i)        eq. (2)

over the m_i neighbours of vertex i, all vertices at once.  The paper's text takes tau = 1; the
default here is half of that, as is usual, because a full step makes the finest wave on a regular
mesh oscillate instead of removing it.

It is the yardstick, not the tool of choice: it smears edges, shrinks the surface with every sweep,
and slides vertices sideways.  Under ``schedule=multiscale`` lambda is measured from the heights of
eq. (4), as in ``msal``.

Degenerate faces count with their edges.

Source: G. Taubin, A signal processing approach to fair surface design, SIGGRAPH 1995, 351-358; eq.
(3) of H. Huang and U. Ascher, Inverse Problems 24 (2008).
"""

from msal_cli.kernels.umbrellas import Umbrella
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import ScheduledRingParameters, ring_of, run


@dataclass(frozen=True)
class Parameters(ScheduledRingParameters):
    iterations: int = fields.iterations(
        3,
        "sweeps over all vertices",
        "smoother, and smaller; under the multiscale schedule many lead back to the input",
    )
    time_step: float = fields.share(
        0.5,
        "share of the way to the mean of the neighbours; 1 in the paper's text",
        "smoother",
        symbol="tau",
        above=0.0,
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    return run(mesh, parameters, lambda: Umbrella(*ring_of(mesh, parameters.boundary)), on_sweep)
