"""Along what the noise is: the normals, one axis, or all directions.

Noise along an axis leaves less to fits where the surface is steep to the axis: by the square of
the cosine.  And it moves vertices within the surface there, along the axis and not across it.
Isotropic noise moves them within the surface as much as out of it, and by chance.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from msal_cli.analysis.noise_estimate.survey import THREE, Survey, chi_square_quantile, quantile
from msal_cli.arrays import Floats

MAX_GROUPS = 24
"""Groups of places with alike normals."""

MIN_IN_GROUP = 8
MIN_PLACES = 60
"""Places that a direction can be seen from."""

LOW_SHARE = 0.25
"""Share of the places of a group whose surface is taken for flat."""

CLOSE = 0.02
"""Squared sine of the angle to all groups below which no other group is needed."""

ROUNDS = 8
"""Rounds of the fit in which groups with more texture count for less."""

GRAIN, MAX_ERROR = 0.02, 3.0
"""What is added to squared cosines, and the most that the logarithm of a variance counts."""

FACING = 0.1
"""Mean squared cosine to an axis from which a group tells the level along it."""

HOPELESS = 0.4
"""By how much an axis may be worse than none before it is turned."""

TURNS = (0.3, 0.15, 0.08, 0.04)
"""Tangents of the angles by which an axis is turned in search of a better one."""


CLEAR_SLIDE, CLEAR_CONTRAST = 0.7, 2.5
"""Movement along the axis within the surface, as a share of the level, and over that across it,
that an axis shows at least where it leaves no doubt."""

PLAIN_GAIN, SHARED_SLIDE, PLAIN_CONTRAST = 0.5, 0.35, 1.35
"""Gain that texture and noise by region do not bring, and the least movement and contrast then."""

MAX_EXCESS = 1.4
"""Movement along the axis over the level that noise explains where the contrast is low."""

MIN_OF_SLIDE = 0.85
"""Share of that movement that the level has at least, where it is clear."""

LINKED, LINKED_CONTRAST, LINKED_SLIDE = 0.33, 3.0, (0.5, 1.8)
"""How much more often than not the ways of a vertex within the surface and out of it are along one
axis, the contrast of those within it, and their least and most in levels along the axis, where
noise is along it.  On eleven models noise along an axis has 0.33 to 0.79 and 2 to 14, and other
noise at most 0.3, or a contrast of at most 1.7."""

STEEP = 0.3
"""Sine of the angle between normal and axis from which movement along it can be seen."""

FLAT_COSINE = 0.25
"""Squared cosine from which a place tells the level along an axis."""


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
    agreement : how much more often than not the ways of a vertex within the surface and out of it
        are along the axis, -1 to 1.
    """

    axis: Floats
    misfit: float
    without: float
    slide: float
    contrast: float
    level: float
    agreement: float

    @property
    def is_linked(self) -> bool:
        """Whether vertices that slide along the axis are out of the surface along it as well.

        Neither relief nor uneven triangles link the two.
        """
        least, most = LINKED_SLIDE
        slides = least * self.level < self.slide < most * self.level
        return self.agreement > LINKED and self.contrast > LINKED_CONTRAST and slides

    @property
    def is_clear(self) -> bool:
        """Whether vertices slide along the axis as much as noise along it makes them."""
        # Those that share noise slide less.
        least = SHARED_SLIDE if self.gain > PLAIN_GAIN else CLEAR_SLIDE
        if self.excess < least * self.level:
            return False
        is_plain = self.gain > PLAIN_GAIN and self.excess < MAX_EXCESS * self.level
        return self.contrast > (PLAIN_CONTRAST if is_plain else CLEAR_CONTRAST)

    @property
    def excess(self) -> float:
        """Standard deviation along the axis by how much more vertices slide along it."""
        return self.slide * math.sqrt(max(1.0 - 1.0 / max(self.contrast, 1.0) ** 2, 0.0))

    @property
    def best_level(self) -> float:
        """Standard deviation along the axis, if the noise is white: by what fits leave over, within
        what the vertices slide, which shape does not add to."""
        if not self.is_clear:
            return self.level
        return min(max(self.level, MIN_OF_SLIDE * self.excess), self.excess)

    @property
    def gain(self) -> float:
        """How much better the axis explains the variances than the normals do."""
        return self.without - self.misfit


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
        if axis is None:
            return _misfit(np.ones(len(self.levels)), self.levels, self.counts)
        return _misfit(_cosines(axis[None], self.squares)[0], self.levels, self.counts)


def group_places(survey: Survey) -> Groups | None:
    """The places by their normals; None where too few are alike."""
    fit = THREE
    has = np.isfinite(survey.variances[:, fit]) & (survey.freedoms[:, fit] > 5.0)
    if has.sum() < MIN_PLACES:
        return None
    variances, normals = survey.variances[has, fit], survey.normals[has]
    scaled = variances / chi_square_quantile(survey.freedoms[has, fit], LOW_SHARE)
    levels, squares, counts = _group(scaled, normals)
    if len(levels) < 3 or levels.max() <= 0.0:
        return None
    return Groups(scaled, normals, levels, squares, counts)


def find_axis(survey: Survey, groups: Groups) -> AxisEvidence | None:
    """The axis that the noise is along, if it is along any; None where that cannot be seen."""
    candidates = [
        _main_axis(groups.levels, groups.squares, groups.counts),
        find_main_offset(survey.offsets),
    ]
    without = groups.misfit(None)
    best, misfit = None, math.inf
    for candidate in candidates:
        if groups.misfit(candidate) > without + HOPELESS:
            continue
        axis, error = _refine(candidate, groups)
        if error < misfit:
            best, misfit = axis, error
    return None if best is None else weigh_axis(survey, groups, best)


def weigh_axis(survey: Survey, groups: Groups, axis: Floats) -> AxisEvidence:
    """What speaks for noise along an axis (3,)."""
    slide, across = _slides(survey, axis)
    return AxisEvidence(
        axis=_signed(axis),
        misfit=groups.misfit(axis),
        without=groups.misfit(None),
        slide=slide,
        contrast=slide / across if across > 0.0 else (math.inf if slide > 0.0 else 0.0),
        level=_axis_level(groups.variances, groups.normals, axis),
        agreement=_agreement(survey, axis),
    )


def _group(scaled: Floats, normals: Floats) -> tuple[Floats, Floats, Floats]:
    """Places by their normals: the low variance (g,), the mean products of the normals'
    coordinates (g, 3, 3), and the number of places (g,) of each group."""
    spread = normals.T @ normals
    # The first one is along what most are along.
    current = int(np.abs(normals @ np.linalg.eigh(spread)[1][:, 2]).argmax())
    distances = np.full(len(normals), np.inf)
    labels = np.zeros(len(normals), dtype=np.int64)
    for group in range(MAX_GROUPS):
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
        if count >= MIN_IN_GROUP:
            levels.append(quantile(scaled[among], LOW_SHARE))
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


def find_main_offset(offsets: Floats) -> Floats:
    """Direction in which vertices are furthest off the middles of their rings."""
    lengths = np.sqrt((offsets * offsets).sum(axis=1))
    most = 2.0 * float(np.median(lengths))
    clipped = offsets * (np.minimum(lengths, most) / np.maximum(lengths, 1e-300))[:, None]
    main: Floats = np.linalg.eigh(clipped.T @ clipped)[1][:, 2]
    return main


def _cosines(axes: Floats, squares: Floats) -> Floats:
    """Mean squared cosines (k, g) of the groups' normals to axes (k, 3)."""
    products = (axes[:, :, None] * axes[:, None, :]).reshape(len(axes), 9)
    cosines: Floats = products @ squares.reshape(-1, 9).T
    return cosines


def _misfit(cosines: Floats, levels: Floats, counts: Floats) -> float:
    """Mean error of the logarithms of variances (g,) that go by squared cosines (g,)."""
    faces = cosines > FACING
    if not faces.any():
        return math.inf
    ratios = levels[faces] / cosines[faces]
    order = np.argsort(ratios)
    shares = np.cumsum(counts[faces][order])
    variance = float(ratios[order[int(np.searchsorted(shares, 0.5 * shares[-1]))]])
    if variance <= 0.0:
        return math.inf
    errors = np.abs(np.log((levels / variance + GRAIN) / (cosines + GRAIN)))
    return float(counts @ np.minimum(errors, MAX_ERROR) / counts.sum())


def _refine(axis: Floats, groups: Groups) -> tuple[Floats, float]:
    """The axis near by with the least misfit, and that."""
    least = groups.misfit(axis)
    angles = np.arange(8) * (math.pi / 4.0)
    for turn in TURNS:
        across = np.linalg.svd(axis[None])[2][1:]
        ways = np.cos(angles)[:, None] * across[0] + np.sin(angles)[:, None] * across[1]
        others = axis + turn * ways
        others /= math.sqrt(1.0 + turn * turn)
        for other, cosines in zip(others, _cosines(others, groups.squares), strict=True):
            error = _misfit(cosines, groups.levels, groups.counts)
            if error < least:
                axis, least = other, error
    return axis, least


def _axis_level(scaled: Floats, normals: Floats, axis: Floats) -> float:
    """Standard deviation along an axis, where the surface faces it."""
    cosines = (normals @ axis) ** 2
    faces = cosines > FLAT_COSINE
    if not faces.any():
        return 0.0
    return math.sqrt(quantile(scaled[faces] / cosines[faces], LOW_SHARE))


def _slides(survey: Survey, axis: Floats) -> tuple[float, float]:
    """Standard deviation of vertices within the surface along an axis, as if all were along it,
    and across it."""
    normals, offsets = survey.normals, survey.offsets
    along = axis - (normals @ axis)[:, None] * normals
    sines = np.sqrt((along * along).sum(axis=1))
    steep = sines > STEEP
    if steep.sum() < MIN_PLACES // 2:
        return 0.0, 0.0
    along = along[steep] / sines[steep][:, None]
    across = np.cross(normals[steep], along)
    slide = (offsets[steep] * along).sum(axis=1) / sines[steep]
    other = (offsets[steep] * across).sum(axis=1)
    return 1.4826 * float(np.median(np.abs(slide))), 1.4826 * float(np.median(np.abs(other)))


def _agreement(survey: Survey, axis: Floats) -> float:
    """How much more often than not vertices are off the middles of their rings to one side of the
    axis by their ways within the surface and out of it, where it is oblique."""
    cosines = survey.normals @ axis
    along = axis - cosines[:, None] * survey.normals
    oblique = (np.abs(cosines) > STEEP) & (np.sqrt((along * along).sum(axis=1)) > STEEP)
    if oblique.sum() < MIN_PLACES // 2:
        return 0.0
    out = (survey.offsets * survey.normals).sum(axis=1) * cosines
    within = (survey.offsets * along).sum(axis=1)
    return float((np.sign(out) * np.sign(within))[oblique].mean())


def _signed(axis: Floats) -> Floats:
    """The axis turned so that its largest coordinate is positive."""
    return axis if axis[np.abs(axis).argmax()] > 0.0 else -axis
