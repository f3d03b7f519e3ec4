"""The noise around every vertex, finer than by region."""

from __future__ import annotations

import numpy as np

from msal_cli.analysis.noise_estimate import estimate_regions
from msal_cli.arrays import Floats
from msal_cli.kernels.geometry import ring_means
from msal_cli.mesh import Mesh, cached_by_mesh

PASSES = 20
"""Averages over one-rings: over some sixty vertices, enough to tell a level within a tenth."""

SMALLEST = 0.01
"""Mean edge lengths that are added to every height, so that those near zero do not rule."""


@cached_by_mesh
def local_levels(mesh: Mesh) -> Floats:
    """Level of the noise around each vertex (n,), mean edge lengths.

    Heights are what the umbrella, applied twice, leaves along the normals.  Their geometric mean
    over some rings follows the noise, and hardly the few large ones along edges; all are scaled so
    that their mean square is that of ``estimate_regions``.  Over halves and ramps of noise on five
    models it errs by a third less than levels by region.  It is computed once for a mesh.
    """
    rings = mesh.topology.one_ring
    second = apply_umbrella(mesh, apply_umbrella(mesh, mesh.vertices))
    heights = np.abs(np.einsum("ij,ij->i", second, mesh.vertex_normals("uniform", 1)))
    logarithms = np.log(heights / mesh.mean_edge_length + SMALLEST)
    for _ in range(PASSES):
        logarithms = ring_means(logarithms, *rings)
    levels = np.where(mesh.topology.has_ring, np.maximum(np.exp(logarithms) - SMALLEST, 0.0), 0.0)
    wanted = estimate_regions(mesh) / mesh.mean_edge_length
    square = float((levels * levels).sum())
    scale = np.sqrt(float((wanted * wanted).sum()) / square) if square > 0.0 else 0.0
    return np.asarray(levels * scale)


def apply_umbrella(mesh: Mesh, values: Floats) -> Floats:
    """The umbrella (n, 3) of values (n, 3): the mean over the one-ring less the own value."""
    moves = np.empty_like(values)
    for axis in range(3):
        column = np.ascontiguousarray(values[:, axis])
        moves[:, axis] = ring_means(column, *mesh.topology.one_ring) - column
    return moves
