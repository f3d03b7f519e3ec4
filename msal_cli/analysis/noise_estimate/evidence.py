"""Features for the classifier that tell noise from design and texture.

On a scan noise is everywhere: residuals of fits have a floor, at each vertex and over each number
of rings, and heights of neighbours are negatively correlated.  Designs have faces that are flat up
to rounding, repeated lengths, and curvature that ends at edges.  All features are free of scale:
the first are logarithms of levels in mean edge lengths, the others of ratios to the median residual
of quadratics over two rings.

White noise leaves the same residual variance over any number of rings.  Noise averaged over closed
one-rings leaves little to fits over few rings, and more to wider ones, as ``LEFT`` has it.  The
residual of the surface itself grows with the number of rings too, but differs over the surface,
where noise has a floor (``SHARP``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.axes import (
    AxisEvidence,
    StepEvidence,
    find_axis,
    find_main_offset,
    group_places,
    measure_steps,
    weigh_axis,
)
from msal_cli.analysis.noise_estimate.fits import (
    FAR,
    FOUR,
    ONE,
    SIX,
    THREE,
    TWO,
    Survey,
    WhiteEstimate,
    chi_square_quantile,
    quantile,
    ring_offsets,
    split_regions,
    take_survey,
)
from msal_cli.arrays import Floats, Longs
from msal_cli.kernels.geometry import distances
from msal_cli.kernels.quantiles import median, quantiles
from msal_cli.light_dataclass import dataclass

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

# Over how many rings noise is correlated

LEFT = np.array(
    [
        [1.0, 1.0, 1.0, 1.0, 1.0],
        [0.2857, 0.3110, 0.3471, 0.5021, 0.7007],
        [0.0841, 0.0957, 0.1111, 0.2421, 0.4846],
        [0.0418, 0.0437, 0.0487, 0.1359, 0.3547],
        [0.0263, 0.0245, 0.0255, 0.0829, 0.2661],
    ]
)
"""Residual variance per degree of freedom of the fits of the survey, for noise of variance 1
averaged 0 to 4 times over closed one-rings of a regular triangle grid (r, fit)."""

FREEDOMS = np.array(
    [
        [4.0, 13.0, 27.0, 51.0, 117.0],
        [4.0, 10.3, 16.9, 22.0, 39.4],
        [3.6, 6.2, 9.2, 11.8, 20.2],
        [3.2, 4.9, 7.1, 9.3, 15.3],
        [3.1, 4.5, 6.4, 8.3, 12.9],
    ]
)
"""Degrees of freedom of the chi-square distribution with the same mean and variance (r, fit)."""

FLOOR, FLAT, SEEN = 0.05, 0.2, 0.35
"""Quantiles of the variances by which the level at each scale is estimated, and the quantile of
places without creases and texture that ``FLAT`` of all usually is."""

WEIGHTS = np.array([0.0, 1.0, 1.0, 1.0, 0.7])
"""Weights of the fits.  That over one ring follows most of the noise itself, and has 0."""

ABOVE, MAX_ABOVE = np.array([0.6, 0.6, 0.5, 0.25, 0.08]), 0.5
"""Weight of variance above the expected one, by fit, and its largest squared error that counts;
variance below it has weight 1.  The surface adds to the residual variance, and never reduces it."""

FINE = np.array([0.97, 0.79, 0.40, 0.27, 0.20])
WHITE_FINE, FINE_WEIGHT, MAX_FINE = 0.88, 0.1, 0.03
"""The level of white noise over the level by the fit over two rings, by the number of averages,
measured with noise of 0.2 on 12 shapes; the ratio above which noise is not correlated; the weight
of the squared error of its logarithm, and the largest value that counts."""

MIN_RISE = 1.2
"""Smallest ratio of the levels by fits over four and over two rings that correlated noise has."""

PER_RING, DOUBT = 0.02, 0.006
"""Reduction of the misfit that one more ring needs, because the surface looks like more rings; and
the difference that divides the weight of a number of rings in the level by e."""

EXCLUDED = 1.0
"""Added to the misfit of a number of rings that is excluded."""

LOUD_LEVEL = 0.12
SHARP = np.array([0.0, 0.58, 0.68, 0.705, 0.38])
SHARP_LOUD = np.array([0.0, 0.58, 0.68, 0.665, 0.38])
"""Smallest ratios of standard deviations at the quantiles ``FLOOR`` and ``FLAT``, by fit, of noise
of any kind; texture and shape are below one of them.  The latter are for levels above
``LOUD_LEVEL`` mean edge lengths, which fine texture seldom has."""

PATTERN = np.array([1.0, 1.0, 1.0, 0.92, 0.945])
"""Sharpness, by fit, that repeating patterns exceed and correlated noise does not."""

RELIEF_SHARP, RELIEF_GROWTH, SMOOTH_GROWTH = 0.8, 1.22, 0.97
"""If sharpness of fits over six rings, and growth of the level from four rings to six relative to
that of noise, are both greater, there is relief everywhere; or if the ratio of the residuals of
cubics over three rings and quadratics over two is less: correlated noise has 1 to 1.16."""


@dataclass(frozen=True)
class Colour:
    """The correlation length of noise, in rings, and what it is derived from."""

    rings: int  # 0 to 4
    level: float  # standard deviation, mean edge lengths
    misfit: float  # root mean square error of the logarithms of standard deviations
    margin: float  # by how much the misfit of the next best number of rings is greater
    sharpness: Floats  # (5,), by fit
    is_floor: bool  # whether residuals are as uniform as only noise is, and no pattern
    is_relief: bool  # whether smooth relief all over the surface would leave the same
    is_pattern: bool  # whether residuals are more uniform than correlated noise: a pattern


def find_colour(
    survey: Survey, scale: Floats | None = None, fine: float | None = None
) -> Colour | None:
    """The colour of the noise, which is uniform except for ``scale`` (c,), by which variances are
    divided; None if there is too little data.  ``fine`` is the level of white noise, mean edge
    lengths, if it is that of the whole mesh."""
    floors = np.array([survey.quantile(fit, FLOOR, scale) for fit in range(5)])
    flats = np.array([survey.quantile(fit, FLAT, scale) for fit in range(5)])
    has = np.isfinite(flats) & (flats > 1e-12)
    if has.sum() < 3:
        return None
    flats, floors = np.where(has, flats, 1.0), np.where(has, np.maximum(floors, 0.0), 1.0)
    sharpness = np.where(has, np.sqrt(floors / flats), 0.0)
    expected = LEFT * chi_square_quantile(FREEDOMS, SEEN)
    levels = np.log(flats)[None] - np.log(expected)
    weights = np.where(has, WEIGHTS, 0.0)
    # Costs of log variances on a grid around the weighted mean, for each number of rings.
    steps = np.linspace(-1.5, 1.0, 126)
    middle = (levels * weights).sum(axis=1) / weights.sum()
    tried = middle[:, None] + steps[None]
    errors = levels[:, :, None] - tried[:, None, :]
    squares = errors * errors
    above = ABOVE[None, :, None] * np.minimum(squares, MAX_ABOVE)
    costs = np.where(errors > 0.0, above, squares)
    totals = (weights[None, :, None] * costs).sum(axis=1) / weights.sum()
    misfits = 0.5 * np.sqrt(totals.min(axis=1))
    by_scale = np.sqrt(flats / chi_square_quantile(FREEDOMS[0], FLAT))
    if fine is not None and has[TWO]:
        ratio = max(fine / float(by_scale[TWO]), 0.1)
        totals += np.minimum(FINE_WEIGHT * np.log(ratio / FINE) ** 2, MAX_FINE)[:, None]
        if ratio > WHITE_FINE:
            totals[1:] += EXCLUDED
    if not (has[TWO] and has[FOUR] and by_scale[FOUR] > MIN_RISE * by_scale[TWO]):
        totals[1:] += EXCLUDED
    best = totals.argmin(axis=1)
    least = 0.5 * np.sqrt(totals[np.arange(len(best)), best])
    chosen = least + PER_RING * np.arange(len(best))
    rings = int(chosen.argmin())
    others = np.delete(chosen, rings)
    likely = np.exp((chosen[rings] - chosen) / DOUBT)
    logarithm = 0.5 * float(likely @ tried[np.arange(len(best)), best] / likely.sum())
    level = math.exp(logarithm)
    is_pattern = rings > 0 and bool((sharpness > PATTERN).any())
    least_sharpness = SHARP_LOUD if level > LOUD_LEVEL else SHARP
    # Whether residuals grow more than those of such noise.  So do creases, but not everywhere.
    growth = float(by_scale[SIX] / by_scale[FOUR])
    growth /= math.sqrt(LEFT[rings, SIX] / LEFT[rings, FOUR])
    is_wide = sharpness[SIX] > RELIEF_SHARP and growth > RELIEF_GROWTH
    is_relief = bool(is_wide or by_scale[THREE] < SMOOTH_GROWTH * by_scale[TWO])
    return Colour(
        rings=rings,
        level=level,
        misfit=float(misfits[rings]),
        margin=float(others.min() - chosen[rings]),
        sharpness=sharpness,
        is_floor=bool((sharpness >= least_sharpness).all()) and not is_pattern,
        is_relief=is_relief,
        is_pattern=is_pattern,
    )


# Levels by region, for uneven noise

MAX_REGIONS, MIN_PLACES = 16, 20
"""Largest number of regions of the survey, and the vertices that each has on average at least."""

REGION_SHARES, PURE = (0.1, 0.3, 0.4, 0.5), 0.3
"""Quantiles of the variances of a region: the second is for its level, the third for its share in
the level of the mesh.  The ratio of the first to the last is at least ``PURE`` in a region that is
not split between a quiet and a noisy part."""

UNEVEN, MIN_LOUD, LOUD_SHARE = 2.5, 0.05, 0.16
"""Smallest ratio of the levels of the most and the least noisy region, and smallest level of the
former, mean edge lengths, for uneven noise.  Regions with less than this share of its variance are
quiet."""


@dataclass(frozen=True, eq=False)
class Differences:
    """Variances of the regions of uneven noise, squared mean edge lengths."""

    middles: Longs  # (r,) the vertices of the survey that are centres
    lows: Floats  # (r,) variances for the levels of the regions
    mean: float  # mean variance over the mesh
    is_pure: NDArray[np.bool_]  # (r,) whether a region is not part quiet, part noisy
    # (c,) variance of the region of each vertex; 0 where the region is quiet or not pure
    scale: Floats


def find_differences(survey: Survey) -> Differences | None:
    """Variances by region; None if the noise is not uneven."""
    has = np.isfinite(survey.variances[:, : TWO + 1]).all(axis=1)
    count = min(MAX_REGIONS, int(has.sum()) // MIN_PLACES)
    if count < 2:
        return None
    middles, labels = split_regions(survey.positions, count)
    # Nearly all vertices have the same degrees of freedom.
    freedoms = np.array([median(column) for column in survey.freedoms[has, : TWO + 1].T])
    factors = np.array([chi_square_quantile(freedoms, share) for share in REGION_SHARES[1:3]])
    lows, means = np.zeros(len(middles)), np.zeros(len(middles))
    is_pure, known = np.zeros(len(middles), dtype=bool), np.zeros(len(middles), dtype=bool)
    for region in range(len(middles)):
        among = has & (labels == region)
        count = int(among.sum())
        if count < MIN_PLACES // 2:
            continue
        ranks = (np.array(REGION_SHARES) * (count - 1)).astype(int)
        few, low, some, half = np.sort(survey.variances[among, TWO])[ranks]
        known[region], is_pure[region] = True, few > PURE * half
        _, plane_low, plane_some, _ = np.sort(survey.variances[among, ONE])[ranks]
        # Shape adds to the wider fit, so the smaller one is used; its mean would be biased.
        lows[region] = min(low / factors[0, 1], plane_low / factors[0, 0])
        means[region] = math.sqrt(some / factors[1, 1] * plane_some / factors[1, 0])
    if known.sum() < 2:
        return None
    lowest, highest = math.sqrt(lows[known].min()), math.sqrt(lows[known].max())
    if highest < MIN_LOUD or highest < UNEVEN * lowest:
        return None
    middle = median(lows[known])
    lows, means = np.where(known, lows, middle), np.where(known, means, middle)
    scale = np.where(is_pure & (lows > LOUD_SHARE * highest**2), lows, 0.0)[labels]
    counts = np.bincount(labels, minlength=len(middles))
    mean = float(counts @ means / counts.sum())
    return Differences(middles, lows, mean, is_pure, scale)


# Spikes: impulses along the normals, and outliers in any direction


MIN_OUTLIERS, OUTLYING, TIMES_USUAL, USUAL = 0.004, 0.9, 3.5, 0.7
"""Share of the vertices above which those far off count as outliers, and the smallest distance of
one from the mean of its one-ring: in mean edge lengths, and as a multiple of the quantile ``USUAL``
of all distances."""


def outlying_share(mesh: Mesh, white: WhiteEstimate, survey: Survey) -> tuple[float, float]:
    """Share of the vertices that lie far from the mean of their one-ring, and the median of their
    tangential offsets, mean edge lengths; 0 and 0 if they are too few."""
    fewest = MIN_OUTLIERS * len(white.places)
    far = white.places[white.far]
    if len(far) <= fewest:
        return 0.0, 0.0
    lengths = np.sqrt((survey.offsets * survey.offsets).sum(axis=1))
    least = max(OUTLYING, TIMES_USUAL * quantile(lengths, USUAL))
    offsets = ring_offsets(mesh, far)[0] / white.edge
    squares = (offsets * offsets).sum(axis=1)
    is_out = squares > least * least
    if is_out.sum() <= fewest:
        return 0.0, 0.0
    along = (offsets * mesh.vertex_normals("uniform", 1)[far]).sum(axis=1)
    within = np.sqrt(np.maximum(squares - along * along, 0.0))
    # If there are many, ``white.far`` misses some, but they are as far off.
    share = max(float((lengths > least).mean()), float(is_out.sum()) / len(white.places))
    return share, median(within[is_out])


LEVELS = ("white", "rms", "colour", "axis", "axis_colour", "steps", "regions")
"""The first features: logarithms of levels in mean edge lengths by different measurements."""

SIZE = len(LEVELS)
"""Index of the feature that is the logarithm of the number of vertices."""

BOUNDARY_SHARE, FACING_SHARE, REGULAR_SHARE = SIZE + 1, SIZE + 3, SIZE + 4
"""Indices of the features that are the share of boundary vertices, that of normals within 90
degrees of their mean, and that of vertices of valence 6."""

OF_CLOSED = {BOUNDARY_SHARE: 0.0, SIZE + 2: 0.02, FACING_SHARE: 0.5}
"""The features of the border and of the directions of the normals, by index, of a closed mesh."""

EDGE_LENGTHS = SIZE + 8, SIZE + 12
"""Indices of the features that are logarithms of the 5 % and 95 % quantiles of the edge lengths."""

MISSING = -30.0
"""Value of a missing feature; all others are greater."""

SHARES = (0.02, 0.1, 0.25, 0.5, 0.75, 0.95)
OFFSET_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)
PAIRS = ((TWO, ONE), (THREE, TWO), (FOUR, THREE), (SIX, FOUR))
TINY = 1e-7
"""Mean edge lengths below which a deviation is a rounding error."""

MAX_COUNTED = 4_000  # vertices that count for the size of a mesh
MAX_REPEATED_VERTICES = 40_000  # whose edges are compared in length: sorting more takes too long
MAX_NEIGHBOUR_PLACES = 400  # vertices whose heights are compared with those of their neighbours

GRID = 0.025
"""Median displacement across the view, of vertices from the means of their one-rings, mean edge
lengths, below which a mesh is a grid seen from there: 0.002 to 0.022 on parts of range maps, 0.03
and more on parts of sculptures."""

MIN_COSINE = 0.1
"""Squared cosine of the normal to an axis above which a vertex shows noise along the axis."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Measurements of one mesh, and the features computed from them."""

    survey: Survey  # residuals of fits over one to six rings
    colour: Colour | None  # correlation of the noise, if it is uniform
    axis: AxisEvidence | None  # the best axis for noise along an axis
    steps: StepEvidence  # depths in steps
    differences: Differences | None  # levels by region, if the noise is uneven
    outliers: float  # share of the vertices that lie far off
    is_grid: bool  # whether the vertices are a regular grid, seen from one side
    # correlation of heights of neighbours in the roughest third; negative for white noise
    loud_correlation: float
    numbers: Floats  # (k,) for the classifier

    @property
    def edge_spread(self) -> float:
        """Ratio of the 95 % and 5 % quantiles of the edge lengths; 1 if unknown."""
        low, high = (float(self.numbers[number]) for number in EDGE_LENGTHS)
        return math.exp(high - low)


def gather_evidence(mesh: Mesh, white: WhiteEstimate) -> Evidence:
    """Compute all features of a mesh."""
    survey = take_survey(mesh, white.places)
    groups = group_places(survey)
    variances = white.fits.variances[:, FAR][white.fits.freedoms[:, FAR] > 0]
    # Median residual of quadratics over two rings, mean edge lengths.
    base = TINY
    if len(variances):
        base = max(math.sqrt(float(quantiles(variances, (0.5,))[0])) / white.edge, TINY)
    colour = find_colour(survey, fine=white.level)
    linked = fitted = axis = axis_colour = None
    if groups is not None:
        # The axes of the largest tangential displacements, and of the best fit of variances.
        linked = weigh_axis(survey, groups, find_main_offset(survey.offsets))
        fitted = find_axis(survey, groups)
        axis = linked if linked.is_linked or fitted is None else fitted
        cosines = (survey.normals @ axis.axis) ** 2
        axis_colour = find_colour(survey, np.where(cosines > MIN_COSINE, cosines, 0.0))
    steps = measure_steps(mesh, survey, groups)
    differences = find_differences(survey)
    outliers, within = outlying_share(mesh, white, survey)
    neighbours = _neighbour_numbers(mesh, survey)
    numbers = [
        _log(white.level),
        _log(white.rms),
        MISSING if colour is None else _log(colour.level),
        MISSING if axis is None else _log(axis.best_level),
        MISSING if axis_colour is None else _log(axis_colour.level),
        _log(steps.level) if steps.n_axes else MISSING,
        MISSING if differences is None else _log(math.sqrt(differences.mean)),
        *_size_numbers(mesh, survey, white, base),
        *_white_numbers(white, base),
        *_survey_numbers(survey, base),
        *_colour_numbers(colour, base),
        *_axis_numbers(linked, base),
        *_axis_numbers(fitted, base),
        *_colour_numbers(axis_colour, base),
        *_offset_numbers(survey, base),
        *neighbours,
        float(steps.n_axes),
        _log(steps.step),
        _log(steps.step, base),
        steps.voxel_share,
        float(steps.is_turned),
        steps.along_gain,
        steps.roughness,
        *_region_numbers(white, survey, differences, base),
        outliers,
        within,
    ]
    values = np.nan_to_num(
        np.array(numbers, dtype=np.float64), nan=MISSING, posinf=30.0, neginf=MISSING
    )
    return Evidence(
        survey=survey,
        colour=colour,
        axis=axis,
        steps=steps,
        differences=differences,
        outliers=outliers,
        is_grid=_is_grid(survey, axis),
        loud_correlation=neighbours[2],
        numbers=values,
    )


def _is_grid(survey: Survey, axis: AxisEvidence | None) -> bool:
    """Whether vertices are near the means of their one-rings across the view, which is the mean
    normal or the axis of the noise; see ``GRID``."""
    if not len(survey.offsets):
        return False
    mean = survey.normals.sum(axis=0)
    views = [mean / max(math.sqrt(float(mean @ mean)), TINY)]
    if axis is not None:
        views.append(axis.axis)
    squares = []
    for view in views:
        across = survey.offsets - np.outer(survey.offsets @ view, view)
        squares.append(median((across * across).sum(axis=1)))
    return min(squares) < GRID * GRID


def _log(value: float, base: float = 1.0) -> float:
    """Logarithm of a length in mean edge lengths, at least ``TINY``, over a base."""
    return math.log(max(value, TINY) / base) if math.isfinite(value) else MISSING


def _logs(values: Floats, base: float = 1.0) -> list[float]:
    return [_log(float(value), base) for value in values]


def _quantiles(values: Floats, shares: Sequence[float]) -> Floats:
    """The quantiles (s,); NaN without values, which becomes ``MISSING``."""
    return quantiles(values, shares) if len(values) else np.full(len(shares), np.nan)


def _size_numbers(mesh: Mesh, survey: Survey, white: WhiteEstimate, base: float) -> list[float]:
    topology = mesh.topology
    n_used = int(np.count_nonzero(topology.has_ring))
    normal = survey.normals.mean(axis=0) if len(survey.normals) else np.zeros(3)
    facing = float((survey.normals @ normal > 0.0).mean()) if len(survey.normals) else 0.0
    counts = np.diff(topology.ring_start)[white.places]
    return [
        math.log(min(max(n_used, 1), MAX_COUNTED)),
        float(topology.boundary[white.places].mean()) if len(white.places) else 0.0,
        math.sqrt(float(normal @ normal)),
        facing,
        float((counts == 6).mean()) if len(counts) else 0.0,
        float(counts.std()) if len(counts) else 0.0,
        _log(base),
        *_repeated_lengths(mesh, white.edge),
    ]


def _repeated_lengths(mesh: Mesh, edge: float) -> list[float]:
    """The share of edges with equal lengths, beyond chance, and quantiles of lengths."""
    starts, ring = mesh.topology.ring_start, mesh.topology.ring
    n = min(len(mesh.vertices), MAX_REPEATED_VERTICES)
    own, other = np.repeat(np.arange(n), np.diff(starts[: n + 1])), ring[: starts[n]]
    edges = mesh.vertices[own[other > own]], mesh.vertices[other[other > own]]
    lengths = np.sort(distances(*edges)) / edge
    if len(lengths) < 20:
        return [MISSING] * 6
    spread = quantiles(lengths, (0.05, 0.25, 0.5, 0.75, 0.95))
    low, high = spread[0], spread[-1]
    inner = lengths[(lengths >= low) & (lengths <= high)]
    gap = (high - low) / max(len(inner), 1)
    gaps = np.diff(inner)
    repeated = float((gaps <= 0.01 * gap).mean()) if gap > TINY and len(gaps) else 1.0
    return [repeated, *_logs(spread)]


def _white_numbers(white: WhiteEstimate, base: float) -> list[float]:
    fits = white.fits
    numbers = [
        *_logs(np.array([white.level, white.low, white.high]), base),
        white.tail,
        _log(white.rms, base),
        float(white.is_negligible),
    ]
    for fit in range(4):
        deviations = np.sqrt(fits.variances[:, fit][fits.freedoms[:, fit] > 0]) / white.edge
        numbers += _logs(_quantiles(deviations, SHARES), base)
        numbers += [
            float((deviations < bound).mean()) if len(deviations) else MISSING
            for bound in (1e-6, 1e-3)
        ]
    ratios = fits.ratios[fits.ratios >= 0.0]
    return numbers + (
        quantiles(ratios, (0.5, 0.9, 0.97, 0.99)).tolist() if len(ratios) else [0.0] * 4
    )


def _survey_numbers(survey: Survey, base: float) -> list[float]:
    numbers: list[float] = []
    for fit in range(5):
        variances = survey.variances[:, fit]
        variances = variances[np.isfinite(variances)]
        numbers += _logs(np.sqrt(_quantiles(variances, SHARES)), base)
    logs = 0.5 * np.log(np.maximum(survey.variances, TINY * TINY))
    widest = logs[:, SIX]
    known = np.isfinite(logs).all(axis=1)
    flat = known & (widest <= (quantiles(widest[known], (0.3,))[0] if known.any() else 0.0))
    for wide, narrow in PAIRS:
        ratios = logs[:, wide] - logs[:, narrow]
        numbers += _quantiles(ratios[np.isfinite(ratios)], (0.1, 0.5, 0.9)).tolist()
        some = ratios[flat]
        numbers += [median(some), float(some.std())] if len(some) else [MISSING] * 2
    return numbers


def _colour_numbers(colour: Colour | None, base: float) -> list[float]:
    if colour is None:
        return [MISSING] * 12
    return [
        float(colour.rings),
        _log(colour.level, base),
        colour.misfit,
        colour.margin,
        *colour.sharpness.tolist(),
        float(colour.is_floor),
        float(colour.rings > 0 and colour.is_relief),
        _log(colour.level),
    ]


def _axis_numbers(axis: AxisEvidence | None, base: float) -> list[float]:
    if axis is None:
        return [MISSING] * 8
    return [
        axis.misfit,
        axis.gain,
        _log(axis.slide, base),
        _log(axis.slide, max(axis.level, TINY)),
        min(axis.contrast, 30.0),
        _log(axis.level, base),
        axis.agreement,
        _log(axis.excess, base),
    ]


def _offset_numbers(survey: Survey, base: float) -> list[float]:
    """Quantiles of normal and tangential offsets of vertices from the means of their one-rings."""
    if not len(survey.offsets):
        return [MISSING] * (2 * len(OFFSET_SHARES) + 3)
    out = (survey.offsets * survey.normals).sum(axis=1)
    within = np.sqrt(np.maximum((survey.offsets**2).sum(axis=1) - out * out, 0.0))
    return [
        *_logs(quantiles(np.abs(out), OFFSET_SHARES), base),
        *_logs(quantiles(within, OFFSET_SHARES), base),
        float((out > 0.05).mean()),
        float((out < -0.05).mean()),
        float((out > 0.0).mean()),
    ]


def _neighbour_numbers(mesh: Mesh, survey: Survey) -> list[float]:
    """Correlations of offsets from the mean of the one-ring, normal and tangential, of neighbours.

    White noise has a correlation of -0.24 on regular triangles, smooth shape nearly 1.
    """
    step = max(-(-len(survey.vertices) // MAX_NEIGHBOUR_PLACES), 1)
    places, normals = survey.vertices[::step], survey.normals[::step]
    own = survey.offsets[::step]
    of, neighbours, counts = mesh.topology.rings_of(places)
    if not len(of):
        return [MISSING] * 8
    others, valences = ring_offsets(mesh, neighbours)
    # The same scaling as in the survey.
    others *= np.sqrt(valences / (valences + 1.0))[:, None]
    others /= mesh.mean_edge_length
    heights = (own * normals).sum(axis=1)
    their_heights = (others * normals[of]).sum(axis=1)
    tangents = own - heights[:, None] * normals
    their_tangents = others - their_heights[:, None] * normals[of]
    products = np.bincount(of, heights[of] * their_heights, len(places)) / np.maximum(counts, 1)
    squares = 0.5 * (
        heights**2 + np.bincount(of, their_heights**2, len(places)) / np.maximum(counts, 1)
    )
    thirds = np.array_split(np.argsort(squares, kind="stable"), 3)
    along = (tangents[of] * their_tangents).sum(axis=1)
    their_squares = (their_tangents**2).sum(axis=1)
    is_known = squares > TINY * TINY
    kurtosis = heights[is_known] ** 2 / squares[is_known]
    return [
        *(float(products[some].sum() / max(squares[some].sum(), TINY * TINY)) for some in thirds),
        float((np.sign(heights[of]) == np.sign(their_heights)).mean()),
        median(products / np.maximum(squares, TINY * TINY)),
        float(along.sum() / max(their_squares.sum(), TINY * TINY)),
        float((along > 0.0).mean()),
        float(kurtosis.std()) if is_known.any() else MISSING,
    ]


def _region_numbers(
    white: WhiteEstimate, survey: Survey, differences: Differences | None, base: float
) -> list[float]:
    regions = np.sort(white.regions) / white.edge
    numbers = _logs(np.array([regions[0], median(regions), regions[-1]]), base)
    if differences is None:
        return numbers + [MISSING] * 18
    lows = np.sqrt(np.maximum(np.sort(differences.lows), 0.0))
    colour = find_colour(survey, differences.scale)
    return [
        *numbers,
        *_logs(np.array([lows[0], median(lows), lows[-1]]), base),
        float((differences.scale > 0.0).mean()),
        float(differences.is_pure.mean()),
        _log(math.sqrt(differences.mean), base),
        *_colour_numbers(colour, base),
    ]
