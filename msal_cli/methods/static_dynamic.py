"""Static/dynamic filter: face normals of least energy, by a guide and by their own likeness.

Two Gaussians together decide whether two near faces belong to one piece of surface: a static one of
their guide normals g, made from the mesh as it is, and a dynamic one of the normals n that are
sought.  With the given normals n0, areas A and centroids c the energy

    sum_i A_i |n_i - n0_i|^2 + lambda' sum_ij w_ij (1 - exp(-|n_i - n_j|^2 / (2 nu^2)))
    w_ij = (A_i + A_j) exp(-|c_i - c_j|^2 / (2 eta^2)) exp(-|g_i - g_j|^2 / (2 mu^2))

is nearly minimised by steps that replace all normals by the normalised sums

    2 nu^2 / lambda' A_i n0_i + sum_j w_ij exp(-|n_i - n_j|^2 / (2 nu^2)) n_j

until their change, the root of its area-weighted mean square, is at most ``tolerance_deg``, or 100
steps are done.  The second sum runs over faces within 3 eta, joined through others that are, at
most 256, and lambda' = lambda sum(A) / sum(w without its last factor), each pair once.  The guide
is that of ``guided_normal``.  Then ``vertex_iterations`` passes fit the vertices,

    x_i <- x_i + mean over the faces f around i of (n_f . (c_f - x_i)) n_f

and all is repeated from the new mesh, ``iterations`` times.  The authors' own update of the
vertices leaves slivers and flipped faces under noise of 0.2 and more.

The faces that count reach twice as far as those of ``guided_normal``, and the result stays tied to
the normals of the mesh.  The default suits machined parts with large flats.  Organic and finely
meshed shapes want less: lambda 0.5, eta 1 and 3 iterations, or lambda 0.2 and 5 under weaker noise.
Fine texture goes: for scans whose noise is weak take ``msal``.

The memory is about 1 KB a face.

Source: J. Zhang, B. Deng, Y. Hong, Y. Peng, W. Qin and L. Liu, Static/dynamic filtering for mesh
geometry, IEEE TVCG 25 (2019), 1774-1787; vertex update after X. Sun, P. Rosin, R. Martin and F.
Langbein, the same journal 13 (2007), 925-938.
"""

import math
from collections.abc import Callable

from msal_cli.arrays import Floats
from msal_cli.kernels.faces import Patches, face_centroids, faces_within, patches
from msal_cli.kernels.geometry import face_normals_and_areas, mean_edge_length
from msal_cli.kernels.normal_filters import minimising_normals, pair_weights
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._normal_filters import run_rounds

OnStep = Callable[[], object]

MAX_NEAR = 256  # largest number of faces near one; fifty are usual
MAX_STEPS = 100  # largest number of steps towards the minimum of the energy

BYTES_PER_FACE = 1450


@dataclass(frozen=True)
class Parameters:
    iterations: int = fields.iterations(
        5,
        "filterings of the normals, each with its passes over the vertices",
        "smoother, with sharper edges; fine features go",
    )
    strength: float = fields.parameter(
        2.0,
        "weight of the likeness of near normals, against keeping them as they are",
        symbol="lambda",
        low=0.0,
        high=1e6,
        more="smoother",
    )
    closeness: float = fields.parameter(
        1.5,
        "width of the Gaussian of the distances between centroids; faces within 3 of it count",
        symbol="eta",
        above=0.0,
        high=10.0,
        unit="mean distances of neighbouring centroids",
        more="smoother; the cost grows with its square; small features are lost",
    )
    guidance: float = fields.parameter(
        1.5,
        "width of the Gaussian of the differences between guide normals",
        symbol="mu",
        above=0.0,
        high=100.0,
        more="the guide matters less",
    )
    similarity: float = fields.parameter(
        0.3,
        "width of the Gaussian of the differences between the normals themselves",
        symbol="nu",
        above=0.0,
        high=100.0,
        more="smoother; blunt edges go",
    )
    tolerance_deg: float = fields.parameter(
        0.2,
        "mean change of the normals in a step at which a filtering ends",
        low=0.0,
        high=90.0,
        unit="degrees",
        more="faster, less smooth",
    )
    vertex_iterations: int = fields.vertex_passes(
        10, "passes that fit the vertices to the normals, after each filtering"
    )
    boundary: str = fields.boundary("free")
    sliding: str = fields.sliding()


def _filtered_normals(
    vertices: Floats, mesh: Mesh, around: Patches, parameters: Parameters, on_step: OnStep
) -> Floats:
    """Normals (m, 3) for the faces of ``mesh`` with its vertices at ``vertices`` (n, 3).

    A function of its own, so that its arrays are freed before the next call allocates others.
    """
    normals, areas = face_normals_and_areas(vertices, mesh.faces)
    centroids = face_centroids(vertices, mesh.faces)
    unit = mean_edge_length(centroids, *around.edges)
    # Without neighbours the unit is 0, and any length will do.
    eta = parameters.closeness * (unit or mesh.mean_edge_length)
    near = faces_within(centroids, *around.rows, 3.0 * eta, MAX_NEAR)
    weights, share = pair_weights(
        around.guides(normals, areas), centroids, areas, *near, eta, parameters.guidance
    )
    return minimising_normals(
        normals,
        areas,
        *near,
        weights,
        strength=parameters.strength * share,
        nu=parameters.similarity,
        # The change of a unit vector that turns by the angle.
        tolerance=2.0 * math.sin(math.radians(parameters.tolerance_deg) / 2.0),
        most_steps=MAX_STEPS,
        on_step=on_step,
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    timer = Timer()
    around = patches(mesh.faces, mesh.topology)

    def filtered(positions: Floats, on_step: OnStep) -> Floats:
        return _filtered_normals(positions, mesh, around, parameters, on_step)

    return run_rounds(mesh, parameters, filtered, on_sweep, timer)
