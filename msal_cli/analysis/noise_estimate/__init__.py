"""How much noise there is on a mesh, and of what kind, or whether it has any.

``fits`` measures the level of noise that each vertex has of its own over one- and two-rings, and
looks at fewer places over up to six rings; ``spread`` and ``axes`` measure what each kind of noise
would leave there, and ``evidence`` makes numbers of it all.  ``character`` says from these how
probable every kind is, and puts the estimate together.
"""

from __future__ import annotations

import numpy as np

from msal_cli.analysis.measures import apply_umbrella
from msal_cli.analysis.noise_estimate.character import characterize
from msal_cli.analysis.noise_estimate.fits import find_nearest
from msal_cli.analysis.noise_estimate.level import (
    NOISE,
    SURE,
    TEXTURE,
    NoiseCharacter,
    NoiseLevel,
    Reading,
)
from msal_cli.arrays import Floats
from msal_cli.kernels.geometry import ring_means
from msal_cli.mesh import Mesh, cached_by_mesh

__all__ = [
    "NOISE",
    "SURE",
    "TEXTURE",
    "NoiseCharacter",
    "NoiseLevel",
    "Reading",
    "estimate_noise",
    "estimate_regions",
]


def estimate_noise(mesh: Mesh) -> NoiseLevel:
    """The noise of a mesh.

    Noise of 0.05 to 0.7 mean edge lengths is estimated within some per cent where it is white, and
    within about 15 % where neighbours share it.  Detail as fine as the mesh itself may look like
    noise: ``readings`` say how probable both are, and where neither is sure the estimate is
    ``is_unsure``.  The result does not depend on how the mesh is moved or scaled, nor on the number
    of threads.  Its cost hardly depends on the size of the mesh.
    """
    return characterize(mesh).level


def estimate_regions(mesh: Mesh) -> Floats:
    """Level of the noise around each vertex (n,), file units: that of the region it lies in.

    Vertices that no face uses have 0.
    """
    result = characterize(mesh)
    nearest = find_nearest(mesh.vertices, result.middles)
    return np.where(mesh.topology.has_ring, result.regions[nearest], 0.0)


PASSES = 20
"""Averages over one-rings: over some sixty vertices, enough to tell a level within a tenth."""

MIN_HEIGHT = 0.01
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
    logarithms = np.log(heights / mesh.mean_edge_length + MIN_HEIGHT)
    for _ in range(PASSES):
        logarithms = ring_means(logarithms, *rings)
    levels = np.where(mesh.topology.has_ring, np.maximum(np.exp(logarithms) - MIN_HEIGHT, 0.0), 0.0)
    wanted = estimate_regions(mesh) / mesh.mean_edge_length
    square = float((levels * levels).sum())
    scale = np.sqrt(float((wanted * wanted).sum()) / square) if square > 0.0 else 0.0
    return np.asarray(levels * scale)
