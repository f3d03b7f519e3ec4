"""Removal of white noise by sweeps of AL, restoration of what they removed beyond noise, and a fit
to filtered normals.  ``wiener`` and the learned filter use it."""

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.kernels.faces import face_centroids, face_rings
from msal_cli.kernels.geometry import face_normals, face_normals_and_areas, mean_edge_length
from msal_cli.kernels.normal_filters import joint_bilateral
from msal_cli.kernels.operators import RingOperator
from msal_cli.kernels.restoration import restoration
from msal_cli.kernels.sweeps import Schedule, run_sweeps
from msal_cli.kernels.vertex_update import update_vertices
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep
from msal_cli.methods._sweeps import NormalParameters, free_vertices


@dataclass(frozen=True)
class RestorationParameters(NormalParameters):
    """Parameters of the Wiener-filtered residual and of the filter of normals after it."""

    iterations: int = fields.iterations(
        6,
        "plain sweeps at the beginning; 0 returns the mesh as it is",
        "smoother under strong noise, hardly else",
    )
    mollify: int = fields.mollify(2)
    noise: float = fields.noise(of="")
    caution: float = fields.caution(0.75, of="")
    normal_iterations: int = fields.passes(
        3, "passes over the face normals; 0 leaves this step out", "smoother"
    )
    similarity: float = fields.parameter(
        2.25,
        "width of the Gaussian of the differences between unit normals of the result, over the "
        "noise in mean edge lengths",
        symbol="sigma_s",
        low=0.01,
        high=100.0,
        more="smoother; edges of larger angles go",
    )
    closeness: float = fields.parameter(
        1.25,
        "width of the Gaussian of the distances between centroids",
        symbol="sigma_c",
        low=0.01,
        high=100.0,
        unit="mean distances of neighbouring centroids",
        more="smoother, up to the plain average of the neighbours",
    )
    scan_share: float = fields.share(
        0.75,
        "share of the scan's normals in those that are filtered, beside those of the result",
        "positions closer to the scan, and finer texture; less is smoother",
    )
    vertex_iterations: int = fields.vertex_passes(2, more="faces closer to their normals")


@dataclass(frozen=True, eq=False)
class Restored:
    """The result of the sweeps and the restoration, before normals are filtered."""

    # smooth, positions: (n, 3) after the sweeps, and after the restoration
    smooth: Floats
    positions: Floats
    returned: Floats  # (n,) restored displacement along the normals, file units
    share: Floats  # (n,) the same as a share of the removed displacement


def restore(
    mesh: Mesh,
    laplacian: RingOperator,
    parameters: RestorationParameters,
    noise: float,
    on_sweep: OnSweep,
) -> Restored:
    """Sweeps of ``mesh``, and the restoration for a level of ``noise`` in file units."""
    iterations = parameters.iterations
    smooth = run_sweeps(mesh.vertices, laplacian, Schedule(), iterations, on_sweep).vertices
    normals, links = laplacian.normals, mesh.topology
    residual = np.einsum("ij,ij->i", smooth - mesh.vertices, normals)
    returned, share = restoration(residual, *links.one_ring, noise, parameters.caution)
    return Restored(smooth, smooth - returned[:, None] * normals, returned, share)


def fit_to_normals(
    mesh: Mesh, parameters: RestorationParameters, guide: Floats, noise: float
) -> Floats:
    """Positions ``guide`` (n, 3) fitted to the normals of the scan after a joint bilateral filter
    by the normals of the guide; ``noise`` is in file units.  Returns (n, 3)."""
    faces = mesh.faces
    guide_normals, areas = face_normals_and_areas(guide, faces)
    centroids = face_centroids(guide, faces)
    across_edges = face_rings(faces, mesh.topology, "edge")
    unit = mean_edge_length(centroids, *across_edges)
    ring_start, ring = face_rings(faces, mesh.topology, "vertex")
    rows = ring_start.astype(np.int64), ring
    normals = face_normals(mesh.vertices, faces)
    normals *= parameters.scan_share
    normals += (1.0 - parameters.scan_share) * guide_normals
    lengths = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    normals /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    for _ in range(parameters.normal_iterations):
        normals = joint_bilateral(
            normals,
            guide_normals,
            centroids,
            areas,
            *rows,
            sigma_s=parameters.closeness * (unit or mesh.mean_edge_length),
            sigma_r=parameters.similarity * noise / mesh.mean_edge_length,
        )
    return update_vertices(
        guide,
        normals,
        faces,
        mesh.topology,
        free_vertices(mesh, parameters.boundary),
        parameters.vertex_iterations,
    )
