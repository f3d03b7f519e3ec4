"""What kind of noise a mesh has, concluded from the survey, and with it the level."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis.noise_estimate.colour import Colour, find_colour
from msal_cli.analysis.noise_estimate.direction import (
    CLEAR_CONTRAST,
    AxisEvidence,
    Groups,
    find_axis,
    find_linked_axis,
    group_places,
    is_isotropic,
)
from msal_cli.analysis.noise_estimate.level import (
    RING_COUNTS,
    NoiseCharacter,
    NoiseLevel,
    to_clean_edges,
)
from msal_cli.analysis.noise_estimate.spikes import Spikes, find_spikes
from msal_cli.analysis.noise_estimate.steps import Steps, find_steps
from msal_cli.analysis.noise_estimate.survey import THREE, TWO, Survey, take_survey
from msal_cli.analysis.noise_estimate.unevenness import (
    Unevenness,
    find_differences,
    find_unevenness,
)
from msal_cli.analysis.noise_estimate.white import WhiteEstimate
from msal_cli.arrays import Floats

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh


FEWEST_VERTICES = 256
"""Vertices below which six rings are most of the shape, and leave over what noise would."""

UNLIKE = "texture or noise: it is not the same everywhere"

LEAST_SHARED = 0.05
"""Mean edge lengths from which noise that neighbours share is taken for noise, and not texture."""

LEAST_ALONG = 0.03
"""Mean edge lengths from which noise along an axis is."""

LEAST_COSINE = 0.1
"""Squared cosine to the axis from which a place says something of the noise along it."""

CLEAR_GAIN = 0.3
"""By how much an axis explains what is left over better, where what it leaves is not alike."""

SHARED_MARGIN, FURTHER_MARGIN = 0.03, 0.003
"""By how much other numbers of rings have to be worse for noise along an axis that is shared over
one, and over more."""

ALONG_GROWTH = 1.0
"""What degree 3 over three rings leaves over degree 2 over two, at least, of noise along an axis
that is shared: 1.02 to 1.16, where smooth relief leaves less."""

MORE_THAN_STEP = 1.5
"""Level along the axis, in levels of the steps, from which there is more noise than the steps'."""

LEAST_STEP_LEVEL = 0.02
"""Mean edge lengths from which steps are."""

WORST_FIT = 0.1
"""Mean error of logarithms up to which a number of rings explains the levels by scale."""

LEAST_ONE_RING, SHARP_ONE_RING = 0.13, 0.74
"""Mean edge lengths, and sharpness of fits over two rings, from which noise that is shared over one
ring is distinguished from white noise on texture."""

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

UNSURE_TERRACES = 0.6
"""Confidence of terraces on a grid that a part with steps may lie on as well."""

SHARED_ERROR, ALONG_ERROR, STEP_ERROR, TERRACE_ERROR = 0.25, 0.15, 0.2, 0.5
"""What the interval allows for, of noise that is shared, along an axis, in steps, and of
terraces."""


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


def characterize(mesh: Mesh, white: WhiteEstimate) -> Characterized:
    """What the noise is like, and its level as it is for such."""
    if np.count_nonzero(mesh.topology.has_ring) < FEWEST_VERTICES:
        kind = "none" if white.level.is_negligible else "unknown"
        return _by_region(white, _plain(white, kind, 0.3, "few vertices"))
    survey = take_survey(mesh, white.places)
    groups = group_places(survey)
    steps = find_steps(mesh, survey, groups)
    axis, colour = _find_explaining_axis(white, survey, groups)
    if axis is None:
        colour = find_colour(survey, fine=white.level.mean_edges)

    if steps is not None and steps.level > LEAST_STEP_LEVEL:
        return _by_region(white, _step(white, steps, axis))
    spikes = find_spikes(mesh, white, survey, colour)
    if spikes is not None:
        return _by_region(white, _spiked(white, spikes))
    if axis is not None:
        return _by_region(white, _along(white, axis, colour))
    is_shared = colour is not None and _is_shared(white, survey, colour)
    is_even = colour is not None and colour.is_even and colour.rings == 0
    differences = None if is_shared or is_even else find_differences(survey)
    if differences is not None:
        uneven = find_unevenness(survey, differences)
        if uneven is not None:
            middles = mesh.vertices[survey.vertices[uneven.middles]]
            return Characterized(_uneven(white, uneven), middles, uneven.regions * white.edge)
        kind = "none" if white.level.is_negligible else "unknown"
        return _by_region(white, _plain(white, kind, 0.3, UNLIKE))
    return _by_region(white, _decide(white, survey, colour, is_shared))


def _by_region(white: WhiteEstimate, level: NoiseLevel) -> Characterized:
    """The level, and by region as for white noise, or the same everywhere for any other."""
    regions = white.regions
    if level.file_units != white.level.file_units:
        regions = np.full(len(white.regions), level.file_units)
    return Characterized(level, white.middles, regions)


def _decide(
    white: WhiteEstimate, survey: Survey, colour: Colour | None, is_shared: bool
) -> NoiseLevel:
    """The level where noise is the same everywhere, and along the normals or isotropic."""
    if colour is None:
        return _plain(white, "none" if white.level.is_negligible else "unknown", 0.3, "few places")
    if is_shared:
        return _shared(white, colour)
    if colour.rings == 0 and _is_uneven_mesh(white, colour):
        return _on_uneven_triangles(white, colour)
    if white.level.is_negligible:
        return _plain(white, "none", 0.9, "nothing that noise would leave to fits over one ring")
    if colour.sharpness[1] < SHARP_WHITE or white.level.low == 0.0:
        return _reach_up(_plain(white, "unknown", 0.3, UNLIKE), colour)
    if colour.is_floor and _is_doubtful(white, colour):
        is_isotropic_too = is_isotropic(survey, white.level.mean_edges)
        kind = "isotropic" if is_isotropic_too else "white"
        basis = f"on texture, or shared over {RING_COUNTS[colour.rings]}"
        return _reach_up(_plain(white, kind, 0.4, basis), colour)
    confidence = min(0.6 + colour.margin / SURE_MARGIN, 0.98) if colour.rings == 0 else 0.5
    if is_isotropic(survey, white.level.mean_edges):
        return _plain(
            white, "isotropic", confidence, "as much within the surface as along the normals"
        )
    return _plain(white, "white", confidence, "fits over one to six rings leave as much")


def _reach_up(noise: NoiseLevel, colour: Colour | None) -> NoiseLevel:
    """The level with an interval up to what it would be if neighbours shared it."""
    if noise.is_negligible or colour is None or not colour.is_floor:
        return noise
    return dataclasses.replace(noise, high=max(noise.high, colour.level))


def _find_explaining_axis(
    white: WhiteEstimate, survey: Survey, groups: Groups | None
) -> tuple[AxisEvidence | None, Colour | None]:
    """The axis that explains what is left over, and its colour then."""
    if groups is None:
        return None, None
    linked = None if white.level.is_negligible else find_linked_axis(survey, groups)
    if linked is not None:
        return linked, _find_colour_along(survey, linked)
    return _explain_by_axis(survey, find_axis(survey, groups))


def _find_colour_along(survey: Survey, axis: AxisEvidence) -> Colour | None:
    cosines = (survey.normals @ axis.axis) ** 2
    return find_colour(survey, np.where(cosines > LEAST_COSINE, cosines, 0.0))


def _explain_by_axis(
    survey: Survey, axis: AxisEvidence | None
) -> tuple[AxisEvidence | None, Colour | None]:
    """The axis, if what is left over is alike everywhere but for the angle to it; and its colour
    then."""
    if axis is None or not axis.is_sure or axis.level < LEAST_ALONG:
        return None, None
    colour = _find_colour_along(survey, axis)
    is_alike = colour is not None and colour.is_alike
    # Rounded depths differ from place to place, and grazing noise grows; both slide.
    is_clear = axis.is_clear and axis.gain > CLEAR_GAIN and axis.contrast > CLEAR_CONTRAST
    return (axis, colour) if is_alike or is_clear else (None, None)


def _is_shared(white: WhiteEstimate, survey: Survey, colour: Colour) -> bool:
    """Whether neighbours share noise, and it is no texture."""
    is_shared = colour.rings > 0 and colour.is_floor and colour.misfit < WORST_FIT
    if (
        colour.is_relief
        or not is_shared
        or colour.level < LEAST_SHARED
        or _is_doubtful(white, colour)
    ):
        return False
    if colour.rings > 1 or white.level.low > 0.0 or white.level.is_negligible:
        return True
    # Fine texture that is the same everywhere looks like that too.  But a sheet that faces one way
    # comes from a scanner, and of texture fits over one ring leave more.
    is_missed = white.level.mean_edges < LEAST_TEXTURE * float(colour.by_scale[TWO])
    return is_missed or _is_sheet(survey)


def _is_doubtful(white: WhiteEstimate, colour: Colour) -> bool:
    """Whether white noise on a texture would leave the same."""
    is_weak = colour.level < LEAST_ONE_RING or colour.sharpness[TWO] < SHARP_ONE_RING
    if colour.is_relief and white.level.low > 0.0:
        return True
    return colour.rings == 1 and white.level.low > 0.0 and is_weak


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
        confidence=0.5,
        basis="fits over two to six rings leave as much, and less over one, as on uneven triangles",
    )
    low, high = 1.0 - SHARED_ERROR, 1.0 + SHARED_ERROR
    return _with(white, colour.level, low * colour.level, high * colour.level, character)


def _with(
    white: WhiteEstimate, level: float, low: float, high: float, character: NoiseCharacter
) -> NoiseLevel:
    """The estimate with another level, mean edges, the same everywhere, and its character."""
    return dataclasses.replace(
        white.level,
        mean_edges=level,
        low=low,
        high=max(high, level),
        file_units=level * white.edge,
        clean_edges=to_clean_edges(level),
        rms_edges=max(white.level.rms_edges, level),
        is_negligible=False,
        lowest=level,
        highest=level,
        character=character,
    )


def _plain(white: WhiteEstimate, kind: str, confidence: float, basis: str) -> NoiseLevel:
    """The level as for white noise."""
    direction = "isotropic" if kind == "isotropic" else "normals"
    character = NoiseCharacter(kind, direction=direction, confidence=confidence, basis=basis)
    return dataclasses.replace(white.level, character=character)


def _shared(white: WhiteEstimate, colour: Colour) -> NoiseLevel:
    confidence = min(0.55 + 0.4 * colour.margin / SURE_MARGIN, 0.95)
    character = NoiseCharacter(
        "correlated",
        rings=colour.rings,
        confidence=confidence,
        basis=(
            f"fits leave {colour.by_scale[1]:.2g} e over two rings, "
            f"{colour.by_scale[4]:.2g} e over six, alike everywhere"
        ),
    )
    low, high = 1.0 - SHARED_ERROR, 1.0 + SHARED_ERROR
    return _with(white, colour.level, low * colour.level, high * colour.level, character)


def _along(white: WhiteEstimate, axis: AxisEvidence, colour: Colour | None) -> NoiseLevel:
    is_shared = (
        colour is not None
        and colour.rings > 0
        and colour.is_floor
        and not colour.is_relief
        and colour.by_scale[THREE] > ALONG_GROWTH * colour.by_scale[TWO]
        and colour.margin > (SHARED_MARGIN if colour.rings == 1 else FURTHER_MARGIN)
    )
    level = colour.level if is_shared and colour is not None else axis.best_level
    rings = colour.rings if is_shared and colour is not None else 0
    character = NoiseCharacter(
        "view",
        rings=rings,
        direction="axis",
        axis=_as_tuple(axis.axis),
        confidence=axis.confidence,
        basis=(
            "vertices slide along the axis as they are out of the surface along it"
            if axis.is_linked
            else "what fits leave falls with the angle to the axis; vertices slide along it"
        ),
    )
    error = SHARED_ERROR if rings else ALONG_ERROR
    least = level if rings else min(level, axis.level)
    noise = _with(white, level, (1.0 - error) * least, (1.0 + error) * level, character)
    return noise if rings or colour is None or colour.rings == 0 else _reach_up(noise, colour)


def _step(white: WhiteEstimate, steps: Steps, axis: AxisEvidence | None) -> NoiseLevel:
    level = steps.level
    if steps.axis is None:
        character = NoiseCharacter(
            "staircase",
            step=steps.step,
            confidence=0.95 if steps.is_sure else UNSURE_TERRACES,
            basis=(
                "all vertices lie on a grid, as those of voxels do"
                if steps.is_sure
                else "all vertices lie on a grid, as those of blocks do too"
            ),
        )
    else:
        if axis is not None and abs(float(axis.axis @ steps.axis)) > 0.9:
            # Rounded depths differ less, and slide more, than Gaussian noise.
            level = max(level, axis.best_level if axis.best_level > MORE_THAN_STEP * level else 0.0)
        character = NoiseCharacter(
            "quantised",
            direction="axis",
            axis=_as_tuple(steps.axis),
            step=steps.step,
            confidence=0.95,
            basis="neighbours differ by multiples of one step along the axis",
        )
    error = TERRACE_ERROR if steps.axis is None else STEP_ERROR
    return _with(white, level, (1.0 - error) * level, (1.0 + error) * level, character)


def _spiked(white: WhiteEstimate, spikes: Spikes) -> NoiseLevel:
    if spikes.kind == "outliers":
        basis = f"{100.0 * spikes.share:.2g} % of the vertices lie far off their neighbours"
        confidence = 0.9
    else:
        basis = (
            f"{100.0 * white.level.tail:.2g} % of the vertices stand out along the normals, where "
            "1 % would by chance"
        )
        confidence = 0.8
    character = NoiseCharacter(
        spikes.kind, outliers=spikes.share, confidence=confidence, basis=basis
    )
    rms = max(white.level.rms_edges, white.level.mean_edges)
    return dataclasses.replace(
        white.level,
        character=character,
        is_negligible=False,
        high=max(white.level.high, rms),
    )


def _uneven(white: WhiteEstimate, uneven: Unevenness) -> NoiseLevel:
    character = NoiseCharacter(
        "uneven",
        rings=uneven.rings,
        confidence=min(0.5 + 0.1 * uneven.highest / max(uneven.lowest, 0.02), 0.95),
        basis=f"{uneven.lowest:.2g} to {uneven.highest:.2g} e by region",
    )
    result = _with(white, uneven.level, uneven.lowest, uneven.highest, character)
    return dataclasses.replace(
        result, lowest=uneven.lowest, highest=uneven.highest, regions=len(uneven.regions)
    )


def _as_tuple(axis: Floats) -> tuple[float, float, float]:
    return float(axis[0]), float(axis[1]), float(axis[2])
