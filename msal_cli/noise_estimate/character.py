"""What kind of noise a mesh has, concluded from the survey, and with it the level."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.noise_estimate.colour import Colour, find_colour
from msal_cli.noise_estimate.direction import AxisEvidence, find_axis, group_places, is_isotropic
from msal_cli.noise_estimate.level import NoiseCharacter, NoiseLevel, to_clean_edges
from msal_cli.noise_estimate.quantiles import chi_square_quantile
from msal_cli.noise_estimate.regions import VERTICES_PER_REGION, split_regions
from msal_cli.noise_estimate.steps import Steps, find_steps, ring_offsets
from msal_cli.noise_estimate.survey import TWO, Survey, take_survey
from msal_cli.noise_estimate.white import WhiteEstimate

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]

LEAST_SHARED = 0.05
"""Mean edge lengths from which noise that neighbours share is taken for noise, and not texture."""

LEAST_ALONG = 0.03
"""Mean edge lengths from which noise along an axis is."""

LEAST_COSINE = 0.1
"""Squared cosine to the axis from which a place says something of the noise along it."""

SHARED_MARGIN = 0.02
"""By how much no sharing has to be worse for noise along an axis."""

LEAST_STEP_LEVEL = 0.02
"""Mean edge lengths from which steps are."""

WORST_FIT = 0.12
"""Mean error of logarithms up to which a number of rings explains the levels by scale."""

SHEET, MOST_FACING = 0.3, 0.97
"""Length of the mean normal, and share of the normals within a right angle of it, of a sheet."""

LEAST_TEXTURE = 0.5
"""Share of what fits over two rings leave over that those over one leave of texture."""

MISSED = 0.7
"""Share of the level below which fits over one-rings have missed it."""

SURE_MARGIN = 0.06
"""By how much another number of rings has to be worse for there to be no doubt."""

SHARP_WHITE = 0.72
"""Ratio of standard deviations at the flattest twentieth and fifth that white noise shows."""

SHARP_PLANE = 0.3
"""The same of fits over one ring, where the noise differs by region: shape may have none."""

SHARED_ERROR, ALONG_ERROR, STEP_ERROR = 0.25, 0.15, 0.2
"""What the interval allows for, of noise that is shared, along an axis, in steps."""

FEWEST_OUTLIERS = 0.003
"""Share of the vertices from which they are outliers."""

OUTLYING = 0.6
"""Mean edge lengths that an outlier is off the middle of its ring, and spikes are not as a rule
within the surface."""

SLIDING = 0.3
"""Mean edge lengths within the surface, as the median of those far out, that tells outliers, which
lie anywhere, from impulses along the normals."""

MIXED, MIXED_TAIL = 0.5, 0.014
"""Sharpness of fits over one ring below which, with such a tail, a part of the vertices has noise
and others have none."""

UNEVEN_RATIO, LEAST_LOUD = 2.5, 0.05
"""Ratio of the most to the least noisy region, and mean edge lengths that the former has."""

LEAST_PURE, MOST_UNEVEN_RINGS = 0.1, 2
"""Share of the places in loud regions, and most rings, with which noise that differs by region is
told from texture."""

PURE = 0.3
"""Least ratio of the variances of a tenth and of half of the places in a region that is in one part
of the mesh only."""

MOST_REGIONS, FEWEST_IN_REGION = 20, 20
"""Regions of the survey, and the places that each has."""


@dataclass(frozen=True, eq=False)
class Characterized:
    """The noise of a mesh, by region too.

    Attributes
    ----------
    level : the noise.
    middles : (r, 3) positions of the regions' middles.
    regions : (r,) levels of the regions, file units.
    """

    level: NoiseLevel
    middles: Floats
    regions: Floats


@dataclass(frozen=True)
class _Regional:
    """Levels by region, mean edges, where they differ: least, most, and root mean square; and the
    scale (c,) of the variances at the places."""

    lowest: float
    highest: float
    level: float
    scale: Floats


def characterize(mesh: Mesh, white: WhiteEstimate) -> Characterized:
    """What the noise is like, and its level as it is for such."""
    survey = take_survey(mesh, white.places)
    level = _decide(mesh, white, survey)
    same = level.file_units == white.level.file_units or not white.level.file_units
    growth = 1.0 if same else level.file_units / white.level.file_units
    regions = white.regions * growth
    if not white.level.file_units:
        regions = np.full(len(white.regions), level.file_units)
    return Characterized(level, white.middles, regions)


def _decide(mesh: Mesh, white: WhiteEstimate, survey: Survey) -> NoiseLevel:
    groups = group_places(survey)
    steps = find_steps(mesh, survey, groups)
    axis = None if groups is None else find_axis(survey, groups)
    axis, colour = _explain_by_axis(survey, axis)
    if axis is None:
        colour = find_colour(survey, fine=white.level.mean_edges)

    if steps is not None and steps.level > LEAST_STEP_LEVEL:
        return _stepped(white, steps, axis, colour)
    if _is_spiked(white, colour):
        return _spiked(mesh, white, survey)
    if axis is not None:
        return _along(white, axis, colour)
    is_shared = colour is not None and _is_shared(white, survey, colour)
    is_even = colour is not None and colour.is_even and colour.rings == 0
    regional = None if is_shared or is_even else _find_regional(survey)
    if regional is not None:
        return _uneven(white, regional, find_colour(survey, regional.scale))
    if colour is None:
        return _plain(white, "none" if white.level.is_negligible else "unknown", 0.3, "few places")
    if is_shared:
        return _shared(white, colour)
    if colour.rings == 0 and _is_uneven_mesh(white, colour):
        return _on_uneven_triangles(white, colour)
    if white.level.is_negligible:
        return _plain(white, "none", 0.9, "nothing that noise would leave to fits over one ring")
    if colour.sharpness[1] < SHARP_WHITE or white.level.low == 0.0:
        return _plain(white, "unknown", 0.3, "texture or noise: it is not the same everywhere")
    confidence = min(0.6 + colour.margin / SURE_MARGIN, 0.98) if colour.rings == 0 else 0.5
    if is_isotropic(survey, white.level.mean_edges):
        return _plain(
            white, "isotropic", confidence, "as much within the surface as along the normals"
        )
    return _plain(white, "white", confidence, "fits over one to six rings leave as much")


def _explain_by_axis(
    survey: Survey, axis: AxisEvidence | None
) -> tuple[AxisEvidence | None, Colour | None]:
    """The axis, if what is left over is alike everywhere but for the angle to it; and its colour
    then."""
    if axis is None or not axis.is_sure or axis.level < LEAST_ALONG:
        return None, None
    cosines = (survey.normals @ axis.axis) ** 2
    colour = find_colour(survey, np.where(cosines > LEAST_COSINE, cosines, 0.0))
    return (axis, colour) if colour is not None and colour.is_alike else (None, None)


def _is_spiked(white: WhiteEstimate, colour: Colour | None) -> bool:
    """Whether single vertices stand out."""
    if white.level.is_negligible:
        return False
    # Where half of the vertices have impulses, few stand out, but many one-rings have none.
    is_mixed = colour is not None and colour.sharpness[0] < MIXED and colour.is_alike
    return white.level.is_impulsive or (white.level.tail > MIXED_TAIL and is_mixed)


def _is_shared(white: WhiteEstimate, survey: Survey, colour: Colour) -> bool:
    """Whether neighbours share noise, and it is no texture."""
    is_shared = colour.rings > 0 and colour.is_floor and colour.misfit < WORST_FIT
    if not is_shared or colour.level < LEAST_SHARED:
        return False
    if colour.rings > 1 or white.level.low > 0.0 or white.level.is_negligible:
        return True
    # Fine texture that is the same everywhere looks like that too.  But a sheet that faces one way
    # comes from a scanner, and of texture fits over one ring leave more.
    is_missed = white.level.mean_edges < LEAST_TEXTURE * float(colour.by_scale[TWO])
    return is_missed or _is_sheet(survey)


def _is_sheet(survey: Survey) -> bool:
    """Whether all normals are within a hemisphere: what a scanner sees from one side."""
    middle = survey.normals.mean(axis=0)
    length = math.sqrt(float(middle @ middle))
    cosines = survey.normals @ middle
    return bool(length > SHEET and (cosines > 0.0).mean() > MOST_FACING)


def _is_uneven_mesh(white: WhiteEstimate, colour: Colour) -> bool:
    """Whether the least fits, over one-rings, miss white noise since vertices lie close there."""
    return (
        colour.is_floor
        and colour.misfit < WORST_FIT
        and colour.level > max(LEAST_SHARED, white.level.mean_edges / MISSED)
    )


def _on_uneven_triangles(white: WhiteEstimate, colour: Colour) -> NoiseLevel:
    character = NoiseCharacter(
        "white",
        0,
        "normals",
        None,
        0.0,
        0.0,
        0.5,
        "fits over two to six rings leave as much, and less over one, as on uneven triangles",
    )
    low, high = 1.0 - SHARED_ERROR, 1.0 + SHARED_ERROR
    return _with(white, colour.level, low * colour.level, high * colour.level, character)


def _with(
    white: WhiteEstimate, level: float, low: float, high: float, character: NoiseCharacter
) -> NoiseLevel:
    """The estimate with another level, mean edges, and its character."""
    old = white.level
    growth = level / old.mean_edges if old.mean_edges > 0.0 else 0.0
    return dataclasses.replace(
        old,
        mean_edges=level,
        low=low,
        high=max(high, level),
        file_units=level * white.edge,
        clean_edges=to_clean_edges(level),
        rms_edges=max(old.rms_edges, level),
        is_negligible=False,
        lowest=old.lowest * growth if growth else level,
        highest=old.highest * growth if growth else level,
        character=character,
    )


def _plain(white: WhiteEstimate, kind: str, confidence: float, basis: str) -> NoiseLevel:
    """The level as for white noise."""
    direction = "isotropic" if kind == "isotropic" else "normals"
    character = NoiseCharacter(kind, 0, direction, None, 0.0, 0.0, confidence, basis)
    return dataclasses.replace(white.level, character=character)


def _shared(white: WhiteEstimate, colour: Colour) -> NoiseLevel:
    confidence = min(0.55 + 0.4 * colour.margin / SURE_MARGIN, 0.95)
    character = NoiseCharacter(
        "correlated",
        colour.rings,
        "normals",
        None,
        0.0,
        0.0,
        confidence,
        f"fits leave {colour.by_scale[1]:.2g} e over two rings, {colour.by_scale[4]:.2g} e over "
        "six, alike everywhere",
    )
    low, high = 1.0 - SHARED_ERROR, 1.0 + SHARED_ERROR
    return _with(white, colour.level, low * colour.level, high * colour.level, character)


def _along(white: WhiteEstimate, axis: AxisEvidence, colour: Colour | None) -> NoiseLevel:
    is_shared = (
        colour is not None
        and colour.rings > 0
        and colour.is_floor
        and (colour.rings > 1 or colour.margin > SHARED_MARGIN)
    )
    level = colour.level if is_shared and colour is not None else axis.level
    rings = colour.rings if is_shared and colour is not None else 0
    character = NoiseCharacter(
        "view",
        rings,
        "axis",
        _as_tuple(axis.axis),
        0.0,
        0.0,
        axis.confidence,
        "what fits leave falls with the angle to the axis; vertices slide along it",
    )
    error = SHARED_ERROR if rings else ALONG_ERROR
    return _with(white, level, (1.0 - error) * level, (1.0 + error) * level, character)


def _stepped(
    white: WhiteEstimate, steps: Steps, axis: AxisEvidence | None, colour: Colour | None
) -> NoiseLevel:
    level = steps.level
    if steps.axis is None:
        character = NoiseCharacter(
            "staircase", 0, "normals", None, steps.step, 0.0, 0.95, "all vertices lie on a grid"
        )
    else:
        if axis is not None and abs(float(axis.axis @ steps.axis)) > 0.9:
            level = max(level, axis.level)
        character = NoiseCharacter(
            "quantised",
            0,
            "axis",
            _as_tuple(steps.axis),
            steps.step,
            0.0,
            0.95,
            "neighbours differ by multiples of one step along the axis",
        )
    return _with(white, level, (1.0 - STEP_ERROR) * level, (1.0 + STEP_ERROR) * level, character)


def _spiked(mesh: Mesh, white: WhiteEstimate, survey: Survey) -> NoiseLevel:
    far = white.places[white.far]
    offsets = ring_offsets(mesh, far) / white.edge
    normals = mesh.vertex_normals("uniform", 1)[far]
    along = (offsets * normals).sum(axis=1)
    within = np.sqrt(np.maximum((offsets * offsets).sum(axis=1) - along * along, 0.0))
    lengths = np.sqrt((survey.offsets * survey.offsets).sum(axis=1))
    share = float((lengths > OUTLYING).mean())
    if share > FEWEST_OUTLIERS and float(np.median(within)) > SLIDING:
        character = NoiseCharacter(
            "outliers",
            0,
            "normals",
            None,
            0.0,
            share,
            0.9,
            f"{100.0 * share:.2g} % of the vertices lie far off their neighbours",
        )
    else:
        character = NoiseCharacter(
            "impulsive",
            0,
            "normals",
            None,
            0.0,
            0.0,
            0.8,
            f"{100.0 * white.level.tail:.2g} % of the vertices stand out along the normals, where "
            "1 % would by chance",
        )
    return dataclasses.replace(white.level, character=character)


def _find_regional(survey: Survey) -> _Regional | None:
    """Levels by region, where they differ."""
    fit = TWO
    has = np.isfinite(survey.variances[:, fit])
    if has.sum() < 2 * FEWEST_IN_REGION:
        return None
    count = min(MOST_REGIONS, int(has.sum()) // FEWEST_IN_REGION)
    middles, labels = split_regions(survey.positions, VERTICES_PER_REGION * count)
    variances, freedoms = survey.variances[:, fit], survey.freedoms[:, fit]
    lows = np.full(len(middles), np.nan)
    means = np.full(len(middles), np.nan)
    pure = np.zeros(len(middles), dtype=bool)
    for region in range(len(middles)):
        among = has & (labels == region)
        if among.sum() >= FEWEST_IN_REGION // 2:
            values = variances[among]
            few, half = np.quantile(values, [0.1, 0.5])
            pure[region] = few > PURE * half
            lows[region] = np.quantile(values / chi_square_quantile(freedoms[among], 0.3), 0.3)
            means[region] = np.quantile(values / chi_square_quantile(freedoms[among], 0.4), 0.4)
    known = np.isfinite(lows)
    if known.sum() < 2:
        return None
    lowest, highest = math.sqrt(lows[known].min()), math.sqrt(lows[known].max())
    if highest < LEAST_LOUD or highest < UNEVEN_RATIO * lowest:
        return None
    pure &= known & (lows > 0.16 * highest**2)
    counts = np.bincount(labels, minlength=len(middles))[known]
    level = math.sqrt(float(counts @ means[known] / counts.sum()))
    scale = np.where(pure, lows, 0.0)[labels]
    if not scale.any():
        return None
    return _Regional(lowest, highest, level, scale)


def _uneven(white: WhiteEstimate, regional: _Regional, colour: Colour | None) -> NoiseLevel:
    is_noise = (
        colour is not None
        and bool((colour.sharpness[1:4] > SHARP_WHITE).all())
        and colour.sharpness[0] > SHARP_PLANE
        and colour.rings <= MOST_UNEVEN_RINGS
        and (regional.scale > 0.0).mean() > LEAST_PURE
        and colour.misfit < WORST_FIT
    )
    if not is_noise or colour is None:
        kind = "none" if white.level.is_negligible else "unknown"
        return _plain(white, kind, 0.3, "texture or noise: it is not the same everywhere")
    character = NoiseCharacter(
        "uneven",
        colour.rings,
        "normals",
        None,
        0.0,
        0.0,
        min(0.5 + 0.1 * regional.highest / max(regional.lowest, 0.02), 0.95),
        f"{regional.lowest:.2g} to {regional.highest:.2g} e by region",
    )
    result = _with(white, regional.level, regional.lowest, regional.highest, character)
    return dataclasses.replace(result, lowest=regional.lowest, highest=regional.highest)


def _as_tuple(axis: Floats) -> tuple[float, float, float]:
    return float(axis[0]), float(axis[1]), float(axis[2])
