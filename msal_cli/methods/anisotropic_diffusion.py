"""Anisotropic mean curvature diffusion: flattens and straightens, and keeps edges and corners.

The mean curvature of a triangle mesh sits in its edges: an edge e between faces with unit normals m
and n has the curvature vector H(e) = e x (n - m) of length 2 |e| sin(phi / 2), with phi the angle
between them.  Half their sum around a vertex is the gradient of the area, along which
``mean_curvature_flow`` moves.  Here an edge that is bent more than a threshold lambda counts less:

    H_A(x_i) = 1/2 sum(w(H(e)) H(e)),  w = 1 where |H| <= lambda
                                       w = lambda^2 / (r (lambda - |H|)^2 + lambda^2) beyond
    variant=amc:  x_i <- x_i - tau / M_i H_A(x_i)
    variant=pmc:  x_i <- x_i - tau / M_i (H_A(x_i) - f_i V_A(x_i))

with M_i a third of the area around the vertex.  ``amc`` is anisotropic mean curvature flow: it
spares edges but shrinks all that is round; some ten steps are its best.  ``pmc`` flows towards a
smooth curvature f, and so nearly keeps the volume and stays good for far more.  V_A is the gradient
of the volume; at a feature, a vertex with an edge beyond lambda, it has that length, and the
direction of H_A averaged with the mean of its neighbours' H_A.  f are the curvatures
H_A . V_A / |V_A|^2 averaged over the neighbours, a feature's over features.

lambda is the median of |H| in the input, right for objects with sharp edges; ``shape=organic`` adds
1.4826 times the median absolute deviation, and ``threshold`` sets it by hand.  A mesh without noise
that is mostly flat is left alone.

Own choices: lambda follows the noise, tau is an area in squared mean edge lengths, or the vertex's
limit of stability if that is smaller, averages are weighted by |V_A|, not by angles, so that a fold
cannot throw its neighbours out, and f is updated at every step.

``schedule`` works with both variants.  Boundary vertices are fixed; with ``boundary=free`` they
move by the edges that have two faces.  Open and non-manifold edges have no curvature.  A step costs
about four sweeps of ``al``.

Source: K. Hildebrandt and K. Polthier, Anisotropic filtering of non-linear surface features,
Computer Graphics Forum 23 (3), Eurographics 2004, 391-400.
"""

from msal_cli.kernels.curvature import AnisotropicCurvature, curvature_threshold
from msal_cli.kernels.faces import flaps
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import ScaleParameters, free_vertices, run

DEVIATIONS = {"cad": 0.0, "organic": 1.0}
"""Automatic lambda, in standard deviations above the median."""

BYTES_PER_FACE = 195


@dataclass(frozen=True)
class Parameters(ScaleParameters):
    has_own_step = True

    iterations: int = fields.iterations(
        40,
        "steps; about 10 for variant=amc",
        "smoother; under the multiscale schedule many lead back to the input",
    )
    boundary: str = fields.boundary("fixed", "free to move by the edges that have two faces")
    time_step: float = fields.step(0.1)
    variant: str = fields.parameter(
        "pmc",
        "flow towards a smooth prescribed mean curvature, or plain anisotropic mean curvature flow",
        choices=("pmc", "amc"),
    )
    threshold: float = fields.parameter(
        0.0,
        "curvature |H| beyond which an edge is kept; 0 measures it on the input",
        low=0.0,
        high=1000.0,
        unit="mean edge lengths",
        more="smoother, fewer edges kept; but for 0",
    )
    shape: str = fields.parameter(
        "cad",
        "with threshold=0: an object with sharp edges, or a rounded one, where fewer are kept",
        choices=tuple(DEVIATIONS),
    )
    falloff: float = fields.parameter(
        10.0,
        "how fast the weight of an edge falls beyond the threshold",
        symbol="r",
        above=0.0,
        high=1e6,
        more="sharper edges, and more noise taken for an edge",
    )


def _operator(mesh: Mesh, parameters: Parameters) -> AnisotropicCurvature:
    corners = flaps(mesh.faces, mesh.topology)
    edge = mesh.mean_edge_length
    threshold = parameters.threshold * edge
    if threshold == 0.0:
        deviations = DEVIATIONS[parameters.shape]
        threshold = curvature_threshold(mesh.vertices, corners, deviations)
    return AnisotropicCurvature(
        mesh.faces,
        mesh.topology,
        corners,
        free_vertices(mesh, parameters.boundary),
        threshold,
        parameters.falloff,
        parameters.time_step * edge**2,
        parameters.variant == "pmc",
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    return run(mesh, parameters, lambda: _operator(mesh, parameters), on_sweep)
