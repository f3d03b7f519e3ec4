"""Anisotropic diffusion of normals: sharp edges kept, and flat and round parts alike made smooth.

The normals are diffused as colours are in an image, less so across edges; then the surface is
fitted to them.  The flow between faces with normals n grows with the length l of their edge and
falls with the distance d of their centroids:

    n_i <- n_i + tau / A_i sum(l_ij / d_ij g(|n_j - n_i|) (n_j - n_i)), normalised
    g(s) = exp(-s^2 / (2 mu^2))
    x_i <- x_i + mean((n'_f . (c_f - x_i)) n'_f)

with A the area of a face; the last line moves vertices towards the planes of their faces through
the centroids c, with the diffused normals n' kept.  Each of ``iterations`` rounds takes
``normal_iterations`` steps of the first line and ``vertex_iterations`` passes of the last, and
starts with the normals of the surface that the round before left: one long diffusion would end at
normals that no surface has.

Across a difference of normals of more than about 2 mu hardly anything flows.  By default mu is
1.4826 times the median absolute deviation of the differences between neighbours in the input, so
that it follows the noise.  On rounded shapes take ``similarity=0.5`` and ``normal_iterations=5``,
which are better by half a degree and more.  A mesh without noise and with flat parts has mu = 0 and
stays as it is.

It compares faces only across edges, and reaches far by many steps.  Fine texture goes; use ``msal``
there.  This is the paper's scheme, not its discretisation, which is one for level sets.

Boundary vertices are fixed.

Source: T. Tasdizen, R. Whitaker, P. Burchard and S. Osher, Geometric surface smoothing via
anisotropic diffusion of normals, IEEE Visualization 2002, 125-132; the fit of the vertices: X. Sun,
P. L. Rosin, R. R. Martin and F. C. Langbein, IEEE TVCG 13 (2007), 925-938.
"""

from collections.abc import Callable

from msal_cli.arrays import Floats
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.normal_filters import difference_width, diffused_normals
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._normal_filters import run_rounds

BYTES_PER_FACE = 130


@dataclass(frozen=True)
class Parameters:
    iterations: int = fields.iterations(
        3,
        "rounds of diffusing the normals and fitting the vertices",
        "smoother, with sharper edges; fine features go",
    )
    normal_iterations: int = fields.passes(
        15, "steps of diffusion in each round", "smoother normals, larger flat pieces"
    )
    vertex_iterations: int = fields.vertex_passes(
        7, "passes that fit the vertices to the diffused normals in each round"
    )
    similarity: float = fields.parameter(
        0.0,
        "width of the Gaussian of the differences between normals; 0 measures it on the input",
        symbol="mu",
        low=0.0,
        high=10.0,
        more="smoother, fewer edges kept; but for 0",
    )
    time_step: float = fields.step(
        0.1,
        "time step of the diffusion; faces with a smaller limit of stability take that",
        "smoother, up to the limit of each face",
    )
    boundary: str = fields.boundary("fixed")
    sliding: str = fields.sliding()


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    timer = Timer()
    faces, links = mesh.faces, mesh.topology
    rings = face_rings(faces, links, "edge")
    similarity = parameters.similarity
    if similarity == 0.0:
        similarity = difference_width(face_normals(mesh.vertices, faces), *rings)

    def filtered(positions: Floats, on_step: Callable[[], None]) -> Floats:
        return diffused_normals(
            positions,
            faces,
            *rings,
            similarity,
            parameters.time_step * mesh.mean_edge_length**2,
            parameters.normal_iterations,
            on_step,
        )

    return run_rounds(mesh, parameters, filtered, on_sweep, timer)
