"""Bilateral filter: heights along the normal, averaged by closeness and by similarity.

A vertex moves along its normal n by a weighted mean of the heights h of its neighbours over its
tangent plane.  The weight falls with the distance of the neighbour and with its height:

    h_k = (x_k - x_i) . n_i,  t_k = |x_k - x_i|
    w_k = exp(-t_k^2 / (2 sigma_c^2)) exp(-h_k^2 / (2 sigma_s^2))
    d_i = sum(w h) / sum(w),  x_i <- x_i + tau d_i n_i

all vertices at once.  The second Gaussian spares edges, as in ``al``.

``variant=one_ring`` is what Huang and Ascher call "our BF": the neighbours are the one-ring,
sigma_s is the standard deviation of their heights, sigma_c (left open there) the mean edge length,
and the normals are those of the input, mollified and kept.  It smooths somewhat less in a sweep
than ``al``, at a little more cost.

``variant=fleishman`` is the filter of Fleishman, Drori and Cohen-Or: the neighbours are the vertex
itself and those within the radius rho, reached along edges within it, at most 2,048 beyond the
one-ring; the normals are updated before every sweep, without mollification, and sigma_s is the
standard deviation of |h|. sigma_c = rho / 2, so give ``radius`` or ``closeness`` and the other
follows.  With neither, sigma_c is the length of each vertex's shortest edge, the rule of the public
implementation that later papers compare with.  It hardly smooths a vertex that has one very short
edge: on uneven triangles give ``closeness=1``, which smooths more and shrinks more.

Where sigma_s is zero the closest in height count.  The cost of ``fleishman`` grows with the
vertices within the radius; it is seven times that of ``one_ring`` and up.  Neither keeps fine
texture under heavy smoothing; ``schedule=multiscale`` brings it back as in ``msal``.

Source: S. Fleishman, I. Drori and D. Cohen-Or, Bilateral mesh denoising, ACM TOG 22 (SIGGRAPH
2003), 950-953; one-ring variant: H. Huang and U. Ascher, Inverse Problems 24 (2008), section 2.3.
"""

from msal_cli.errors import UsageError
from msal_cli.kernels.bilateral import BallBilateral
from msal_cli.kernels.operators import Operator, RingOperator
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import ScheduledParameters, free_vertices, run


@dataclass(frozen=True)
class Parameters(ScheduledParameters):
    iterations: int = fields.iterations(
        5,
        "sweeps over all vertices; 3 in Huang and Ascher, up to 5 in Fleishman et al.",
        "smoother; under the multiscale schedule many sweeps lead back to the input",
    )
    mollify: int = fields.mollify(
        1,
        "one_ring, and the sigma of the multiscale schedule: passes that average the normals over "
        "the one-ring before the first sweep",
    )
    variant: str = fields.parameter(
        "one_ring",
        "the neighbours: the one-ring, along normals kept from the input; or the vertices within "
        "a radius, along normals measured anew at every sweep",
        choices=("one_ring", "fleishman"),
    )
    closeness: float = fields.parameter(
        0.0,
        "width of the Gaussian of distances; 0 is automatic: the mean edge length (one_ring); half "
        "the radius, or without one each vertex's shortest edge (fleishman)",
        symbol="sigma_c",
        low=0.0,
        high=10.0,
        unit="mean edge lengths",
        more="smoother; for fleishman also slower",
    )
    similarity: float = fields.parameter(
        0.0,
        "width of the Gaussian of heights; 0 is automatic: their standard deviation around each "
        "vertex",
        symbol="sigma_s",
        low=0.0,
        high=100.0,
        unit="mean edge lengths",
        more="smoother; edges go",
    )
    radius: float = fields.parameter(
        0.0,
        "fleishman: distance within which vertices count; 0 is automatic: twice sigma_c",
        symbol="rho",
        low=0.0,
        high=20.0,
        unit="mean edge lengths",
        more="smoother, and slower",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.radius and self.variant == "one_ring":
            raise UsageError(
                f"radius = {self.radius:g} means nothing to the one-ring",
                hint="set variant=fleishman, or leave the radius out",
            )


def _operator(mesh: Mesh, parameters: Parameters) -> Operator:
    free = free_vertices(mesh, parameters.boundary)
    unit = mesh.mean_edge_length
    similarity = parameters.similarity * unit
    if parameters.variant == "one_ring":
        return RingOperator(
            mesh.vertex_normals(parameters.normals, parameters.mollify),
            mesh.topology.ring_start,
            mesh.topology.ring,
            free,
            unit,
            (parameters.closeness or 1.0) * unit,
            similarity,
        )
    return BallBilateral(
        mesh.faces,
        mesh.topology,
        free,
        unit,
        parameters.radius * unit,
        (parameters.closeness or 0.5 * parameters.radius) * unit,
        similarity,
        parameters.normals,
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    return run(mesh, parameters, lambda: _operator(mesh, parameters), on_sweep)
