"""Noise on meshes: how much there is, and how to add a known amount."""

from __future__ import annotations

import numpy as np

from msal_cli.mesh import Mesh

WHITE_NOISE_GAIN = 1.3591
"""Standard deviation of the twice-applied umbrella of unit white noise on the valence-6 lattice:
sqrt(c0^2 + 6 (c1^2 + c2^2 + c3^2)) with c = 7/6, -5/18, 1/36, 1/18."""


def noise_level(mesh: Mesh) -> float:
    """Estimated standard deviation of the noise along the normals, in file units.

    With d = n . umbrella(x), n mollified once, the second difference mean(d of the ring) - d
    holds the noise almost alone; 1.4826 times its median absolute deviation over the interior
    vertices, divided by what unit white noise would give, is the estimate.  Gaussian noise of 0.1
    to 0.7 mean edge lengths is told within a few per cent; fine texture looks like noise of up to
    0.04, and isolated outliers are not seen.
    """
    from msal_cli.core.geometry import ring_means, umbrella_heights
    from msal_cli.core.medians import median

    links = mesh.links
    rings = (links.ring_start, links.ring)
    inner = links.has_ring & ~links.boundary
    if not inner.any():
        inner = links.has_ring
    heights = umbrella_heights(mesh.vertices, mesh.vertex_normals("uniform", 1), *rings)
    second = ring_means(heights, *rings)
    second -= heights
    del heights
    if not inner.all():
        second = second[inner]
    second -= median(second)
    deviation = median(np.abs(second, out=second))
    return float(1.4826 * deviation / WHITE_NOISE_GAIN)
