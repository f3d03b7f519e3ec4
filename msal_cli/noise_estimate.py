"""How much noise there is on a mesh."""

from __future__ import annotations

import numpy as np

from msal_cli.dataclass import dataclass
from msal_cli.mesh import Mesh

WHITE_NOISE_GAIN = 1.3591
"""Standard deviation of the twice-applied umbrella of unit white noise on the valence-6 lattice:
sqrt(c0^2 + 6 (c1^2 + c2^2 + c3^2)) with c = 7/6, -5/18, 1/36, 1/18."""

NEGLIGIBLE = 0.02
"""Mean edge lengths below which there is no noise to speak of."""


@dataclass(frozen=True)
class NoiseLevel:
    """The noise of a mesh: the standard deviation along its normals.

    Attributes
    ----------
    mean_edges : in mean edge lengths of the mesh as it is.
    low, high : an interval that holds it nearly always, mean edge lengths.
    file_units : the same level in file units.
    clean_edges : in mean edge lengths of the surface without the noise, which are shorter.
    rms_edges : root mean square with its outliers, which the level leaves out, mean edge lengths.
    tail : share of the vertices, 0 to 1, that are further out than Gaussian noise would put them.
    is_negligible : whether there is no noise to speak of.
    lowest, highest : levels of the least and the most noisy region, mean edge lengths.
    regions : how many regions were told apart.
    """

    mean_edges: float
    low: float
    high: float
    file_units: float
    clean_edges: float
    rms_edges: float
    tail: float
    is_negligible: bool
    lowest: float
    highest: float
    regions: int


def estimated(mesh: Mesh) -> NoiseLevel:
    """The noise of a mesh.

    With d = n . umbrella(x), n mollified once, the second difference mean(d of the ring) - d
    holds the noise almost alone; 1.4826 times its median absolute deviation over the interior
    vertices, divided by what unit white noise would give, is the estimate.
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
    level = float(1.4826 * deviation / WHITE_NOISE_GAIN)
    edges = level / mesh.mean_edge_length
    tail = float((second > 4.5 * deviation).mean())
    return NoiseLevel(
        mean_edges=edges,
        low=0.8 * edges,
        high=1.2 * edges,
        file_units=level,
        clean_edges=edges / np.sqrt(max(1.0 - 2.0 * edges * edges, 0.1)),
        rms_edges=edges,
        tail=tail,
        is_negligible=edges < NEGLIGIBLE,
        lowest=edges,
        highest=edges,
        regions=1,
    )
