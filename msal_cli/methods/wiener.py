"""Wiener-filtered residual: smooths, and gives back what is more than noise; then the normals.

For organic and textured scans with noise up to about 0.4 mean edge lengths.  Three steps:

1. ``iterations`` plain sweeps of the anisotropic Laplacian (see ``al``).  How far they moved each
   vertex along its normal is the residual t: the noise, turned round, and shape that was lost.
2. The residual is split into five bands from fine to coarse.  Of each, every vertex gets back what
   is more than noise, by the power Q of the lost shape around it, c the share of white noise in the
   band, and the ``noise`` s (estimated, unless it is given):

       lambda = Q / (Q + 0.4 caution c s^2)

   Q comes from a first such look at the residual.  This is ``schedule=wiener`` of ``msal``, where
   docs/algorithm.md has all of it.
3. The result has good positions, and shows which faces have the same direction.  So the noisy
   normals of the scan are averaged over neighbouring faces, the more a neighbour counts the more
   alike the two are *in the result*: a joint bilateral filter, with A areas, c centroids, g the
   normals of the result,

       w_ij = A_j exp(-|c_i - c_j|^2 / (2 sigma_c^2)) exp(-|g_i - g_j|^2 / (2 sigma_s^2))
       n'_i = normalised sum of w_ij n_j over i itself and the faces that share a vertex with it

   in ``normal_iterations`` passes, with sigma_s = ``similarity`` times s in mean edge lengths.
   ``scan_share`` mixes normals of the result in beforehand.  ``vertex_iterations`` passes then fit
   the vertices to these normals (see ``bilateral_normal``).

More sweeps hardly matter: what they take from the shape comes back.  What matters is the noise; it
should be right to a fifth or so.  Texture as fine as the mesh is easily taken for noise by the
estimate; there a given ``noise`` helps most.  Without noise everything comes back.  On
machined parts with strong noise filters of normals do better: ``bilateral_normal``,
``guided_normal``, ``l0``.

Vertices at open edges are filtered with the neighbours that they have (``boundary=free``).  One
without neighbours, or whose normal cannot be determined, stays in steps 1 and 2; one whose faces
have no area stays altogether.  The cost is that of about 30 sweeps of ``al``.

Source: own; local Wiener filters as in M. K. Mihcak, I. Kozintsev, K. Ramchandran and P. Moulin,
Low-complexity image denoising based on statistical modeling of wavelet coefficients, IEEE Signal
Processing Letters 6 (1999), 300-303; normals guided by another surface as in W. Zhang, B. Deng,
J. Zhang, S. Bouaziz and L. Liu, Guided mesh normal filtering, Computer Graphics Forum 34 (2015).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.kernels.faces import face_centroids, face_rings, mean_centroid_distance
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.kernels.normal_filters import joint_bilateral
from msal_cli.kernels.operators import AnisotropicLaplacian
from msal_cli.kernels.restoration import restoration
from msal_cli.kernels.sweeps import Plain, run_sweeps
from msal_cli.kernels.vertex_update import update_vertices
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result, Timer, parameter
from msal_cli.methods._sweeps import (
    NormalParameters,
    anisotropic_laplacian,
    caution_parameter,
    free_vertices,
    noise_parameter,
    resolve_noise_level,
)

BYTES_PER_FACE = 250
"""Memory beyond what every method needs, measured at the defaults; see ``Method``."""


@dataclass(frozen=True)
class Parameters(NormalParameters):
    """Parameters of the Wiener-filtered residual and of the normals that follow it."""

    iterations: int = parameter(
        6,
        "plain sweeps at the beginning; 0 returns the mesh as it is",
        symbol="n",
        low=0,
        high=1000,
        more="smoother under strong noise, hardly else",
    )
    mollify: int = parameter(
        2,
        "passes that average the normals over the one-ring before the first sweep",
        low=0,
        high=100,
        more="smoother normals: flatter flats under heavy noise, softer edges",
    )
    noise: float = noise_parameter(of="")
    caution: float = caution_parameter(0.75, of="")
    normal_iterations: int = parameter(
        3,
        "passes over the face normals; 0 leaves this step out",
        low=0,
        high=1000,
        more="smoother",
    )
    similarity: float = parameter(
        2.25,
        "width of the Gaussian of the differences between unit normals of the result, over the "
        "noise in mean edge lengths",
        symbol="sigma_s",
        low=0.01,
        high=100.0,
        more="smoother; edges of larger angles go",
    )
    closeness: float = parameter(
        1.25,
        "width of the Gaussian of the distances between centroids",
        symbol="sigma_c",
        low=0.01,
        high=100.0,
        unit="mean distances of the centroids of faces that share an edge",
        more="smoother, up to the plain average of the neighbours",
    )
    scan_share: float = parameter(
        0.75,
        "share of the scan's normals in those that are filtered, beside those of the result",
        low=0.0,
        high=1.0,
        more="positions closer to the scan, and finer texture; less is smoother",
    )
    vertex_iterations: int = parameter(
        2,
        "passes that fit the vertices to the filtered normals",
        low=0,
        high=1000,
        more="faces closer to their normals",
    )


@dataclass(frozen=True, eq=False)
class Restored:
    """A scan without its noise, before its normals are filtered.

    Attributes
    ----------
    smooth, positions : (n, 3) after the sweeps, and with what they took beyond noise given back.
    returned : (n,) what was given back along the normals, file units.
    share : (n,) which part of what was taken that is.
    """

    smooth: Floats
    positions: Floats
    returned: Floats
    share: Floats


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    """The filter over ``mesh``; see the module's description."""
    if not parameters.iterations:
        return Result(mesh.vertices.copy(), seconds={"normals": 0.0, "sweeps": 0.0})
    timer = Timer()
    noise = resolve_noise_level(mesh, parameters.noise)
    laplacian = anisotropic_laplacian(mesh, parameters)
    timer.start_sweeps()
    restored = restore(mesh, laplacian, parameters, noise, on_sweep)
    positions = restored.positions
    if noise > 0.0 and parameters.normal_iterations:
        positions = fit_to_normals(mesh, parameters, positions, noise)
    return timer.finish(positions, {"fidelity": restored.share})


def restore(
    mesh: Mesh,
    laplacian: AnisotropicLaplacian,
    parameters: Parameters,
    noise: float,
    on_sweep: OnSweep,
) -> Restored:
    """The sweeps of ``mesh``, and what comes back for ``noise`` in file units."""
    smooth = run_sweeps(mesh.vertices, laplacian, Plain(), parameters.iterations, on_sweep).vertices
    normals, links = laplacian.normals, mesh.topology
    residual = np.einsum("ij,ij->i", smooth - mesh.vertices, normals)
    found = restoration(residual, links.ring_start, links.ring, noise, parameters.caution)
    positions = smooth - found.returned[:, None] * normals
    return Restored(smooth, positions, found.returned, found.share)


def fit_to_normals(mesh: Mesh, parameters: Parameters, guide: Floats, noise: float) -> Floats:
    """Positions (n, 3) from ``guide`` (n, 3), fitted to the scan's normals as the guide's faces
    group them; ``noise`` in file units.
    """
    faces = mesh.faces
    like, areas = face_normals_and_areas(guide, faces)
    scanned, _ = face_normals_and_areas(mesh.vertices, faces)
    centroids = face_centroids(guide, faces)
    across_edges = face_rings(faces, mesh.topology, "edge")
    unit = mean_centroid_distance(centroids, *across_edges)
    ring_start, ring = face_rings(faces, mesh.topology, "vertex")
    scan_share = parameters.scan_share
    normals = scan_share * scanned + (1.0 - scan_share) * like
    lengths = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    normals /= np.where(lengths > 0.0, lengths, 1.0)[:, None]
    for _ in range(parameters.normal_iterations):
        normals = joint_bilateral(
            normals,
            like,
            centroids,
            areas,
            ring_start.astype(np.int64),
            ring,
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
