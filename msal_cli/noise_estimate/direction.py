"""Along what the noise is: the normals, one axis, or all directions.

Noise along an axis leaves less to fits where the surface is steep to the axis: by the square of
the cosine.  And it moves vertices within the surface there, along the axis and not across it.
Isotropic noise moves them within the surface as much as out of it, and by chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.noise_estimate.quantiles import chi_square_quantile
from msal_cli.noise_estimate.survey import THREE, Survey

Floats = NDArray[np.float64]

MOST_GROUPS = 24
"""Groups of places with alike normals."""

FEWEST_IN_GROUP = 8
FEWEST_PLACES = 60
"""Places that a direction can be seen from."""

LOW_SHARE = 0.25
"""Share of the places of a group whose surface is taken for flat."""

CLOSE = 0.02
"""Squared sine of the angle to all groups below which no other group is needed."""

ROUNDS = 8
"""Rounds of the fit in which groups with more texture count for less."""

GRAIN = 0.02
"""What is added to squared cosines, so that no group counts for more than four in logarithms."""

WORST_MISFIT, LEAST_GAIN = 0.6, 0.1
"""Mean error of the logarithms of the groups' variances, with which an axis is taken; and by how
much it has to be less than without."""

LEAST_SLIDE, LEAST_CONTRAST = 0.5, 1.25
"""Movement along the axis within the surface, as a share of the level, and over that across it,
that an axis shows at least."""

CLEAR_SLIDE, CLEAR_CONTRAST, WORST_IF_CLEAR = 0.7, 2.5, 0.75
"""The same where it leaves no doubt, and the misfit that is allowed then."""

STEEP = 0.3
"""Sine of the angle between normal and axis from which movement along it can be seen."""

FLAT_COSINE = 0.25
"""Squared cosine from which a place tells the level along an axis."""

JITTER_LOW, JITTER_HIGH, JITTER_SHAPE = 0.8, 1.5, 1.25
"""Movement within the surface over that along the normals, of isotropic noise: the least and the
most, and by how much more the upper half of places may show than the lowest tenth."""


@dataclass(frozen=True)
class AxisEvidence:
    """How well noise along an axis explains what is left over.

    Attributes
    ----------
    axis : (3,) unit vector.
    misfit, without : mean error of the logarithms of variances along the axis, and along normals.
    slide : standard deviation of vertices within the surface along the axis, mean edges.
    contrast : that over the one across the axis.
    level : standard deviation along the axis, mean edges, taken for white.
    """

    axis: Floats
    misfit: float
    without: float
    slide: float
    contrast: float
    level: float

    @property
    def is_sure(self) -> bool:
        """Whether the noise is along the axis."""
        slides = self.slide > CLEAR_SLIDE * self.level and self.contrast > CLEAR_CONTRAST
        return (
            self.misfit < (WORST_IF_CLEAR if slides else WORST_MISFIT)
            and self.without - self.misfit > LEAST_GAIN
            and self.slide > LEAST_SLIDE * self.level
            and self.contrast > LEAST_CONTRAST
        )

    @property
    def confidence(self) -> float:
        """How sure that is, from 0.5 to 0.99."""
        gain = self.without - self.misfit
        return min(0.5 + gain, 0.99)


@dataclass(frozen=True, eq=False)
class Groups:
    """Places by their normals.

    Attributes
    ----------
    variances, normals : (c,), scaled to the level of noise, and (c, 3), of the places.
    levels : (g,) low variance of each group.
    squares : (g, 3, 3) mean products of the coordinates of the normals.
    counts : (g,) number of places.
    """

    variances: Floats
    normals: Floats
    levels: Floats
    squares: Floats
    counts: Floats

    def misfit(self, axis: Floats | None) -> float:
        """Mean error of the logarithms of the levels, for noise along an axis or the normals."""
        return _misfit(axis, self.levels, self.squares, self.counts)


def group_places(survey: Survey) -> Groups | None:
    """The places by their normals; None where too few are alike."""
    fit = THREE
    has = np.isfinite(survey.variances[:, fit]) & (survey.freedoms[:, fit] > 5.0)
    if has.sum() < FEWEST_PLACES:
        return None
    variances, normals = survey.variances[has, fit], survey.normals[has]
    scaled = variances / chi_square_quantile(survey.freedoms[has, fit], LOW_SHARE)
    levels, squares, counts = _group(scaled, normals)
    if len(levels) < 3 or levels.max() <= 0.0:
        return None
    return Groups(scaled, normals, levels, squares, counts)


def find_axis(survey: Survey, groups: Groups) -> AxisEvidence | None:
    """The axis that the noise is along, if it is along any; None where that cannot be seen."""
    levels, squares, counts = groups.levels, groups.squares, groups.counts
    candidates = [_main_axis(levels, squares, counts), _main_offset(survey.offsets)]
    best, misfit = None, math.inf
    for candidate in candidates:
        axis, error = _refine(candidate, levels, squares, counts)
        if error < misfit:
            best, misfit = axis, error
    if best is None:
        return None
    level = _axis_level(groups.variances, groups.normals, best)
    without = groups.misfit(None)
    slide, across = _slides(survey, best)
    contrast = slide / across if across > 0.0 else (math.inf if slide > 0.0 else 0.0)
    return AxisEvidence(_signed(best), misfit, without, slide, contrast, level)


def _group(scaled: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
    """Places by their normals: the low variance (g,), the mean products of the normals'
    coordinates (g, 3, 3), and the number of places (g,) of each group."""
    spread = normals.T @ normals
    # The first one is along what most are along.
    current = int(np.abs(normals @ np.linalg.eigh(spread)[1][:, 2]).argmax())
    distances = np.full(len(normals), np.inf)
    labels = np.zeros(len(normals), dtype=np.int64)
    for group in range(MOST_GROUPS):
        apart = 1.0 - (normals @ normals[current]) ** 2
        labels[apart < distances] = group
        np.minimum(distances, apart, out=distances)
        current = int(distances.argmax())
        if distances[current] < CLOSE:
            break
    levels, squares, counts = [], [], []
    for group in range(int(labels.max()) + 1):
        among = labels == group
        count = int(among.sum())
        if count >= FEWEST_IN_GROUP:
            values = scaled[among]
            rank = int(LOW_SHARE * (count - 1))
            levels.append(float(np.partition(values, rank)[rank]))
            squares.append(normals[among].T @ normals[among] / count)
            counts.append(float(count))
    return np.array(levels), np.array(squares).reshape(-1, 3, 3), np.array(counts)


def _main_axis(levels: Floats, squares: Floats, counts: Floats) -> Floats:
    """Main axis of the covariance C for which n' C n is nearest to the groups' variances."""
    design = np.stack(
        [
            squares[:, 0, 0],
            squares[:, 1, 1],
            squares[:, 2, 2],
            2.0 * squares[:, 0, 1],
            2.0 * squares[:, 0, 2],
            2.0 * squares[:, 1, 2],
        ],
        axis=1,
    )
    mean = float(counts @ levels / counts.sum())
    fitted = np.full(len(levels), mean)
    floor = 1e-3 * float(levels.max())
    axes = np.eye(3)
    for _ in range(ROUNDS):
        # Texture adds to groups, and nothing takes away from them.
        too_much = np.minimum(1.6 * fitted / np.maximum(levels, 1e-300), 1.0)
        weights = np.sqrt(counts) * too_much / (fitted + floor)
        weighted = design * weights[:, None]
        normal = weighted.T @ weighted
        ridge = 1e-3 * float(np.trace(normal)) / 6.0
        right = weighted.T @ (levels * weights) + ridge * mean * np.array([1, 1, 1, 0, 0, 0])
        c = np.linalg.solve(normal + ridge * np.eye(6), right)
        matrix = np.array([[c[0], c[3], c[4]], [c[3], c[1], c[5]], [c[4], c[5], c[2]]])
        values, axes = np.linalg.eigh(matrix)
        matrix = (axes * np.maximum(values, 0.0)) @ axes.T
        fitted = np.maximum((squares * matrix).sum(axis=(1, 2)), 0.0)
    main: Floats = axes[:, 2]
    return main


def _main_offset(offsets: Floats) -> Floats:
    """Direction in which vertices are furthest off the middles of their rings."""
    lengths = np.sqrt((offsets * offsets).sum(axis=1))
    most = 2.0 * float(np.median(lengths))
    clipped = offsets * (np.minimum(lengths, most) / np.maximum(lengths, 1e-300))[:, None]
    main: Floats = np.linalg.eigh(clipped.T @ clipped)[1][:, 2]
    return main


def _misfit(axis: Floats | None, levels: Floats, squares: Floats, counts: Floats) -> float:
    """Mean error of the logarithms of variances along an axis, or along the normals."""
    cosines = np.ones(len(levels)) if axis is None else squares @ axis @ axis
    faces = cosines > 0.1
    if not faces.any():
        return math.inf
    order = np.argsort(levels[faces] / cosines[faces])
    shares = np.cumsum(counts[faces][order])
    middle = order[int(np.searchsorted(shares, 0.5 * shares[-1]))]
    variance = float((levels[faces] / cosines[faces])[middle])
    if variance <= 0.0:
        return math.inf
    errors = np.abs(np.log((levels / variance + GRAIN) / (cosines + GRAIN)))
    return float(counts @ np.minimum(errors, 3.0) / counts.sum())


def _refine(axis: Floats, levels: Floats, squares: Floats, counts: Floats) -> tuple[Floats, float]:
    """The axis near by with the least misfit, and that."""
    least = _misfit(axis, levels, squares, counts)
    for turn in (0.3, 0.15, 0.08, 0.04):
        across = np.linalg.svd(axis[None])[2][1:]
        start = axis
        for angle in np.arange(8) * (math.pi / 4.0):
            other = start + turn * (math.cos(angle) * across[0] + math.sin(angle) * across[1])
            other = other / math.sqrt(float(other @ other))
            error = _misfit(other, levels, squares, counts)
            if error < least:
                axis, least = other, error
    return axis, least


def _axis_level(scaled: Floats, normals: Floats, axis: Floats) -> float:
    """Standard deviation along an axis, where the surface faces it."""
    cosines = (normals @ axis) ** 2
    faces = cosines > FLAT_COSINE
    if not faces.any():
        return 0.0
    values = scaled[faces] / cosines[faces]
    rank = int(LOW_SHARE * (len(values) - 1))
    return math.sqrt(float(np.partition(values, rank)[rank]))


def _slides(survey: Survey, axis: Floats) -> tuple[float, float]:
    """Standard deviation of vertices within the surface along an axis, as if all were along it,
    and across it."""
    normals, offsets = survey.normals, survey.offsets
    along = axis - (normals @ axis)[:, None] * normals
    sines = np.sqrt((along * along).sum(axis=1))
    steep = sines > STEEP
    if steep.sum() < FEWEST_PLACES // 2:
        return 0.0, 0.0
    along = along[steep] / sines[steep][:, None]
    across = np.cross(normals[steep], along)
    slide = (offsets[steep] * along).sum(axis=1) / sines[steep]
    other = (offsets[steep] * across).sum(axis=1)
    return 1.4826 * float(np.median(np.abs(slide))), 1.4826 * float(np.median(np.abs(other)))


def _signed(axis: Floats) -> Floats:
    """The axis turned so that its largest coordinate is positive."""
    return axis if axis[np.abs(axis).argmax()] > 0.0 else -axis


def is_isotropic(survey: Survey, level: float) -> bool:
    """Whether vertices are moved within the surface as by noise of a level, mean edges."""
    along = (survey.offsets * survey.normals).sum(axis=1)
    squares = 0.5 * ((survey.offsets**2).sum(axis=1) - along * along)
    few, some, half = np.quantile(np.maximum(squares, 0.0), [0.1, 0.3, 0.5])
    # Of chi square with two degrees of freedom, by those.
    few, some, half = few / 0.10536, some / 0.35667, half / 0.69315
    low, high = (JITTER_LOW * level) ** 2, (JITTER_HIGH * level) ** 2
    return bool(low < some < high and few > low and half < JITTER_SHAPE**2 * max(few, low))
