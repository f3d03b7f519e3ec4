"""Fits of polynomials around sampled vertices ("places"), and the level of white noise by them.

The residual of a fit consists of noise, and of what the surface itself has beyond the polynomial:
texture and creases.  White noise leaves the same residual variance per degree of freedom to each
fit and everywhere; texture leaves more to coarser fits, and little in the flattest regions.  So the
level of white noise is the smallest of the fits' residuals at their 20 % quantile over some
thousands of places, divided by that quantile of the chi-square distribution.  The survey fits
polynomials over one to six rings at some hundred places.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.level import are_spikes, are_uneven
from msal_cli.arrays import Flags, Floats, Longs
from msal_cli.kernels.patch_fits import fit_patches, fit_scales
from msal_cli.kernels.quantiles import student
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

_NORMAL = {
    0.2: -0.8416212,
    0.25: -0.6744898,
    0.3: -0.5244005,
    0.35: -0.3853205,
    0.4: -0.2533471,
    0.5: 0.0,
}
"""Quantiles of the standard normal distribution."""

MAX_FREEDOMS = 40

_FEW_FREEDOMS = {
    0.2: (0.0641848, 0.4462871, 1.0051740, 1.6487766),
    0.5: (0.4549364, 1.3862944, 2.3659739, 3.3566940),
}
"""Quantiles of the chi-square distribution with 1 to 4 degrees of freedom."""


def quantile(values: Floats, share: float) -> float:
    """The quantile ``share`` of at least one value: an element, without interpolation."""
    rank = int(share * (len(values) - 1))
    return float(np.partition(values, rank)[rank])


def chi_square_quantile(freedoms: Floats, share: float) -> Floats:
    """Quantile ``share`` of the chi-square distribution over its degrees of freedom.

    By Wilson and Hilferty 1931, with an error below 2 % from five degrees of freedom on.
    """
    scale = 2.0 / (9.0 * np.maximum(freedoms, 1.0))
    ratios: Floats = np.maximum(1.0 - scale + _NORMAL[share] * np.sqrt(scale), 0.05) ** 3
    return ratios


@functools.cache
def chi_square_table(share: float) -> Floats:
    """The same quantiles for 0 to ``MAX_FREEDOMS`` degrees of freedom; ``share`` is 0.2 or 0.5.
    The error is below 0.6 % from one degree of freedom on."""
    ratios = chi_square_quantile(np.arange(MAX_FREEDOMS + 1.0), share)
    ratios[1:5] = np.array(_FEW_FREEDOMS[share]) / np.arange(1.0, 5.0)
    return ratios


# Neighbours of places


def ring_offsets(mesh: Mesh, vertices: Longs) -> tuple[Floats, Longs]:
    """Offsets (c, 3) of vertices (c,), which may repeat, from the means of their one-rings, file
    units; and the valences (c,)."""
    unique, where = np.unique(vertices, return_inverse=True)
    rows, neighbours, counts = mesh.topology.rings_of(unique)
    offsets = np.empty((len(unique), 3))
    for axis in range(3):
        sums = np.bincount(rows, mesh.vertices[neighbours, axis], len(unique))
        offsets[:, axis] = mesh.vertices[unique, axis] - sums / np.maximum(counts, 1)
    return offsets[where], counts[where]


# The survey

MAX_PLACES = 640
"""Largest number of places of the survey; each takes 15 microseconds, and more would add little."""

ONE, TWO, THREE, FOUR, SIX = range(5)
"""Indices of the fits, by their number of rings."""


@dataclass(frozen=True, eq=False)
class Survey:
    """The places and the residuals of the fits there; lengths are in mean edge lengths."""

    vertices: Longs  # (c,) vertex numbers of the places
    positions: Floats  # (c, 3)
    # (c, 5) residual variance of each fit per degree of freedom; NaN if there is none
    variances: Floats
    freedoms: Floats  # (c, 5)
    normals: Floats  # (c, 3) unit normals of the two-rings
    offsets: Floats  # (c, 3) from the mean of the one-ring to the vertex, see ``patch_fits``

    def quantile(self, fit: int, share: float, scale: Floats | None = None) -> float:
        """Quantile ``share`` of the residual variance of one fit, or of its ratio to ``scale`` (c,)
        where that is above 0; NaN if there is none."""
        values = self.variances[:, fit]
        if scale is not None:
            has = scale > 0.0
            values = values[has] / scale[has]
        values = values[np.isfinite(values)]
        return quantile(values, share) if len(values) else math.nan


def take_survey(mesh: Mesh, places: Longs) -> Survey:
    """Fit polynomials over one to six rings at an even sample of the places (c,)."""
    at = np.arange(0, len(places), max(-(-len(places) // MAX_PLACES), 1))
    chosen = np.ascontiguousarray(places[at])
    normals = mesh.vertex_normals("uniform", 1)
    rests, rows, ranks, frames, offsets = fit_scales(
        chosen, mesh.vertices, normals, *mesh.topology.one_ring
    )
    edge = mesh.mean_edge_length
    freedoms = np.maximum(rows - ranks, 0).astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        variances = np.where(freedoms > 0.0, rests / freedoms, np.nan) / (edge * edge)
    has_normal = (frames != 0.0).any(axis=1)
    chosen = chosen[has_normal]
    return Survey(
        vertices=chosen,
        positions=mesh.vertices[chosen] / edge,
        variances=variances[has_normal],
        freedoms=freedoms[has_normal],
        normals=frames[has_normal],
        offsets=offsets[has_normal] / edge,
    )


# Regions of a mesh, by farthest point sampling of their centres

BLOCK_VERTICES = 1 << 14
"""Number of vertices whose distances to all regions are in memory at once."""


def split_regions(vertices: Floats, count: int) -> tuple[Longs, Longs]:
    """Choose ``count`` of the vertices (c, 3) as centres of regions by farthest point sampling;
    returns their indices, and the nearest centre of each vertex (c,)."""
    axes = np.ascontiguousarray(vertices.T)
    # The first one is the farthest from the mean.
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
    """The index of the nearest of the centres (r, 3) for each of the vertices (n, 3)."""
    nearest = np.empty(len(vertices), dtype=np.int64)
    for first in range(0, len(vertices), BLOCK_VERTICES):
        axes = np.ascontiguousarray(vertices[first : first + BLOCK_VERTICES].T)
        distances = [_squared_distances(axes, middle) for middle in middles]
        nearest[first : first + BLOCK_VERTICES] = np.argmin(distances, axis=0)
    return nearest


def _squared_distances(axes: Floats, point: Floats) -> Floats:
    """Squared distances (n,) of positions, one row for each axis (3, n), from a point (3,)."""
    x, y, z = axes[0] - point[0], axes[1] - point[1], axes[2] - point[2]
    distances: Floats = x * x + y * y + z * z
    return distances


# The level of white noise

MIN_PATCHES, MAX_PATCHES, VERTICES_PER_PATCH = 1536, 4096, 12
"""Polynomials are fitted around one in so many vertices, within these bounds.  Patches of twenty
then cover each vertex once or twice, and more of them would add little."""

FLATTEST = 0.2
"""Share of places that counts as flat: smaller ones measure patched holes, larger ones texture."""

MARGIN = 1.03
"""Factor of the levels by fits over one-rings, which scatter because they have few degrees of
freedom: without it the smallest of several levels would be too low."""

TEXTURE, TEXTURE_BOUND, MAX_TEXTURE = 0.5, 2.0, 0.75
"""Variance of texture in the best fit, as a share of the additional variance of the next coarser
fit: measured on clean scans, and for the lower end of the interval; and the largest share of the
variance that counts as texture."""

TOO_MUCH, TOO_LITTLE, SPREAD = 0.1, 0.05, 0.1
"""Shares of the level that the lower end of the interval allows for creases among the flattest
places, and the upper end for errors of normals by noise and for undetected spikes."""

FAR_OUT, FAR_OUT_EXCESS, MIN_TAIL = 0.01, 0.08, 0.008
"""Share of the vertices in the tail under Gaussian noise; their excess variance as a share of that
of the noise; and excess of the tail above which noise is impulsive."""

NEGLIGIBLE, DOUBTFUL = 0.005, 0.05
"""Mean edge lengths: levels below the first one are invisible; an interval from 0 to less than the
second one is negligible, because all may be texture."""

VERTICES_PER_REGION, MAX_REGIONS, MIN_PLACES = 800, 16, 48
"""Vertices per region, the largest number of regions, and the places that a region needs."""


@dataclass(frozen=True, eq=False)
class Fits:
    """The result of ``kernels.patch_fits.fit_patches``."""

    variances: Floats
    freedoms: NDArray[np.int32]
    gaps: Floats
    ratios: Floats

    def level(self, fit: int, share: float) -> float:
        """Standard deviation of noise by one fit, file units, from the quantile ``share`` of its
        residuals; infinite if the fit has none."""
        freedoms = self.freedoms[:, fit]
        scaled = self.variances[:, fit] / chi_square_table(share)[freedoms]
        scaled = scaled[freedoms > 0]
        return math.sqrt(quantile(scaled, share)) if len(scaled) else math.inf

    def at(self, places: Flags) -> Fits:
        variances, freedoms = self.variances[places], self.freedoms[places]
        return Fits(variances, freedoms, self.gaps[places], self.ratios[places])


PLANE, NEAR, FAR, CUBIC = range(4)
"""The fits: plane and quadratic over the one-ring, quadratic and cubic over the two-ring."""


@dataclass(frozen=True, eq=False)
class WhiteEstimate:
    """The level by fits over one- and two-rings, if the noise is white; see ``NoiseLevel``."""

    # level, low, high, rms: the level, its interval, and with spikes, mean edge lengths
    level: float
    low: float
    high: float
    rms: float
    tail: float  # share of the vertices whose residual is in the tail
    is_negligible: bool
    places: Longs  # (c,) vertices around which the fits are
    regions: Floats  # (r,) levels of the regions, file units
    far: Flags  # (c,) whether the residual of the vertex is in the tail
    fits: Fits  # residuals of the fits at the places
    edge: float  # mean edge length, file units


def estimate_white(mesh: Mesh) -> WhiteEstimate:
    """The noise of a mesh on the assumption that it is white."""
    places = _choose_places(mesh)
    normals = mesh.vertex_normals("uniform", 1)
    fits = Fits(*fit_patches(places, mesh.vertices, normals, *mesh.topology.one_ring))
    edge = mesh.mean_edge_length
    far = fits.ratios > student(np.maximum(fits.freedoms[:, FAR] - 1.0, 1.0))
    n_judged = max(int((fits.ratios >= 0.0).sum()), 1)
    tail = float(far.sum()) / n_judged
    is_impulsive = tail > FAR_OUT + max(MIN_TAIL, 4.0 * math.sqrt(FAR_OUT / n_judged))

    near = math.inf if is_impulsive else fits.level(PLANE, FLATTEST)
    nearer = math.inf if is_impulsive else fits.level(NEAR, 0.5)
    coarse = fits.level(FAR, FLATTEST)
    best = _least(near, nearer, coarse, fits.level(CUBIC, FLATTEST))
    level = _without_texture(best, coarse)
    # A quantile has a larger error than a mean, and patches overlap.
    freedoms = max(min(9.0 * len(places), 0.5 * len(mesh.vertices)), 1.0)
    error = 2.5 * 1.6 / math.sqrt(2.0 * freedoms)
    low = math.sqrt(max(best * best - TEXTURE_BOUND * _excess_spread(coarse, best), 0.0))
    low *= max(1.0 - TOO_MUCH - error, 0.0)
    high = best * (1.0 + TOO_LITTLE + error)

    n_regions = min(max(len(mesh.vertices) // VERTICES_PER_REGION, 1), MAX_REGIONS)
    middles, labels = split_regions(mesh.vertices[places], n_regions)
    regions = _measure_regions(fits, labels, len(middles), level, is_impulsive)
    lowest, highest = float(regions.min()), float(regions.max())
    if are_uneven(lowest / edge, highest / edge):
        shares = np.bincount(labels, minlength=len(middles)) / len(labels)
        level = max(level, math.sqrt(float((shares * regions * regions).sum())))
        low, high = min(low, lowest), max(high, highest)

    excess = float(np.maximum(fits.gaps[far] ** 2 - level * level, 0.0).sum()) / n_judged
    rms = math.sqrt(max(level * level, (1.0 - FAR_OUT_EXCESS) * level * level + excess))
    if is_impulsive:
        high = max(high, rms * (1.0 + SPREAD + error))
    is_small = level / edge < NEGLIGIBLE or (low == 0.0 and high < DOUBTFUL * edge)
    return WhiteEstimate(
        level=level / edge,
        low=min(low, level) / edge,
        high=high / edge,
        rms=rms / edge,
        tail=tail,
        is_negligible=is_small and not are_spikes(rms / edge, tail),
        places=places,
        regions=regions,
        far=far,
        fits=fits,
        edge=edge,
    )


def _choose_places(mesh: Mesh) -> Longs:
    """Sampled vertices (c,), evenly over the vertex numbers but with irregular steps, because
    numbers may follow a pattern."""
    has_ring = mesh.topology.has_ring
    # Usually all have a one-ring, and no array of vertex numbers is needed.
    used = None if has_ring.all() else np.flatnonzero(has_ring)
    n_used = len(has_ring) if used is None else len(used)
    wanted = min(max(n_used // VERTICES_PER_PATCH, MIN_PATCHES), MAX_PATCHES)
    if n_used <= wanted:
        return np.arange(n_used) if used is None else used
    count = np.arange(wanted)
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    at = ((count + count * golden % 1.0) * (n_used / wanted)).astype(np.int64)
    return at if used is None else used[at]


def _least(plane: float, near: float, far: float, cubic: float) -> float:
    """The smallest level of the fits; 0 if there is none."""
    least = min(far, cubic, plane * MARGIN, near * MARGIN)
    return least if least < math.inf else 0.0


def _excess_spread(coarse: float, best: float) -> float:
    """Additional variance of the coarse fit over the best one, which is texture."""
    return max(coarse * coarse - best * best, 0.0) if coarse < math.inf else 0.0


def _without_texture(best: float, coarse: float) -> float:
    """The level of the best fit without its texture."""
    texture = min(TEXTURE * _excess_spread(coarse, best), MAX_TEXTURE * best * best)
    return math.sqrt(best * best - texture)


def _measure_regions(
    fits: Fits, labels: Longs, n_regions: int, level: float, is_impulsive: bool
) -> Floats:
    """Level of each region (r,), file units; ``level`` is that of the mesh."""
    # With impulses hardly any place is without a spike, so the quantile is the median.
    share = 0.5 if is_impulsive else FLATTEST

    def compared(fits: Fits) -> float:
        coarse = fits.level(FAR, share)
        best = _least(math.inf, math.inf, coarse, fits.level(CUBIC, share))
        return _without_texture(best, coarse)

    everywhere = compared(fits)
    levels = np.full(n_regions, level)
    if everywhere > 0.0:
        for region in range(n_regions):
            among = labels == region
            if among.sum() >= MIN_PLACES:
                levels[region] = level * compared(fits.at(among)) / everywhere
    return levels
