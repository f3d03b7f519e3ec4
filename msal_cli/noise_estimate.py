"""How much noise there is on a mesh.

Around some thousands of vertices polynomials are fitted to the surface.  What they leave over is
noise, and what the surface itself has beyond the polynomial: texture, creases.  White noise leaves
the same to every fit, by its degrees of freedom, and everywhere; texture leaves more to coarser
fits, and little to the flattest places.  So the level is what the fit with the least leaves over at
the flattest fifth of the places, set right for having looked there.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]
Places = NDArray[np.int64]

FEWEST_PATCHES, MOST_PATCHES = 1536, 4096
VERTICES_PER_PATCH = 12
"""Around one of so many vertices polynomials are fitted, within these bounds: patches of twenty
then cover each vertex once or twice, and more of them would hardly tell more.  A fit takes
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

MOST_TEXTURE = 0.75
"""Share of the variance that is taken for texture, at most."""

TEXTURE_BOUND = 2.0
"""The same as ``TEXTURE`` where texture counts for most of all; for the lower end."""

TOO_MUCH = 0.1
"""What the lower end allows for creases, which the flattest fifth of the places may still have."""

TOO_LITTLE = 0.05
"""What the upper end allows for normals that noise has turned."""

FAR_OUT = 0.01
"""Share of the vertices that Gaussian noise puts as far out as counts for the tail."""

LEAST_TAIL = 0.008
"""Excess of the tail over that from which noise is impulsive."""

FAR_OUT_EXCESS = 0.08
"""What those vertices add of themselves, in variances of Gaussian noise."""

NEGLIGIBLE = 0.005
"""Mean edge lengths below which no noise can be seen."""

SURE = 0.025
"""Mean edge lengths: upper end of the interval below which there is certainly no noise."""

DOUBTFUL = 0.05
"""Mean edge lengths: noise whose interval goes from 0 to less is none to speak of, for all of it
may be texture."""

SPREAD = 0.1
"""What the upper end allows for spikes that do not stand out."""

SPIKES = 0.07
"""Mean edge lengths, root mean square, from which single spikes are noise to speak of."""

FEWEST_SPIKES = 0.005
"""Share of the vertices that have to stand out for that."""

VERTICES_PER_REGION = 800
MOST_REGIONS = 16
FEWEST_PLACES = 48
"""Places that a region needs."""

UNEVEN = 2.0
"""Ratio of the most to the least noisy region from which noise is not the same everywhere."""

BLOCK_VERTICES = 1 << 14
"""Vertices whose distances to all regions stand in memory at a time."""

IMPULSIVE_TAIL, IMPULSIVE_EXCESS = 0.02, 1.03
"""Share of outliers, and their root mean square over the robust level, from which on the noise is
taken for impulsive."""

LEAST_UNEVEN = 0.05
"""Mean edge lengths that the most noisy region needs for that."""


@dataclass(frozen=True)
class NoiseLevel:
    """The noise of a mesh: the standard deviation along its normals.

    Attributes
    ----------
    mean_edges : in mean edge lengths of the mesh as it is.
    low, high : an interval for it, mean edge lengths: from where all that may be texture is, to
        where none is, and beyond by the sampling error.
    file_units : the same level in file units.
    clean_edges : in mean edge lengths of the surface without the noise, which are shorter.
    rms_edges : root mean square with single spikes, which the level leaves out, mean edge lengths.
    tail : share of the vertices, 0 to 1, further out among the others than 99 in 100 are with
        Gaussian noise; 0.01 for that, 0.02 and more for impulsive noise.
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

    def is_below(self, edges: float) -> bool:
        """Whether neither the level nor single spikes reach so many mean edge lengths."""
        are_spikes = _are_spikes(self.rms_edges, self.tail) and self.rms_edges >= edges
        return self.mean_edges < edges and not are_spikes

    @property
    def is_impulsive(self) -> bool:
        """Whether it has more outliers than Gaussian noise would."""
        return self.tail >= IMPULSIVE_TAIL and self.rms_edges > IMPULSIVE_EXCESS * self.mean_edges

    @property
    def is_uneven(self) -> bool:
        """Whether some regions have noise that others have not."""
        return _are_uneven(self.lowest, self.highest)


@dataclass(frozen=True, eq=False)
class _Fits:
    """What ``core.local_fits.fitted`` gives for the places."""

    variances: Floats
    freedoms: NDArray[np.int32]
    gaps: Floats
    ratios: Floats

    def level(self, fit: int, share: float, among: NDArray[np.bool_] | None = None) -> float:
        """Standard deviation by one fit at the flattest ``share`` of the places, file units;
        infinite where it has none."""
        from msal_cli.core.distributions import chi_square

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


def estimated(mesh: Mesh) -> NoiseLevel:
    """The noise of a mesh.

    White noise of 0.02 to 0.7 mean edge lengths along the normals, or in all directions, is told
    within some per cent.  Detail as fine as the mesh itself cannot be told from noise: the interval
    says how much of the level may be that.  It does not depend on how the mesh is turned, moved or
    scaled, nor on the number of threads.  Its cost hardly depends on the size of the mesh.
    """
    return _told(mesh)[0]


def regional(mesh: Mesh) -> Floats:
    """Level of the noise around each vertex (n,), file units: that of the region it lies in.

    Vertices that no face uses have 0.
    """
    _, middles, levels = _told(mesh)
    return np.where(mesh.links.has_ring, levels[_nearest(mesh.vertices, middles)], 0.0)


def _told(mesh: Mesh) -> tuple[NoiseLevel, Floats, Floats]:
    """The noise of a mesh, the middles of its regions (r, 3) and their levels (r,), file units."""
    places = _places(mesh)
    fits = _fits(mesh, places)
    edge = mesh.mean_edge_length
    tail, far = _tail(fits)
    n_judged = max(int((fits.ratios >= 0.0).sum()), 1)
    is_impulsive = tail > FAR_OUT + max(LEAST_TAIL, 4.0 * math.sqrt(FAR_OUT / n_judged))

    near = math.inf if is_impulsive else fits.level(PLANE, FLATTEST)
    nearer = math.inf if is_impulsive else fits.level(NEAR, 0.5)
    coarse = fits.level(FAR, FLATTEST)
    best = _least(near, nearer, coarse, fits.level(CUBIC, FLATTEST))
    level = _without_texture(best, coarse)
    # A quantile tells less than a mean of as many, and patches overlap.
    freedoms = max(min(9.0 * len(places), 0.5 * len(mesh.vertices)), 1.0)
    error = 2.5 * 1.6 / math.sqrt(2.0 * freedoms)
    low = math.sqrt(max(best * best - TEXTURE_BOUND * _excess(coarse, best), 0.0))
    low *= max(1.0 - TOO_MUCH - error, 0.0)
    high = best * (1.0 + TOO_LITTLE + error)

    middles, labels = _regions(mesh.vertices[places], len(mesh.vertices))
    regions = _levels(fits, labels, len(middles), level, is_impulsive)
    lowest, highest = float(regions.min()), float(regions.max())
    if _are_uneven(lowest / edge, highest / edge):
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
        clean_edges=_of_clean_edges(edges),
        rms_edges=rms / edge,
        tail=tail,
        is_negligible=is_small and not _are_spikes(rms / edge, tail),
        lowest=lowest / edge,
        highest=highest / edge,
        regions=len(regions),
    )
    return noise, mesh.vertices[places[middles]], regions


def _places(mesh: Mesh) -> Places:
    """Vertices around which to look, evenly over their numbers, but in no step with any pattern
    of them."""
    has_ring = mesh.links.has_ring
    # Nearly always all have, and numbers of all need not stand in memory.
    used = None if has_ring.all() else np.flatnonzero(has_ring)
    n_used = len(has_ring) if used is None else len(used)
    wanted = min(max(n_used // VERTICES_PER_PATCH, FEWEST_PATCHES), MOST_PATCHES)
    if n_used <= wanted:
        return np.arange(n_used) if used is None else used
    count = np.arange(wanted)
    golden = (math.sqrt(5.0) - 1.0) / 2.0
    at = ((count + count * golden % 1.0) * (n_used / wanted)).astype(np.int64)
    return at if used is None else used[at]


def _fits(mesh: Mesh, places: Places) -> _Fits:
    from msal_cli.core.local_fits import fitted

    links = mesh.links
    normals = mesh.vertex_normals("uniform", 1)
    return _Fits(*fitted(places, mesh.vertices, normals, links.ring_start, links.ring))


def _least(plane: float, near: float, far: float, cubic: float) -> float:
    """The least of what the fits tell; 0 where none tells anything."""
    least = min(far, cubic, plane * MARGIN, near * MARGIN)
    return least if least < math.inf else 0.0


def _excess(coarse: float, best: float) -> float:
    """Variance that the coarse fit leaves over beyond the best one; only texture explains it."""
    return max(coarse * coarse - best * best, 0.0) if coarse < math.inf else 0.0


def _without_texture(best: float, coarse: float) -> float:
    """A level less the texture that is in it."""
    texture = min(TEXTURE * _excess(coarse, best), MOST_TEXTURE * best * best)
    return math.sqrt(best * best - texture)


def _tail(fits: _Fits) -> tuple[float, NDArray[np.bool_]]:
    """The share of the vertices that are far out, and which they are."""
    from msal_cli.core.distributions import student

    bounds = student(np.maximum(fits.freedoms[:, FAR] - 1.0, 1.0))
    far = fits.ratios > bounds
    judged = int((fits.ratios >= 0.0).sum())
    return (float(far.sum()) / judged if judged else 0.0), far


def _regions(vertices: Floats, n_vertices: int) -> tuple[Places, Places]:
    """Which of the vertices (c, 3), taken from all ``n_vertices``, are middles of regions, each as
    far from the others as can be; and which middle is the nearest to each vertex (c,)."""
    wanted = min(max(n_vertices // VERTICES_PER_REGION, 1), MOST_REGIONS)
    axes = np.ascontiguousarray(vertices.T)
    # The first one is the furthest from where they are on average.
    distances = _squared_distances(axes, axes.mean(axis=1))
    middles = np.empty(wanted, dtype=np.int64)
    labels = np.zeros(len(vertices), dtype=np.int64)
    for number in range(wanted):
        middles[number] = distances.argmax()
        from_it = _squared_distances(axes, vertices[middles[number]])
        if number == 0:
            distances = from_it
            continue
        labels[from_it < distances] = number
        np.minimum(distances, from_it, out=distances)
    return middles, labels


def _nearest(vertices: Floats, middles: Floats) -> Places:
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


def _levels(
    fits: _Fits, labels: Places, n_regions: int, level: float, is_impulsive: bool
) -> Floats:
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
            if among.sum() >= FEWEST_PLACES:
                levels[region] = level * compared(among) / everywhere
    return levels


def _are_spikes(rms: float, tail: float) -> bool:
    """Whether spikes with this root mean square, in mean edge lengths, are noise to speak of; the
    tip of a cone or two corners are not."""
    return rms >= SPIKES and tail >= FEWEST_SPIKES


def _are_uneven(lowest: float, highest: float) -> bool:
    """Whether levels of regions, in mean edge lengths, are not those of one noise."""
    return highest > LEAST_UNEVEN and highest > UNEVEN * lowest


@functools.cache
def _lengthening() -> tuple[Floats, Floats]:
    """Noise in mean edge lengths of the clean surface, and in those of the noisy one: edges across
    which the heights differ by noise are longer, on average sqrt(1 + 2 s^2 z^2) with normal z."""
    clean = np.linspace(0.0, 2.0, 201)
    z = np.linspace(-6.0, 6.0, 241)
    weights = np.exp(-0.5 * z * z)
    longer = np.sqrt(1.0 + 2.0 * np.outer(clean, z) ** 2) @ (weights / weights.sum())
    return clean, clean / longer


def _of_clean_edges(edges: float) -> float:
    clean, noisy = _lengthening()
    return float(np.interp(edges, noisy, clean))
