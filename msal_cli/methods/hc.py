"""HC algorithm: Laplacian smoothing whose shrinkage is pushed back by the neighbourhood.

Each iteration moves every vertex to the mean of its one-ring, measures the displacement from its
scanned and previous positions, averages it over the neighbourhood, and subtracts that:

    p_i = (1 / m_i) sum(q_k)
    b_i = p_i - (alpha o_i + (1 - alpha) q_i)
    q_i <- p_i - (beta b_i + (1 - beta) (1 / m_i) sum(b_k))

with o the scanned and q the previous positions, all vertices at once.  The common part of
neighbouring displacements is shape and is restored, the rest is noise and is removed.  beta above
one half makes the iteration converge; alpha above zero keeps texture.  It does well on organic
shapes and fine texture where angles matter.  It knows no edges, and vertices slide along the
surface, farther than after ``al`` or ``msal``.

An iteration costs two passes over the edges.

Source: J. Vollmer, R. Mencl and H. Mueller, Improved Laplacian smoothing of noisy surface meshes,
Computer Graphics Forum 18 (1999), 131-138.
"""

from msal_cli.kernels.umbrellas import hc_sweep
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._sliding import undo_sliding
from msal_cli.methods._sweeps import ring_of

BYTES_PER_FACE = 10


@dataclass(frozen=True)
class Parameters:
    iterations: int = fields.iterations(
        10, "times that all vertices are averaged and pushed back", "smoother"
    )
    alpha: float = fields.share(
        0.1,
        "share of the scanned position, against the previous one, in what is pushed back to",
        "closer to the input",
    )
    beta: float = fields.parameter(
        0.6,
        "share of a vertex's own correction, against its neighbours'; above 0.5 it converges",
        low=0.5,
        high=1.0,
        more="less is smoothed at each iteration",
    )
    boundary: str = fields.rim()
    sliding: str = fields.sliding()


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    timer = Timer()
    ring_start, ring = ring_of(mesh, parameters.boundary)
    timer.start_sweeps()
    positions = mesh.vertices.copy()
    for sweep in range(parameters.iterations):
        positions = hc_sweep(
            mesh.vertices, positions, ring_start, ring, parameters.alpha, parameters.beta
        )
        on_sweep(sweep + 1, parameters.iterations)
    return timer.finish(undo_sliding(mesh, positions, parameters.sliding))
