"""The estimate of one mesh, put together from measurements and what the classifier says of them."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis.noise_estimate.classifier import (
    KIND_NAMES,
    MANY_VERTICES,
    SIZE,
    Verdict,
    classify,
)
from msal_cli.analysis.noise_estimate.evidence import Evidence, gather_evidence
from msal_cli.analysis.noise_estimate.level import (
    NOISE,
    TEXTURE,
    NoiseCharacter,
    NoiseLevel,
    Reading,
    to_clean_edges,
)
from msal_cli.analysis.noise_estimate.spread import weigh_differences
from msal_cli.analysis.noise_estimate.survey import SIX, TWO
from msal_cli.analysis.noise_estimate.white import NEGLIGIBLE, WhiteEstimate
from msal_cli.arrays import Floats

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

MIN_VERTICES = 64
"""Vertices below which nothing is said: two rings are most of the mesh."""

NAMED = 0.5
"""Share of the probability of noise that its most probable kind needs to be named."""

PLAIN_SHARED, SURE_SHARED, RELIEF_SHARED = 0.5, 0.72, 0.9
"""Probability of noise that neighbours share, which removes most of a relief where there is none:
where wide fits leave the same everywhere and ``PLAIN_MISFIT`` holds, elsewhere, and where a smooth
relief would leave that as well, or ``POOR_MISFIT`` is exceeded."""

PLAIN_MISFIT, POOR_MISFIT = 0.06, 0.1
"""Misfits of the levels by scale below which shared noise explains them, and above which it hardly
does."""

QUIET, SURE_NOISE, SURE_DESIGN, SURE_FEW = 0.06, 0.95, 0.9, 0.65
"""Mean edge lengths below which noise that neighbours may share has to be as probable as the
second, the third for noise that differs by region and for terraces, and the last for few vertices.
"""

MAX_SEEN = (1.0, 0.65, 0.19)
"""Greatest level for white noise, over that of noise shared over so many rings, or more, of which
it is: 0.5 over one ring, 0.10 to 0.17 over two, on 21 shapes; white noise on relief has more."""

FACING, MIN_GAIN = 0.6, 0.05
"""Mean squared cosine of the normals to an axis that a mesh faces as a whole, and by how much an
axis explains better what is left over, where it does not."""

MAX_SLIDE = 1.6
"""Level of noise along an axis, by how far vertices slide along it, over that by what fits leave:
1.0 to 1.5, and 4 on range scans whose rows are uneven."""

SHARED_KINDS = ("correlated", "view", "uneven")
"""Kinds whose noise neighbours may share."""


@dataclass(frozen=True, eq=False)
class Estimate:
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


def characterize(mesh: Mesh, white: WhiteEstimate) -> Estimate:
    """What the noise is like, and its level as it is for such."""
    if np.count_nonzero(mesh.topology.has_ring) < MIN_VERTICES:
        return _without_noise(white, 1.0, "few vertices")
    evidence = gather_evidence(mesh, white)
    verdict = classify(evidence.numbers, _possible_kinds(evidence))
    is_named = verdict.probability >= _naming_probability(verdict, evidence)
    if _is_white_on_relief(white, verdict):
        verdict = dataclasses.replace(_with_level(verdict, white.level.mean_edges), kind="white")
    elif not is_named and verdict.level > white.level.mean_edges:
        # In doubt what the finest fits see, which relief adds least to.
        verdict = _with_level(verdict, white.level.mean_edges)
    elif verdict.kind == "view" and evidence.axis is not None and not verdict.rings:
        # Rows of a range scan slide within the surface farther than noise makes them.
        verdict = _with_level(verdict, min(verdict.level, MAX_SLIDE * evidence.axis.level))
    is_weak = verdict.level < NEGLIGIBLE and verdict.kind != "outliers"
    if verdict.noise < _needed_probability(verdict, evidence) or is_weak:
        return _without_noise(white, 1.0 - verdict.noise, _describe_fits(evidence), verdict)
    character = _characterize(evidence, verdict) if is_named else _leave_unknown(evidence, verdict)
    rms = max(verdict.level, white.level.rms_edges)
    level, low = verdict.level, verdict.low
    if verdict.kind == "impulsive":
        level = min(level, white.level.mean_edges)
    if verdict.kind == "white":
        # What may be relief is known where the fits are those of the level.
        low = min(low, white.level.low)
    noise = dataclasses.replace(
        white.level,
        mean_edges=level,
        low=0.0 if _is_unsure(verdict) else low,
        high=max(verdict.high, verdict.level),
        file_units=level * white.edge,
        clean_edges=to_clean_edges(level),
        rms_edges=rms,
        is_negligible=False,
        lowest=level,
        highest=level,
        character=character,
        readings=_order_readings(verdict.level, verdict.noise),
    )
    if character.kind == "uneven" and evidence.differences is not None:
        differences = evidence.differences
        scale = level * white.edge / np.sqrt(max(weigh_differences(differences), 1e-300))
        regions = scale * np.sqrt(differences.lows)
        middles = mesh.vertices[evidence.survey.vertices[differences.middles]]
        noise = dataclasses.replace(
            noise,
            low=min(noise.low, float(regions.min()) / white.edge),
            lowest=float(regions.min()) / white.edge,
            high=max(noise.high, float(regions.max()) / white.edge),
            highest=max(float(regions.max()) / white.edge, level),
            regions=len(regions),
        )
        return Estimate(noise, middles, regions)
    return Estimate(noise, white.middles, np.full(len(white.middles), noise.file_units))


def _with_level(verdict: Verdict, level: float) -> Verdict:
    """The verdict with another level, mean edges, and its interval by as much."""
    scale = level / verdict.level
    return dataclasses.replace(
        verdict, level=level, low=scale * verdict.low, high=scale * verdict.high
    )


def _is_white_on_relief(white: WhiteEstimate, verdict: Verdict) -> bool:
    """Whether fits over one-rings see more than noise that neighbours share leaves there."""
    if verdict.kind != "correlated":
        return False
    return white.level.mean_edges > MAX_SEEN[min(verdict.rings, 2)] * verdict.level


def _naming_probability(verdict: Verdict, evidence: Evidence) -> float:
    """Probability from which the kind is named."""
    if verdict.kind != "correlated":
        return NAMED * verdict.noise
    colour = evidence.colour
    if colour is None:
        return SURE_SHARED
    if colour.is_relief or colour.misfit > POOR_MISFIT:
        return RELIEF_SHARED
    is_plain = colour.is_floor and colour.misfit < PLAIN_MISFIT
    return PLAIN_SHARED if is_plain else SURE_SHARED


def _needed_probability(verdict: Verdict, evidence: Evidence) -> float:
    """Probability of noise from which there is some.

    A trace of noise that neighbours share is hardly seen, and relief is, once it is gone; detail on
    a part of a design is more frequent than noise on a part of a scan, what neighbours share has a
    floor where it is noise, and blocks on a grid are designs as well.
    """
    level = verdict.level
    if verdict.kind == "view" and evidence.axis is not None:
        level = min(level, evidence.axis.best_level)
    if verdict.kind in SHARED_KINDS and level < QUIET:
        return SURE_NOISE
    is_detail = verdict.kind == "uneven" and evidence.loud_correlation > 0.0
    colour = evidence.colour
    is_patchy = verdict.kind == "correlated" and colour is not None and not colour.is_floor
    if is_detail or is_patchy or verdict.kind == "staircase":
        return SURE_DESIGN
    return SURE_FEW if evidence.numbers[SIZE] < math.log(MANY_VERTICES) else 0.5


def _is_unsure(verdict: Verdict) -> bool:
    readings = _order_readings(verdict.level, verdict.noise)
    return readings[0].probability < 0.9


def _order_readings(level: float, noise: float) -> tuple[Reading, ...]:
    """Both readings, the more probable first: noise of a level, or all of it surface."""
    readings = Reading(NOISE, level, noise), Reading(TEXTURE, 0.0, 1.0 - noise)
    return readings if noise >= 0.5 else readings[::-1]


def _without_noise(
    white: WhiteEstimate, probability: float, basis: str, verdict: Verdict | None = None
) -> Estimate:
    """No noise, or less than can be seen; with a verdict that is unsure, up to its level."""
    noise = dataclasses.replace(
        white.level,
        mean_edges=0.0,
        low=0.0,
        high=0.0 if verdict is None else verdict.level,
        file_units=0.0,
        clean_edges=0.0,
        rms_edges=0.0,
        is_negligible=True,
        lowest=0.0,
        highest=0.0,
        character=NoiseCharacter("none", confidence=probability, basis=basis),
        readings=_order_readings(0.0 if verdict is None else verdict.level, 1.0 - probability),
    )
    return Estimate(noise, white.middles, np.zeros(len(white.middles)))


def _possible_kinds(evidence: Evidence) -> set[str]:
    """Kinds of which everything is known that describes them."""
    kinds = set(KIND_NAMES)
    if evidence.axis is None:
        kinds.discard("view")
    if not _has_depth_steps(evidence):
        kinds.discard("quantised")
    if evidence.steps.n_axes < 3:
        kinds.discard("staircase")
    if evidence.differences is None:
        kinds.discard("uneven")
    return kinds


def _has_depth_steps(evidence: Evidence) -> bool:
    """Whether there are steps along an axis that explains what fits leave, or that the mesh faces:
    rows of a range scan are in steps within the surface."""
    axis = evidence.steps.axis
    if axis is None:
        return False
    faces = float(((evidence.survey.normals @ axis) ** 2).mean()) > FACING
    return faces or evidence.steps.along_gain > MIN_GAIN


def _leave_unknown(evidence: Evidence, verdict: Verdict) -> NoiseCharacter:
    return NoiseCharacter("unknown", confidence=verdict.probability, basis=_describe_fits(evidence))


def _characterize(evidence: Evidence, verdict: Verdict) -> NoiseCharacter:
    kind = verdict.kind
    character = NoiseCharacter(kind, confidence=verdict.probability, basis=_describe_fits(evidence))
    rings = verdict.rings if kind in SHARED_KINDS else 0
    if kind == "correlated":
        rings = max(rings, 1)
    axis = None
    if kind == "quantised":
        axis = evidence.steps.axis
    if kind == "view":
        assert evidence.axis is not None
        axis = evidence.axis.axis
    if axis is not None:
        x, y, z = axis.tolist()
        character = dataclasses.replace(
            character,
            direction="axis",
            axis=(x, y, z),
            basis="vertices slide along the axis, and what fits leave falls with the angle to it",
        )
    if kind == "isotropic":
        character = dataclasses.replace(
            character,
            direction="isotropic",
            basis="vertices are moved within the surface as much as along the normals",
        )
    if kind in ("quantised", "staircase"):
        character = dataclasses.replace(
            character,
            step=evidence.steps.step,
            basis="neighbours differ by multiples of one step",
        )
    if kind == "outliers":
        share = max(evidence.outliers, evidence.tail)
        character = dataclasses.replace(
            character, outliers=share, basis=f"{100.0 * share:.2g} % of the vertices lie far off"
        )
    if kind == "impulsive":
        character = dataclasses.replace(
            character,
            basis=f"{100.0 * evidence.tail:.2g} % of the vertices stand out along the normals",
        )
    if kind == "uneven":
        character = dataclasses.replace(character, basis="what fits leave differs by region")
    return dataclasses.replace(character, rings=rings)


def _describe_fits(evidence: Evidence) -> str:
    """Such as ``fits leave 0.056 e over two rings, 0.14 e over six``."""
    two, six = (np.sqrt(max(evidence.survey.quantile(fit, 0.2), 0.0)) for fit in (TWO, SIX))
    if not np.isfinite(six):
        return f"fits leave {two:.2g} e over two rings"
    return f"fits leave {two:.2g} e over two rings, {six:.2g} e over six"
