"""Hybrid filter for machined parts: vertices in clusters, edges kept, flat parts evened out.

After the hybrid algorithm of Huang and Ascher for the large sharp edges of machined parts, which
``al`` rounds off, while ``msal`` leaves noise on the flats beside them.  A reconstruction from the
outline of that paper (K-means and geometric clustering, creases where the tangent plane jumps, the
umbrella on flat parts, MSAL elsewhere), not a reproduction: the quantity that is clustered, the
thresholds and the steps are own.

1. ``presmooth`` sweeps of AL over a copy of the mesh, and as many of MSAL over another.
2. On the first copy each vertex has a spread s = mean(1 - n_f . n) of the normals n_f of its faces
   about its own n, at least 1e-6.  The logarithms of all s fall into ``clusters`` groups by
   K-means.  Those in the highest group whose spread is that of an edge sharper than
   ``crease_angle_deg``, and that have a neighbour of their kind, are features; all others are flat.
3. Features go on from the second copy, whose edges are sharp still, flat vertices from the first.
   At sweep j = 0, 1, ... from here, with updated normals n:

       feature   x_i <- x_i + K^j mean(n_k ((x_k - x_i) . n_k))
       flat      x_i <- x_i + 1/2 (u_i - 1/2 mean(u_k)) n_i + 1/2 r t_i

   over the neighbours k, where u = U . n and t = U - u n are the parts of the umbrella
   U = mean(x_k - x_i) along the normal and along the surface, and r is ``regularize``.

The step of a feature leads to the edge between two flat sides, or to the corner of three.  Taking
off half of the neighbours' mean height keeps curved parts from shrinking much.

It is made for parts with flat or gently curved sides and sharp edges under strong noise: with noise
of 0.3 mean edge lengths it leaves two thirds of the angles of ``al``, and half of those of
``msal``, which is the best of the three under noise of 0.1.  Texture is flattened.  Far more sweeps
wear everything down.

At open edges vertices move along their normals only.  The whole costs about seven times as much as
three sweeps of ``al``.

Source: after H. Huang and U. Ascher, Surface mesh smoothing, regularization and feature detection,
SIAM Journal on Scientific Computing 31 (2008), 74-93.
"""

import numpy as np

from msal_cli.arrays import Flags, Floats
from msal_cli.kernels.bilateral import normal_spread, step_towards_planes
from msal_cli.kernels.geometry import ring_means, vertex_normals
from msal_cli.kernels.quantiles import clusters
from msal_cli.kernels.sweeps import Schedule, run_sweeps
from msal_cli.kernels.umbrellas import Umbrella
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._sweeps import NormalParameters, anisotropic_laplacian, free_vertices

SMALLEST_SPREAD = 1e-6
"""Smaller spreads count as this: face normals within a tenth of a degree of the vertex normal."""

PUSHED_BACK = 0.5
"""Share of the neighbours' mean height that is subtracted from the height of a flat vertex."""

BYTES_PER_FACE = 95


@dataclass(frozen=True)
class Parameters(NormalParameters):
    iterations: int = fields.iterations(
        6,
        "sweeps over all vertices, those before the clustering among them",
        "smoother flats, more even triangles",
    )
    presmooth: int = fields.passes(
        3,
        "sweeps before the clustering",
        "features are found under stronger noise, and weak ones are lost",
    )
    clusters: int = fields.parameter(
        3,
        "groups into which K-means parts the vertices; the highest one holds the features",
        low=2,
        high=10,
        more="fewer features",
    )
    crease_angle_deg: float = fields.parameter(
        25.0,
        "angle between the normals on both sides below which nothing is a feature",
        low=0.0,
        high=180.0,
        unit="degrees",
        more="fewer features",
    )
    K: float = fields.share(
        0.5,
        "factor by which the steps of features shrink from sweep to sweep, before and after the "
        "clustering",
        "smoother features",
        symbol="K",
        above=0.0,
    )
    regularize: float = fields.share(
        0.25,
        "share of the umbrella's step along the surface that flat vertices take",
        "more even triangles, farther from where they were scanned",
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    timer = Timer()
    total = parameters.iterations
    first = min(parameters.presmooth, total)
    laplacian = anisotropic_laplacian(mesh, parameters)
    timer.start_sweeps()
    start, plain = mesh.vertices, Schedule()
    x = run_sweeps(start, laplacian, plain, first, lambda done, _: on_sweep(done, total)).vertices
    # Reports no progress, but the caller may raise an exception to end the run.
    sharp = run_sweeps(
        start,
        laplacian,
        Schedule(decay=parameters.K, quantile=1.0),
        first,
        lambda *_: on_sweep(first, total),
    ).vertices
    cluster, feature = _find_features(mesh, x, parameters)
    x[feature] = sharp[feature]
    free = free_vertices(mesh, parameters.boundary)
    for sweep in range(total - first):
        x = x + _compute_moves(mesh, x, feature, free, parameters.K**sweep, parameters)
        on_sweep(first + sweep + 1, total)
    return timer.finish(x, {"cluster": cluster, "feature": feature.astype(np.float64)})


def _find_features(mesh: Mesh, positions: Floats, parameters: Parameters) -> tuple[Floats, Flags]:
    """The cluster number of each vertex (n,), and whether it is on an edge or corner (n,)."""
    links = mesh.topology
    normals = vertex_normals(positions, mesh.faces, parameters.normals)
    known = (normals != 0.0).any(axis=1)
    spread = normal_spread(positions, mesh.faces, links, normals)
    cluster = np.zeros(len(positions))
    if known.any():
        logarithms = np.log(np.maximum(spread[known], SMALLEST_SPREAD))
        cluster[known] = clusters(logarithms, parameters.clusters)
    candidate = known & (cluster == parameters.clusters - 1)
    candidate &= spread > 1.0 - np.cos(np.radians(parameters.crease_angle_deg) / 2.0)
    around = ring_means(candidate.astype(np.float64), links.ring_start, links.ring)
    return cluster, candidate & (around > 0.0)


def _compute_moves(
    mesh: Mesh, x: Floats, feature: Flags, free: Flags, share: float, parameters: Parameters
) -> Floats:
    """Displacements (n, 3) in a sweep after the clustering, at positions x (n, 3)."""
    links = mesh.topology
    normals = vertex_normals(x, mesh.faces, parameters.normals)
    umbrella = Umbrella(links.ring_start, links.ring)(x).move
    heights = (umbrella * normals).sum(axis=1)
    tangential = parameters.regularize * (umbrella - heights[:, None] * normals)
    tangential[links.boundary] = 0.0
    heights -= PUSHED_BACK * ring_means(heights, links.ring_start, links.ring)
    flat = 0.5 * (heights[:, None] * normals + tangential)
    edge = share * step_towards_planes(x, normals, links.ring_start, links.ring)
    moves: Floats = np.where(feature[:, None], edge, flat)
    moves[~free | (normals == 0.0).all(axis=1)] = 0.0
    return moves
