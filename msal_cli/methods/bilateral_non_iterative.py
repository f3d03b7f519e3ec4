"""Non-iterative bilateral filter: every vertex goes to an average of its projections on planes.

Each face around a vertex says where the vertex would lie if the surface went on flat from there;
the answers are averaged robustly, in a single pass:

    p'  = sum(w P_f(p)) / sum(w),   w = A_f exp(-|c_f - p|^2 / 2 sigma_f^2)
                                            exp(-|P_f(p) - p|^2 / 2 sigma_g^2)

P_f(p) is the projection of p on the plane through the centroid c_f of face f, A_f the area of the
face.  The planes have mollified normals: those of the mesh whose vertices went to the mean of the
centroids around, with weights A_f and a Gaussian of width sigma_f / 2.  A plane that passes far
from the vertex belongs to another side of an edge and hardly counts.

The faces are those with a centroid within 2 sigma_f, reached over faces that share a vertex and lie
within that distance: so the far side of a thin wall does not count.  At most 2,048 beyond the
vertex's own count.

One pass, no stop to choose, moderate smoothing that keeps positions well. sigma_f much above 2 eats
small features, and the cost grows with its square.  More ``iterations`` repeat the whole filter;
any schedule of equation (2) composes with it, p' - p standing for dx.

A vertex that has no face's centroid in reach stays.

Source: T. Jones, F. Durand and M. Desbrun, Non-iterative, feature-preserving mesh smoothing, ACM
TOG 22 (SIGGRAPH 2003), 943-949.
"""

from msal_cli.kernels.bilateral import ProjectionAverage
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import ScaleParameters, free_vertices, run

BYTES_PER_FACE = 210


@dataclass(frozen=True)
class Parameters(ScaleParameters):
    iterations: int = fields.iterations(
        1,
        "times that the whole filter is run; 1 in the paper",
        "smoother; under the multiscale schedule many lead back to the input",
    )
    closeness: float = fields.parameter(
        1.0,
        "width of the Gaussian of distances; faces within twice of it count",
        symbol="sigma_f",
        above=0.0,
        high=8.0,
        unit="mean edge lengths",
        more="slower, and smoother up to about 1.5; small features are lost",
    )
    similarity: float = fields.parameter(
        1.0,
        "width of the Gaussian of distances from planes",
        symbol="sigma_g",
        above=0.0,
        high=10.0,
        unit="mean edge lengths",
        more="smoother; edges go",
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    unit = mesh.mean_edge_length
    return run(
        mesh,
        parameters,
        lambda: ProjectionAverage(
            mesh.faces,
            mesh.topology,
            free_vertices(mesh, parameters.boundary),
            unit,
            parameters.closeness * unit,
            parameters.similarity * unit,
        ),
        on_sweep,
    )
