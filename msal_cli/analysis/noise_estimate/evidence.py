"""What speaks for noise and what for design or texture, as numbers for the classifier.

Noise is everywhere on a scan: what fits leave over has a floor, at every place and over every
width, and heights of neighbours go against one another.  Design is not: flats are flat to
rounding, lengths repeat exactly, curvature ends at edges.  Every number is free of scale: after the
levels by each measurement, logarithms are of ratios to what degree 2 over two rings leaves at half
of the places.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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
    quantiles,
    ring_offsets,
    ring_rows,
    take_survey,
)
from msal_cli.analysis.noise_estimate.spread import (
    Colour,
    Differences,
    find_colour,
    find_differences,
    outlying_share,
    weigh_differences,
)
from msal_cli.arrays import Floats

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

LEVELS = ("white", "rms", "colour", "axis", "axis_colour", "steps", "regions")
"""The measurements of the level that the numbers begin with, as logarithms; mean edges."""

SIZE = len(LEVELS)
"""Which of the numbers is the logarithm of the number of vertices."""

MISSING = -30.0
"""In place of a number that is not known; all others are greater."""

SHARES = (0.02, 0.1, 0.25, 0.5, 0.75, 0.95)
OFFSET_SHARES = (0.1, 0.3, 0.5, 0.7, 0.9)
PAIRS = ((TWO, ONE), (THREE, TWO), (FOUR, THREE), (SIX, FOUR))
TINY = 1e-7
"""Mean edge lengths below which a deviation is rounding."""

MAX_COUNTED = 4_000
"""Vertices from which more say nothing of the noise."""

MAX_REPEATED_VERTICES = 40_000
"""Vertices whose edges are compared in length: sorting more would take too long."""

MAX_NEIGHBOUR_PLACES = 400
"""Places whose neighbours' heights are compared with their own."""

MIN_COSINE = 0.1
"""Squared cosine to an axis from which a place says something of the noise along it."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Measurements of one mesh, and the numbers that are made of them.

    Attributes
    ----------
    survey : fits over one to six rings.
    colour : over how many rings the noise is shared, if it is alike everywhere.
    axis : the best one for noise along an axis.
    steps : depths in steps.
    differences : levels by region, where they differ.
    outliers : share of the vertices that lie far off.
    loud_correlation : of the heights of neighbours, in the roughest third of the places; below 0
        for noise that they do not share.
    numbers : (k,) for the classifier.
    """

    survey: Survey
    colour: Colour | None
    axis: AxisEvidence | None
    steps: StepEvidence
    differences: Differences | None
    outliers: float
    loud_correlation: float
    numbers: Floats


def gather_evidence(mesh: Mesh, white: WhiteEstimate) -> Evidence:
    """Measure all that the classifier knows of a mesh."""
    survey = take_survey(mesh, white.places)
    groups = group_places(survey)
    variances = white.fits.variances[:, FAR][white.fits.freedoms[:, FAR] > 0]
    # Deviation from degree 2 over two rings at half of the places, mean edges.
    base = TINY
    if len(variances):
        base = max(math.sqrt(float(quantiles(variances, (0.5,))[0])) / white.edge, TINY)
    colour = find_colour(survey, fine=white.level.mean_edges)
    linked = fitted = axis = axis_colour = None
    if groups is not None:
        # The axis along which vertices slide, and the one that explains best what is left over.
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
        _log(white.level.mean_edges),
        _log(white.level.rms_edges),
        MISSING if colour is None else _log(colour.level),
        MISSING if axis is None else _log(axis.best_level),
        MISSING if axis_colour is None else _log(axis_colour.level),
        _log(steps.level) if steps.n_axes else MISSING,
        MISSING if differences is None else _log(math.sqrt(weigh_differences(differences))),
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
        loud_correlation=neighbours[2],
        numbers=values,
    )


def _log(value: float, base: float = 1.0) -> float:
    """Logarithm of a length in mean edges, over a base; lengths below ``TINY`` count as that."""
    return math.log(max(value, TINY) / base) if math.isfinite(value) else MISSING


def _logs(values: Floats, base: float = 1.0) -> list[float]:
    return [_log(float(value), base) for value in values]


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
    """How often an edge has the length of another one, beyond chance, and how lengths spread."""
    starts, ring = mesh.topology.ring_start, mesh.topology.ring
    n = min(len(mesh.vertices), MAX_REPEATED_VERTICES)
    ends = ring[: starts[n]].astype(np.int64)
    begins = np.repeat(np.arange(n), np.diff(starts[: n + 1]))
    once = begins < ends
    vectors = mesh.vertices[ends[once]] - mesh.vertices[begins[once]]
    lengths = np.sort(np.sqrt((vectors * vectors).sum(axis=1))) / edge
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
    level, fits = white.level, white.fits
    numbers = [
        _log(level.mean_edges, base),
        _log(level.low, base),
        _log(level.high, base),
        level.tail,
        _log(level.rms_edges, base),
        float(level.is_negligible),
    ]
    for fit in range(4):
        variances = fits.variances[:, fit][fits.freedoms[:, fit] > 0]
        if not len(variances):
            numbers += [MISSING] * (len(SHARES) + 2)
            continue
        deviations = np.sqrt(variances) / white.edge
        numbers += _logs(quantiles(deviations, SHARES), base)
        numbers += [float((deviations < 1e-6).mean()), float((deviations < 1e-3).mean())]
    ratios = fits.ratios[fits.ratios >= 0.0]
    return numbers + (
        quantiles(ratios, (0.5, 0.9, 0.97, 0.99)).tolist() if len(ratios) else [0.0] * 4
    )


def _survey_numbers(survey: Survey, base: float) -> list[float]:
    numbers: list[float] = []
    for fit in range(5):
        variances = survey.variances[:, fit]
        variances = variances[np.isfinite(variances)]
        if not len(variances):
            numbers += [MISSING] * len(SHARES)
            continue
        numbers += _logs(np.sqrt(quantiles(variances, SHARES)), base)
    logs = 0.5 * np.log(np.maximum(survey.variances, TINY * TINY))
    widest = logs[:, SIX]
    known = np.isfinite(logs).all(axis=1)
    flat = known & (widest <= (quantiles(widest[known], (0.3,))[0] if known.any() else 0.0))
    for wide, narrow in PAIRS:
        ratios = (logs[:, wide] - logs[:, narrow])[np.isfinite(logs[:, wide] - logs[:, narrow])]
        numbers += quantiles(ratios, (0.1, 0.5, 0.9)).tolist() if len(ratios) else [MISSING] * 3
        some = (logs[:, wide] - logs[:, narrow])[flat]
        numbers += [float(np.median(some)), float(some.std())] if len(some) else [MISSING] * 2
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
    """Ways of the vertices from the middles of their rings, out of the surface and within it."""
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
    """How heights over the ring, and ways within the surface, go with those of neighbours.

    White noise has a correlation of -0.24 on regular triangles, and smooth shape one near 1.
    """
    step = max(-(-len(survey.vertices) // MAX_NEIGHBOUR_PLACES), 1)
    places, normals = survey.vertices[::step], survey.normals[::step]
    own = survey.offsets[::step]
    of, neighbours, counts = ring_rows(mesh, places)
    if not len(of):
        return [MISSING] * 8
    others, valences = ring_offsets(mesh, neighbours)
    # Scaled as those of the survey.
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
        float(np.median(products / np.maximum(squares, TINY * TINY))),
        float(along.sum() / max(their_squares.sum(), TINY * TINY)),
        float((along > 0.0).mean()),
        float(kurtosis.std()) if is_known.any() else MISSING,
    ]


def _region_numbers(
    white: WhiteEstimate, survey: Survey, differences: Differences | None, base: float
) -> list[float]:
    regions = np.sort(white.regions) / white.edge
    numbers = _logs(np.array([regions[0], np.median(regions), regions[-1]]), base)
    if differences is None:
        return numbers + [MISSING] * 18
    lows = np.sqrt(np.maximum(np.sort(differences.lows), 0.0))
    colour = find_colour(survey, differences.scale)
    return [
        *numbers,
        *_logs(np.array([lows[0], np.median(lows), lows[-1]]), base),
        float((differences.scale > 0.0).mean()),
        float(differences.is_pure.mean()),
        _log(math.sqrt(weigh_differences(differences)), base),
        *_colour_numbers(colour, base),
    ]
