"""Fits over one to six rings at some hundred places of a mesh, quantiles of them, and regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.arrays import Floats, Longs

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

_NORMAL = {
    0.05: -1.6448536,
    0.2: -0.8416212,
    0.25: -0.6744898,
    0.3: -0.5244005,
    0.35: -0.3853205,
    0.4: -0.2533471,
    0.5: 0.0,
}
"""Quantiles of the normal distribution."""


def quantile(values: Floats, share: float) -> float:
    """The value (of at least one) below which a share of them lies; one of them, no mean of two."""
    rank = int(share * (len(values) - 1))
    return float(np.partition(values, rank)[rank])


def quantiles(values: Floats, shares: Sequence[float]) -> Floats:
    """Values (s,) below which ``shares`` of them lie, as ``numpy.quantile`` gives them, which takes
    ten times as long for a few hundred."""
    ordered = np.sort(values)
    places = np.asarray(shares) * (len(ordered) - 1)
    low = places.astype(np.int64)
    high = np.minimum(low + 1, len(ordered) - 1)
    result: Floats = ordered[low] + (ordered[high] - ordered[low]) * (places - low)
    return result


def chi_square_quantile(freedoms: Floats, share: float) -> Floats:
    """What chi square over its degrees of freedom stays below with a probability of ``share``.

    After Wilson and Hilferty 1931; right within 2 % from five degrees of freedom on.
    """
    scale = 2.0 / (9.0 * np.maximum(freedoms, 1.0))
    ratios: Floats = np.maximum(1.0 - scale + _NORMAL[share] * np.sqrt(scale), 0.05) ** 3
    return ratios


MAX_PLACES = 640
"""Places of the survey: more would add little, and take 15 microseconds each."""

ONE, TWO, THREE, FOUR, SIX = range(5)
"""The fits, by the rings that they are over."""


@dataclass(frozen=True, eq=False)
class Survey:
    """The places, and what fits leave over there; lengths are in mean edge lengths.

    Attributes
    ----------
    at : (c,) which of the places of the ``WhiteEstimate`` these are.
    vertices : (c,) their vertices.
    positions : (c, 3).
    variances : (c, 5) left over by each fit, by the degrees of freedom; NaN where there is none.
    freedoms : (c, 5).
    normals : (c, 3) of the two-ring; unit vectors.
    offsets : (c, 3) from the middle of the ring to the vertex; see ``kernels.patch_fits``.
    """

    at: Longs
    vertices: Longs
    positions: Floats
    variances: Floats
    freedoms: Floats
    normals: Floats
    offsets: Floats

    def quantile(self, fit: int, share: float, scale: Floats | None = None) -> float:
        """Variance that one fit leaves over at a share of the places, or of its ratio to ``scale``
        (c,) where that is above 0; NaN where there is none."""
        values = self.variances[:, fit]
        if scale is not None:
            has = scale > 0.0
            values = values[has] / scale[has]
        values = values[np.isfinite(values)]
        if not len(values):
            return float("nan")
        return quantile(values, share)


def take_survey(mesh: Mesh, places: Longs) -> Survey:
    """Look at some of the places (c,), evenly."""
    from msal_cli.kernels.patch_fits import fit_scales

    at = np.arange(0, len(places), max(-(-len(places) // MAX_PLACES), 1))
    chosen = np.ascontiguousarray(places[at])
    links = mesh.topology
    rests, rows, ranks, frames, offsets = fit_scales(
        chosen,
        mesh.vertices,
        mesh.vertex_normals("uniform", 1),
        links.ring_start,
        links.ring,
    )
    edge = mesh.mean_edge_length
    freedoms = np.maximum(rows - ranks, 0).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        variances = np.where(freedoms > 0.0, rests / freedoms, np.nan) / (edge * edge)
    has_normal = (frames != 0.0).any(axis=1)
    return Survey(
        at=at[has_normal],
        vertices=chosen[has_normal],
        positions=mesh.vertices[chosen[has_normal]] / edge,
        variances=variances[has_normal],
        freedoms=freedoms[has_normal],
        normals=frames[has_normal],
        offsets=offsets[has_normal] / edge,
    )


# Regions of a mesh, each as far from the others as can be

VERTICES_PER_REGION = 800
MAX_REGIONS = 16

BLOCK_VERTICES = 1 << 14
"""Vertices whose distances to all regions are in memory at a time."""


def count_regions(n_vertices: int) -> int:
    """Into how many regions a mesh is split."""
    return min(max(n_vertices // VERTICES_PER_REGION, 1), MAX_REGIONS)


def split_regions(vertices: Floats, count: int) -> tuple[Longs, Longs]:
    """Which of the vertices (c, 3) are middles of ``count`` regions, each as far from the others as
    can be; and which middle is the nearest to each vertex (c,)."""
    axes = np.ascontiguousarray(vertices.T)
    # The first one is the furthest from where they are on average.
    distances = _squared_distances(axes, axes.mean(axis=1))
    middles = np.empty(count, dtype=np.int64)
    labels = np.zeros(len(vertices), dtype=np.int64)
    for number in range(count):
        middles[number] = distances.argmax()
        from_it = _squared_distances(axes, vertices[middles[number]])
        if number == 0:
            distances = from_it
            continue
        labels[from_it < distances] = number
        np.minimum(distances, from_it, out=distances)
    return middles, labels


def find_nearest(vertices: Floats, middles: Floats) -> Longs:
    """Which of the middles (r, 3) is the nearest to each of the vertices (n, 3)."""
    nearest = np.empty(len(vertices), dtype=np.int64)
    for first in range(0, len(vertices), BLOCK_VERTICES):
        axes = np.ascontiguousarray(vertices[first : first + BLOCK_VERTICES].T)
        distances = [_squared_distances(axes, middle) for middle in middles]
        nearest[first : first + BLOCK_VERTICES] = np.argmin(distances, axis=0)
    return nearest


def _squared_distances(axes: Floats, point: Floats) -> Floats:
    """Of positions, an axis a row (3, n), from a point (3,)."""
    x, y, z = axes[0] - point[0], axes[1] - point[1], axes[2] - point[2]
    distances: Floats = x * x + y * y + z * z
    return distances
