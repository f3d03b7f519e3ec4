"""Bilateral filter of face normals: keeps edges, and weighs areas and distances as well.

The normal of a face is compared with those of its neighbours, the faces that share a vertex with
it.  A neighbour counts by its area A, less the farther off its centroid c is, and less the more its
normal differs:

    w_ij = A_j exp(-|c_i - c_j|^2 / (2 sigma_c^2)) exp(-|n_i - n_j|^2 / (2 sigma_s^2))

``variant=local`` replaces each normal by the normalised sum of w_ij n_j over its neighbours, its
own left out, in ``iterations`` passes; areas, distances and sigma_c are those of the input.
``variant=global`` finds all normals at once, with the weights of the scan and its normals n:

    (1 - lambda) sum|n'_i - sum(w_ij n'_j) / sum(w_ij)|^2 + lambda sum|n'_i - n_i|^2 -> min

and normalises them: one linear system, solved by conjugate gradients, to 2e-5 on the mean;
``iterations`` does not matter, unless it is 0.  Then the vertices are fitted to these normals, in
passes that each add the mean of a vertex's offsets to the planes of its faces through their
centroids:

    x_i <- x_i + mean((n'_f . (c_f - x_i)) n'_f)

``local`` suits objects with edges, up to noise of 0.4 mean edge lengths; on organic shapes take
``similarity=0.45`` and 5 passes.  ``global`` takes strong noise for edges: for noise of 0.2 to 0.3
``similarity=0.6`` nearly halves the angles on objects with edges, and does better than ``local`` on
organic shapes.  Heavier noise folds faces; ``guided_normal`` is made for that.  Fine texture goes;
``msal`` keeps it.

sigma_c is the mean distance between the centroids of faces that share an edge, times ``closeness``.
Boundary vertices are fixed, as in the public implementation that later papers compare with.
``global`` costs 100 to 200 passes.

Source: Y. Zheng, H. Fu, O. K.-C. Au and C.-L. Tai, Bilateral normal filtering for mesh denoising,
IEEE TVCG 17 (2011), 1521-1530; vertices: X. Sun, P. L. Rosin, R. R. Martin and F. C. Langbein, the
same journal 13 (2007), 925-938.
"""

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.kernels.faces import face_centroids, face_rings
from msal_cli.kernels.geometry import VANISHED, face_normals_and_areas, mean_edge_length
from msal_cli.kernels.linear_systems import conjugate_gradients
from msal_cli.kernels.normal_filters import bilateral_averages, normal_system
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._normal_filters import NormalFilterParameters, Passes, run

TOLERANCE = 1e-4
"""Residual of the global solution over lambda, with which the mean error of normals is 2e-5."""

MAX_ITERATIONS = 5000
"""Largest number of conjugate gradient iterations; 100 are needed at the default lambda, 1000 at
the smallest one allowed."""

BYTES_PER_FACE = 265


@dataclass(frozen=True)
class Parameters(NormalFilterParameters):
    variant: str = fields.parameter(
        "local",
        "average the normals over their neighbours, pass by pass; or solve for all at once",
        choices=("local", "global"),
    )
    similarity: float = fields.parameter(
        0.35,
        "width of the Gaussian of the differences between unit normals",
        symbol="sigma_s",
        low=0.01,
        high=10.0,
        more="smoother; edges of larger angles go",
    )
    closeness: float = fields.parameter(
        1.0,
        "width of the Gaussian of the distances between centroids",
        symbol="sigma_c",
        low=0.01,
        high=100.0,
        unit="mean distances of neighbouring centroids",
        more="smoother, up to the plain average of the neighbours",
    )
    fidelity: float = fields.parameter(
        0.01,
        "global: weight of the scanned normals",
        symbol="lambda",
        low=1e-4,
        high=1.0,
        more="closer to the input",
    )


def _filtered_normals(mesh: Mesh, parameters: Parameters, passes: Passes) -> Floats:
    normals, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    centroids = face_centroids(mesh.vertices, mesh.faces)
    across_edges = face_rings(mesh.faces, mesh.topology, "edge")
    unit = mean_edge_length(centroids, *across_edges) or mesh.mean_edge_length
    del across_edges
    rows = face_rings(mesh.faces, mesh.topology, parameters.neighbours)
    faces = (normals, areas, centroids, *rows, parameters.closeness * unit, parameters.similarity)
    if parameters.variant == "local":
        return bilateral_averages(*faces, parameters.iterations, passes.count_pass)
    fidelity = parameters.fidelity
    system = normal_system(*faces, fidelity)
    solved = conjugate_gradients(
        system.diagonal,
        system.times,
        fidelity * normals,
        normals,
        tolerance=TOLERANCE * fidelity,
        most_iterations=MAX_ITERATIONS,
        on_iteration=passes.on_step,
    )
    passes.count_pass()
    length = np.sqrt((solved * solved).sum(axis=1))[:, None]
    vanished = length <= VANISHED
    return np.where(vanished, normals, solved / np.where(vanished, 1.0, length))


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    return run(
        mesh,
        parameters,
        lambda passes: _filtered_normals(mesh, parameters, passes),
        on_sweep,
        normal_passes=None if parameters.variant == "local" else 1,
    )
