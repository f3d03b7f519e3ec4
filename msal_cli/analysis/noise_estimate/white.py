"""How much noise there is on a mesh.

Around some thousands of vertices polynomials are fitted to the surface.  What they leave over is
noise, and what the surface itself has beyond the polynomial: texture, creases.  White noise leaves
the same to every fit, by its degrees of freedom, and everywhere; texture leaves more to coarser
fits, and little to the flattest places.  So the level is what the fit with the least leaves over at
the flattest fifth of the places, set right for having looked there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.level import (
    NoiseLevel,
    are_spikes,
    are_uneven,
    to_clean_edges,
)
from msal_cli.analysis.noise_estimate.survey import count_regions, split_regions
from msal_cli.arrays import Floats, Longs

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh


MIN_PATCHES, MAX_PATCHES = 1536, 4096
VERTICES_PER_PATCH = 12
"""Around one of so many vertices polynomials are fitted, within these bounds: patches of twenty
then cover each vertex once or twice, and more of them would add little.  A fit takes
microseconds."""

FLATTEST = 0.2
"""Share of the places whose surface is taken for flat enough: less, and patched holes would count
for the whole; more, and texture would."""

MARGIN = 1.03
"""What fits over the one-ring leave over counts for so much: they have fewer degrees of freedom,
and the least of several that differ by chance would be too little."""

TEXTURE = 0.5
"""Texture in what the best fit leaves over, as variance, for each unit that the next coarser fit
leaves more; measured on clean scans, see docs/noise.md."""

MAX_TEXTURE = 0.75
"""Share of the variance that is taken for texture, at most."""

TEXTURE_BOUND = 2.0
"""The same as ``TEXTURE`` where texture counts for most of all; for the lower end."""

TOO_MUCH = 0.1
"""What the lower end allows for creases, which the flattest fifth of the places may still have."""

TOO_LITTLE = 0.05
"""What the upper end allows for normals that noise has turned."""

FAR_OUT = 0.01
"""Share of the vertices that Gaussian noise puts as far out as counts for the tail."""

MIN_TAIL = 0.008
"""Excess of the tail over that from which noise is impulsive."""

FAR_OUT_EXCESS = 0.08
"""What those vertices add of themselves, in variances of Gaussian noise."""

NEGLIGIBLE = 0.005
"""Mean edge lengths below which no noise can be seen."""

DOUBTFUL = 0.05
"""Mean edge lengths: noise whose interval goes from 0 to less is none to speak of, for all of it
may be texture."""

SPREAD = 0.1
"""What the upper end allows for spikes that are not detected."""

MIN_PLACES = 48
"""Places that a region needs."""


@dataclass(frozen=True, eq=False)
class Fits:
    """What ``kernels.patch_fits.fit_patches`` gives for the places."""

    variances: Floats
    freedoms: NDArray[np.int32]
    gaps: Floats
    ratios: Floats

    def level(self, fit: int, share: float, among: NDArray[np.bool_] | None = None) -> float:
        """Standard deviation by one fit at the flattest ``share`` of the places, file units;
        infinite where it has none."""
        from msal_cli.kernels.quantiles import chi_square

        has = self.freedoms[:, fit] > 0
        if among is not None:
            has &= among
        if not has.any():
            return math.inf
        scaled = self.variances[has, fit] / chi_square(share)[self.freedoms[has, fit]]
        rank = int(share * (len(scaled) - 1))
        return math.sqrt(float(np.partition(scaled, rank)[rank]))


PLANE, NEAR, FAR, CUBIC = range(4)
"""The fits: a plane and degree 2 over the one-ring, degrees 2 and 3 over the two-ring."""


@dataclass(frozen=True, eq=False)
class WhiteEstimate:
    """The level by fits over one- and two-rings, which takes the noise for white.

    Attributes
    ----------
    level : what ``NoiseLevel`` says of it.
    places : (c,) vertices around which the fits are.
    labels : (c,) region of each of them.
    middles : (r, 3) positions of the regions' middles.
    regions : (r,) levels of the regions, file units.
    far : (c,) whether a vertex is far out among its neighbours.
    fits : what the fits leave over at the places.
    edge : mean edge length, file units.
    """

    level: NoiseLevel
    places: Longs
    labels: Longs
    middles: Floats
    regions: Floats
    far: NDArray[np.bool_]
    fits: Fits
    edge: float


def estimate_white(mesh: Mesh) -> WhiteEstimate:
    """The noise of a mesh as far as it is white."""
    places = _places(mesh)
    fits = _fits(mesh, places)
    edge = mesh.mean_edge_length
    tail, far = _tail(fits)
    n_judged = max(int((fits.ratios >= 0.0).sum()), 1)
    is_impulsive = tail > FAR_OUT + max(MIN_TAIL, 4.0 * math.sqrt(FAR_OUT / n_judged))

    near = math.inf if is_impulsive else fits.level(PLANE, FLATTEST)
    nearer = math.inf if is_impulsive else fits.level(NEAR, 0.5)
    coarse = fits.level(FAR, FLATTEST)
    best = _least(near, nearer, coarse, fits.level(CUBIC, FLATTEST))
    level = _without_texture(best, coarse)
    # A quantile tells less than a mean of as many, and patches overlap.
    freedoms = max(min(9.0 * len(places), 0.5 * len(mesh.vertices)), 1.0)
    error = 2.5 * 1.6 / math.sqrt(2.0 * freedoms)
    low = math.sqrt(max(best * best - TEXTURE_BOUND * _excess_spread(coarse, best), 0.0))
    low *= max(1.0 - TOO_MUCH - error, 0.0)
    high = best * (1.0 + TOO_LITTLE + error)

    middles, labels = split_regions(mesh.vertices[places], count_regions(len(mesh.vertices)))
    regions = _levels(fits, labels, len(middles), level, is_impulsive)
    lowest, highest = float(regions.min()), float(regions.max())
    if are_uneven(lowest / edge, highest / edge):
        shares = np.bincount(labels, minlength=len(middles)) / len(labels)
        level = max(level, math.sqrt(float((shares * regions * regions).sum())))
        low, high = min(low, lowest), max(high, highest)

    excess = float(np.maximum(fits.gaps[far] ** 2 - level * level, 0.0).sum()) / n_judged
    rms = math.sqrt(max(level * level, (1.0 - FAR_OUT_EXCESS) * level * level + excess))
    if is_impulsive:
        high = max(high, rms * (1.0 + SPREAD + error))
    edges = level / edge
    is_small = edges < NEGLIGIBLE or (low == 0.0 and high < DOUBTFUL * edge)
    noise = NoiseLevel(
        mean_edges=edges,
        low=min(low, level) / edge,
        high=high / edge,
        file_units=level,
        clean_edges=to_clean_edges(edges),
        rms_edges=rms / edge,
        tail=tail,
        is_negligible=is_small and not are_spikes(rms / edge, tail),
        lowest=lowest / edge,
        highest=highest / edge,
        regions=len(regions),
    )
    return WhiteEstimate(
        noise, places, labels, mesh.vertices[places[middles]], regions, far, fits, edge
    )


def _places(mesh: Mesh) -> Longs:
    """Vertices around which to look, evenly over their numbers, but in no step with any pattern
    of them."""
    has_ring = mesh.topology.has_ring
    # Nearly always all have, and no array of their numbers is needed.
    used = None if has_ring.all() else np.flatnonzero(has_ring)
    n_used = len(has_ring) if used is None else len(used)
    wanted = min(max(n_used // VERTICES_PER_PATCH, MIN_PATCHES), MAX_PATCHES)
    if n_used <= wanted:
        return np.arange(n_used) if used is None else used
    count = np.arange(wanted)
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    at = ((count + count * golden % 1.0) * (n_used / wanted)).astype(np.int64)
    return at if used is None else used[at]


def _fits(mesh: Mesh, places: Longs) -> Fits:
    from msal_cli.kernels.patch_fits import fit_patches

    links = mesh.topology
    normals = mesh.vertex_normals("uniform", 1)
    return Fits(*fit_patches(places, mesh.vertices, normals, links.ring_start, links.ring))


def _least(plane: float, near: float, far: float, cubic: float) -> float:
    """The least level of the fits; 0 where there is none."""
    least = min(far, cubic, plane * MARGIN, near * MARGIN)
    return least if least < math.inf else 0.0


def _excess_spread(coarse: float, best: float) -> float:
    """Variance that the coarse fit leaves over beyond the best one; only texture explains it."""
    return max(coarse * coarse - best * best, 0.0) if coarse < math.inf else 0.0


def _without_texture(best: float, coarse: float) -> float:
    """A level less the texture that is in it."""
    texture = min(TEXTURE * _excess_spread(coarse, best), MAX_TEXTURE * best * best)
    return math.sqrt(best * best - texture)


def _tail(fits: Fits) -> tuple[float, NDArray[np.bool_]]:
    """The share of the vertices that are far out, and which they are."""
    from msal_cli.kernels.quantiles import student

    bounds = student(np.maximum(fits.freedoms[:, FAR] - 1.0, 1.0))
    far = fits.ratios > bounds
    judged = int((fits.ratios >= 0.0).sum())
    return (float(far.sum()) / judged if judged else 0.0), far


def _levels(fits: Fits, labels: Longs, n_regions: int, level: float, is_impulsive: bool) -> Floats:
    """Level of each region (r,), file units, where that of all is ``level``; a region with too few
    places has that."""
    # Few places of a region have no spike.
    share = 0.5 if is_impulsive else FLATTEST

    def compared(among: NDArray[np.bool_] | None) -> float:
        coarse = fits.level(FAR, share, among)
        best = _least(math.inf, math.inf, coarse, fits.level(CUBIC, share, among))
        return _without_texture(best, coarse)

    everywhere = compared(None)
    levels = np.full(n_regions, level)
    if everywhere > 0.0:
        for region in range(n_regions):
            among = labels == region
            if among.sum() >= MIN_PLACES:
                levels[region] = level * compared(among) / everywhere
    return levels
