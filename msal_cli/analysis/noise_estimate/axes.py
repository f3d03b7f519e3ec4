"""Noise along an axis, as of a scan from one view, and quantised depths.

Noise along an axis leaves less residual variance where the surface is steep to the axis, by the
square of the cosine, and there it displaces vertices tangentially along the axis but not across it.
Isotropic noise displaces them tangentially as much as along the normals, and independently.

If depths are rounded along an axis, or the surface is made of voxels, coordinate differences
between neighbours are exact multiples of one step, and the residuals have the variance of rounding
to it.  Both conditions are needed: the coordinates of a regular grid, or of a box on it, come in
steps too, but leave no residuals.
"""

import itertools
import math
from collections.abc import Iterator

import numpy as np

from msal_cli.analysis.noise_estimate.fits import FOUR, THREE, Survey, chi_square_quantile, quantile
from msal_cli.arrays import Floats
from msal_cli.kernels.geometry import count_parallel
from msal_cli.kernels.quantiles import PER_MEDIAN, median
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

MAX_GROUPS, MIN_IN_GROUP, MIN_PLACES = 24, 8, 60
"""Largest number of groups of places with similar normals, and the places that a group and an axis
need."""

LOW_SHARE = 0.25
"""Quantile of the variances of a group that is its level; these places count as flat."""

CLOSE = 0.02
"""Groups are added while a normal has a larger squared sine of its angle to each of them."""

ROUNDS = 8
"""Iterations of the fit, which reduce the weight of groups with texture."""

FACING, GRAIN, MAX_ERROR = 0.1, 0.02, 3.0
"""Mean squared cosine to the axis above which a group of normals counts for the level; constant
added to squared cosines and to ratios of variances before logarithms are compared; and the largest
error of a logarithm that counts."""

HOPELESS, TURNS = 0.4, (0.3, 0.15, 0.08, 0.04)
"""Candidates whose misfit exceeds that without an axis by more are not refined; the others are
turned by angles with these tangents."""

CLEAR_SLIDE, CLEAR_CONTRAST = 0.7, 2.5
"""An axis is clear if tangential displacements along it are at least this share of the level, and
so many times those across it."""

PLAIN_GAIN, SHARED_SLIDE, PLAIN_CONTRAST, MAX_EXCESS = 0.5, 0.35, 1.35, 1.4
"""For an axis with a larger gain than the first, which texture and uneven noise do not reach, the
next two are these bounds; the lower contrast only up to the last ratio of displacement and level,
above which there is no noise."""

MIN_OF_SLIDE = 0.85
"""The level is at least this share of that displacement."""

LINKED, LINKED_CONTRAST, LINKED_SLIDE = 0.33, 3.0, (0.5, 1.8)
"""Bounds for noise along an axis: the smallest agreement of tangential and normal displacements,
the smallest contrast, and the smallest and largest tangential displacement over the level.  On
eleven models noise along an axis has agreements of 0.33 to 0.79 and contrasts of 2 to 14; other
noise has at most 0.3, or a contrast of at most 1.7."""

STEEP, FLAT_COSINE = 0.3, 0.25
"""Sine of the angle of normal and axis above which tangential displacements are measured, and its
squared cosine above which a place counts for the level."""


@dataclass(frozen=True)
class AxisEvidence:
    """How well noise along an axis explains residuals and displacements."""

    axis: Floats  # (3,) unit vector
    misfit: float  # mean error of the logarithms of variances if the noise is along the axis
    gain: float  # how much smaller it is than if the noise is along the normals
    slide: float  # standard deviation of tangential displacements along it, mean edges
    contrast: float  # slide over the same across the axis
    level: float  # standard deviation along the axis, mean edges, if the noise is white
    # mean product of the signs of tangential and normal displacements along the axis, -1 to 1
    agreement: float

    @property
    def is_linked(self) -> bool:
        """Whether tangential displacements along the axis come with normal ones, as noise does.

        Neither relief nor uneven triangles link the two.
        """
        least, most = LINKED_SLIDE
        slides = least * self.level < self.slide < most * self.level
        return self.agreement > LINKED and self.contrast > LINKED_CONTRAST and slides

    @property
    def is_clear(self) -> bool:
        """Whether tangential displacements along the axis are as large as those of noise."""
        # Displacements by correlated noise are smaller.
        least = SHARED_SLIDE if self.gain > PLAIN_GAIN else CLEAR_SLIDE
        if self.excess < least * self.level:
            return False
        is_plain = self.gain > PLAIN_GAIN and self.excess < MAX_EXCESS * self.level
        return self.contrast > (PLAIN_CONTRAST if is_plain else CLEAR_CONTRAST)

    @property
    def excess(self) -> float:
        """Standard deviation along the axis by the excess of displacements along it."""
        return self.slide * math.sqrt(max(1.0 - 1.0 / max(self.contrast, 1.0) ** 2, 0.0))

    @property
    def best_level(self) -> float:
        """Standard deviation along the axis, if the noise is white: by residuals, within bounds by
        the displacements, to which shape does not add."""
        if not self.is_clear:
            return self.level
        return min(max(self.level, MIN_OF_SLIDE * self.excess), self.excess)


@dataclass(frozen=True, eq=False)
class Groups:
    """Places grouped by their normals."""

    # variances, normals: of the places, residual variances (c,) scaled to that of noise, and (c, 3)
    variances: Floats
    normals: Floats
    levels: Floats  # (g,) quantile ``LOW_SHARE`` of the variances of each group
    squares: Floats  # (g, 3, 3) mean outer products of the normals
    counts: Floats  # (g,) number of places

    def misfit(self, axis: Floats) -> float:
        """Mean error of the logarithms of the levels for noise along an axis."""
        return self.misfit_of(self.cosines(axis[None])[0])

    def gain(self, axis: Floats) -> float:
        """How much smaller that error is than for noise along the normals."""
        return self.misfit_of(np.ones(len(self.levels))) - self.misfit(axis)

    def cosines(self, axes: Floats) -> Floats:
        """Mean squared cosines (k, g) of the groups' normals to axes (k, 3)."""
        products = (axes[:, :, None] * axes[:, None, :]).reshape(len(axes), 9)
        cosines: Floats = products @ self.squares.reshape(-1, 9).T
        return cosines

    def misfit_of(self, cosines: Floats) -> float:
        """Mean error of the logarithms of levels proportional to squared ``cosines`` (g,)."""
        faces = cosines > FACING
        if not faces.any():
            return math.inf
        ratios = self.levels[faces] / cosines[faces]
        order = np.argsort(ratios)
        shares = np.cumsum(self.counts[faces][order])
        variance = float(ratios[order[int(np.searchsorted(shares, 0.5 * shares[-1]))]])
        if variance <= 0.0:
            return math.inf
        errors = np.abs(np.log((self.levels / variance + GRAIN) / (cosines + GRAIN)))
        return float(self.counts @ np.minimum(errors, MAX_ERROR) / self.counts.sum())


def group_places(survey: Survey) -> Groups | None:
    """Group the places by their normals; None if there are too few places or groups."""
    fit = THREE
    has = np.isfinite(survey.variances[:, fit]) & (survey.freedoms[:, fit] > 5.0)
    if has.sum() < MIN_PLACES:
        return None
    normals = survey.normals[has]
    scaled = survey.variances[has, fit] / chi_square_quantile(survey.freedoms[has, fit], LOW_SHARE)
    # The first one is nearest to the principal axis of the normals.
    current = int(np.abs(normals @ np.linalg.eigh(normals.T @ normals)[1][:, 2]).argmax())
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
    if len(levels) < 3 or max(levels) <= 0.0:
        return None
    return Groups(scaled, normals, np.array(levels), np.array(squares), np.array(counts))


def find_axis(survey: Survey, groups: Groups) -> AxisEvidence | None:
    """The axis with the smallest misfit; None if none is promising."""
    best, misfit = None, math.inf
    for candidate in (_main_axis(groups), find_main_offset(survey.offsets)):
        if groups.gain(candidate) < -HOPELESS:
            continue
        axis, error = _refine(candidate, groups)
        if error < misfit:
            best, misfit = axis, error
    return None if best is None else weigh_axis(survey, groups, best)


def weigh_axis(survey: Survey, groups: Groups, axis: Floats) -> AxisEvidence:
    """The evidence for noise along an axis (3,)."""
    slide, across, agreement = _measure_slides(survey, axis)
    cosines = (groups.normals @ axis) ** 2
    faces = cosines > FLAT_COSINE
    level = 0.0
    if faces.any():
        level = math.sqrt(quantile(groups.variances[faces] / cosines[faces], LOW_SHARE))
    return AxisEvidence(
        # The sign makes the largest coordinate positive.
        axis=axis if axis[np.abs(axis).argmax()] > 0.0 else -axis,
        misfit=groups.misfit(axis),
        gain=groups.gain(axis),
        slide=slide,
        contrast=slide / across if across > 0.0 else (math.inf if slide > 0.0 else 0.0),
        level=level,
        agreement=agreement,
    )


def _main_axis(groups: Groups) -> Floats:
    """Principal axis of the covariance C of noise for which n' C n fits the groups' levels."""
    levels, squares, counts = groups.levels, groups.squares, groups.counts
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    design = np.ascontiguousarray(squares[:, rows, columns]) * np.array(
        [1.0, 1.0, 1.0, 2.0, 2.0, 2.0]
    )
    mean = float(counts @ levels / counts.sum())
    fitted = np.full(len(levels), mean)
    floor = 1e-3 * float(levels.max())
    axes = np.eye(3)
    for _ in range(ROUNDS):
        # Texture only adds variance, so groups above the fit get less weight.
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
    """Principal axis of the offsets (c, 3) from the means of the one-rings, clipped."""
    lengths = np.sqrt((offsets * offsets).sum(axis=1))
    most = 2.0 * median(lengths)
    clipped = offsets * (np.minimum(lengths, most) / np.maximum(lengths, 1e-300))[:, None]
    main: Floats = np.linalg.eigh(clipped.T @ clipped)[1][:, 2]
    return main


def _refine(axis: Floats, groups: Groups) -> tuple[Floats, float]:
    """The axis near this one with the smallest misfit, and that misfit."""
    least = groups.misfit(axis)
    angles = np.arange(8) * (math.pi / 4.0)
    for turn in TURNS:
        across = np.linalg.svd(axis[None])[2][1:]
        directions = np.cos(angles)[:, None] * across[0] + np.sin(angles)[:, None] * across[1]
        others = axis + turn * directions
        others /= math.sqrt(1.0 + turn * turn)
        for other, cosines in zip(others, groups.cosines(others), strict=True):
            error = groups.misfit_of(cosines)
            if error < least:
                axis, least = other, error
    return axis, least


def _measure_slides(survey: Survey, axis: Floats) -> tuple[float, float, float]:
    """Standard deviations of tangential displacements along an axis, as a displacement along the
    axis itself, and across it; and the mean product of the signs of tangential and normal
    displacements along it, where the surface is oblique to the axis."""
    normals, offsets = survey.normals, survey.offsets
    cosines = normals @ axis
    along = axis - cosines[:, None] * normals
    sines = np.sqrt((along * along).sum(axis=1))
    slide = across = agreement = 0.0
    steep = sines > STEEP
    oblique = steep & (np.abs(cosines) > STEEP)
    if oblique.sum() >= MIN_PLACES // 2:
        out = (offsets * normals).sum(axis=1) * cosines
        within = (offsets * along).sum(axis=1)
        agreement = float((np.sign(out) * np.sign(within))[oblique].mean())
    if steep.sum() >= MIN_PLACES // 2:
        along = along[steep] / sines[steep][:, None]
        slides = (offsets[steep] * along).sum(axis=1) / sines[steep]
        other = (offsets[steep] * np.cross(normals[steep], along)).sum(axis=1)
        slide = PER_MEDIAN * median(np.abs(slides))
        across = PER_MEDIAN * median(np.abs(other))
    return slide, across, agreement


# Depths in steps

MIN_STEP, SAME = 0.05, 2e-3
"""Mean edge lengths: shorter steps come from the digits of the file, and are negligible; and those
below which two depths are equal."""

FIRST_SHARE = 0.02
"""Share of the differences that may be less than a step for other reasons."""

ON_STEP, MOSTLY = 0.02, 0.97
"""Distance from a multiple, in steps, up to which a difference is one, and the share of differences
that have to be multiples."""

MIN_DIFFERENCES = 100

OBLIQUE, MIN_OBLIQUE = (0.05, 0.95), 0.08
"""Squared cosines to the axis between which a place is oblique and shows terraces, and the share of
such places above which the others do not count."""

PARALLEL, ACROSS = 1e-6, 2e-3
"""Edges are parallel if the absolute cosine of their angle is at least 1 minus the first, and axes
of a grid have at most the second."""

MAX_CANDIDATES, MAX_DIRECTIONS, MIN_PARALLEL = 512, 13, 0.01
"""Number of edges whose directions are counted; number of the most frequent directions whose pairs
are tried, which is that of marching cubes along axes and diagonals; and the smallest share of edges
that such directions have."""

MAX_PAIRS, MAX_COMPARED, MAX_STEP_AXES = 200, 400, 4
"""Number of pairs of edges whose planes are tried as planes of equal depth, number of edges that
are compared with each plane, and number of planes whose steps are measured."""

MIN_SINE, PARALLEL_SINE, MIN_LEVEL_SHARE = 0.3, 1e-4, 0.05
"""Smallest sine of the angle between the edges of a pair, largest sine of the angle between a plane
and an edge in it, and smallest share of the edges in a plane."""

OF_VOXELS, OF_SLICES, SAME_HEIGHT = 0.205, 0.145, 1.2
"""Root mean square distance of terraces from the surface, in units of their height, if heights are
the same in all directions (up to the factor ``SAME_HEIGHT``) and if not: medians over ten closed
shapes, the second with slices of three voxels.  Shapes differ by 10 and 40 %."""

ACROSS_SLICES = 0.23
"""The same for other terraces, over the root mean square height along normals; within 20 %."""


@dataclass(frozen=True, eq=False)
class StepEvidence:
    """Steps in the coordinate differences between neighbours, whatever their cause."""

    n_axes: int = 0  # number of grid axes with steps, 0 to 3
    # (3,) unit vector along which depths are rounded; None for no steps, or steps along all axes
    axis: Floats | None = None
    step: float = 0.0  # the largest, mean edges; for terraces their height; 0 for none
    level: float = 0.0  # standard deviation of rounding to such steps, mean edges
    facing_level: float = 0.0  # the same, weighted by the directions of the normals
    voxel_share: float = 0.0  # share of the edges possible in marching cubes over voxels
    is_turned: bool = False  # whether the grid is rotated relative to the file's axes
    # gain of the axis, see ``AxisEvidence.gain``
    along_gain: float = 0.0
    # residual variance where the surface is oblique to the steps, over step^2 / 12
    roughness: float = 0.0


def measure_steps(mesh: Mesh, survey: Survey, groups: Groups | None) -> StepEvidence:
    """The steps along the axes of the file, along those of a turned grid, or along one axis."""
    rows, neighbours, _ = mesh.topology.rings_of(survey.vertices)
    differences = mesh.vertices[neighbours] - mesh.vertices[survey.vertices[rows]]
    differences /= mesh.mean_edge_length
    frame, is_turned = np.eye(3), False
    steps = _axis_steps(differences)
    if not any(steps):
        is_turned = True
        lengths = np.sqrt((differences * differences).sum(axis=1))
        directions = differences[lengths > SAME] / lengths[lengths > SAME, None]
        # Along the diagonals of voxels steps are shorter than along their edges.
        tried = [(_axis_steps(differences @ turn.T), turn) for turn in _find_frames(directions)]
        steps, frame = max(tried, key=lambda candidate: min(candidate[0]), default=(steps, frame))
        if not all(steps):
            axis = _find_step_axis(differences, directions)
            if axis is None:
                return StepEvidence()
            frame = np.stack([axis, axis, axis])
            steps = [_step(np.abs(differences @ axis)), 0.0, 0.0]
    if all(steps):
        step = 2.0 * max(steps)
        normals = survey.normals @ frame.T
        is_even = max(steps) < SAME_HEIGHT * min(steps)
        # Marching cubes over binary voxels put vertices on the midpoints of voxel edges, so the
        # coordinates of mesh edges, in steps, have an even sum; on other grids the sum may be odd.
        sums = np.round(differences @ frame.T / np.array(steps)).sum(axis=1)
        level = (OF_VOXELS if is_even else OF_SLICES) * step
        across = 2.0 * math.sqrt(float(((normals * steps) ** 2).sum(axis=1).mean()))
        return StepEvidence(
            n_axes=3,
            step=step,
            level=level,
            facing_level=level if is_even else ACROSS_SLICES * across,
            voxel_share=float((sums % 2.0 == 0.0).mean()),
            is_turned=is_turned,
            roughness=_roughness(survey, FOUR, (normals**2).max(axis=1), None, 0.5 * step),
        )
    best = int(np.argmax(steps))
    step, axis = steps[best], frame[best]
    squares = (survey.normals @ axis) ** 2
    return StepEvidence(
        n_axes=sum(step > 0.0 for step in steps),
        axis=axis,
        step=step,
        level=step / math.sqrt(12.0),
        facing_level=step / math.sqrt(12.0),
        is_turned=is_turned,
        along_gain=0.0 if groups is None else groups.gain(axis),
        roughness=_roughness(survey, THREE, squares, squares, step),
    )


def _find_step_axis(differences: Floats, some: Floats) -> Floats | None:
    """The direction exactly orthogonal to many edges along which the edge vectors ``differences``
    (d, 3) come in steps; None if there is none.  ``some`` (k, 3) are directions of edges."""
    if len(some) < MIN_DIFFERENCES:
        return None
    first = some[np.linspace(0, len(some) - 2, MAX_PAIRS).astype(np.int64)]
    # The next edge in the same one-ring.
    second = some[np.linspace(0, len(some) - 2, MAX_PAIRS).astype(np.int64) + 1]
    across = np.cross(first, second)
    sizes = np.sqrt((across * across).sum(axis=1))
    across = across[sizes > MIN_SINE] / sizes[sizes > MIN_SINE, None]
    compared = some[:: max(len(some) // MAX_COMPARED, 1)]
    shares = (np.abs(across @ compared.T) < PARALLEL_SINE).mean(axis=1)
    for candidate in np.argsort(-shares, kind="stable")[:MAX_STEP_AXES]:
        if shares[candidate] < MIN_LEVEL_SHARE:
            return None
        if _step(np.abs(differences @ across[candidate])):
            axis: Floats = across[candidate]
            return axis
    return None


def _roughness(
    survey: Survey, fit: int, squares: Floats, scale: Floats | None, step: float
) -> float:
    """Median residual variance over step^2 / 12 where the surface is oblique to the axis, or where
    it is not if few places are; ``scale`` (c,) divides the variances."""
    variances = survey.variances[:, fit]
    has = np.isfinite(variances) & (squares > OBLIQUE[0])
    oblique = has & (squares < OBLIQUE[1])
    if oblique.mean() > MIN_OBLIQUE:
        has = oblique
    if not has.any():
        return 0.0
    ratios = variances[has] if scale is None else variances[has] / scale[has]
    return min(median(ratios) / (step * step / 12.0), 100.0)


def _axis_steps(differences: Floats) -> list[float]:
    """The step of edge vectors (d, 3) along each axis; 0 for none."""
    return [_step(np.abs(differences[:, axis])) for axis in range(3)]


def _find_frames(directions: Floats) -> Iterator[Floats]:
    """Frames (3, 3), one axis in each row, of rotated grids on which edges with these directions
    (d, 3) may lie: two orthogonal ones of the most frequent directions, and their cross product."""
    some = np.ascontiguousarray(directions[:: max(-(-len(directions) // MAX_CANDIDATES), 1)])
    counts = np.empty(len(some), dtype=np.int64)
    count_parallel(some, np.ascontiguousarray(directions.T), 1.0 - PARALLEL, counts)
    shares = counts / len(directions)
    main: list[Floats] = []
    for candidate in np.argsort(-shares, kind="stable"):
        if shares[candidate] < MIN_PARALLEL or len(main) == MAX_DIRECTIONS:
            break
        if not main or (np.abs(np.array(main) @ some[candidate]) < 1.0 - SAME).all():
            main.append(some[candidate])
    for first, second in itertools.combinations(main, 2):
        if abs(float(first @ second)) < ACROSS:
            third = np.cross(first, second)
            third /= math.sqrt(float(third @ third))
            yield np.stack([first, np.cross(third, first), third])


def _step(differences: Floats) -> float:
    """The step of which absolute differences (d,) are multiples; 0 if there is none."""
    some = differences[differences > SAME]
    if len(some) < MIN_DIFFERENCES:
        return 0.0
    rank = int(FIRST_SHARE * len(some))
    step = float(np.partition(some, rank)[rank])
    for _ in range(3):
        multiples = np.round(some / step)
        near = (multiples > 0.0) & (np.abs(some / step - multiples) < 2.0 * ON_STEP)
        if not near.any():
            return 0.0
        step = float((multiples * some)[near].sum() / (multiples * multiples)[near].sum())
    is_on = np.abs(some / step - np.round(some / step)) < ON_STEP
    return step if step > MIN_STEP and is_on.mean() > MOSTLY else 0.0
