"""The level and the kind of the noise on a mesh, or whether there is any.

``fits`` measures the level of white noise over one- and two-rings, and fits polynomials over up to
six rings at fewer vertices; ``axes`` and ``evidence`` measure what each kind of noise would leave
there, and make features of it all.

From these features boosted trees, trained by ``python -m training.noise`` on scripted shapes with
noise of each kind and without, compute a score for each kind; the probabilities are the softmax of
the scores, calibrated on shapes outside the training set.  Two more forests estimate over how many
rings the noise is correlated, and a correction of the level measured for the kind.  Features are
compared in single precision, so that all processors take the same branches.
"""

import dataclasses
import functools
import math
import weakref
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.measures import apply_umbrella
from msal_cli.analysis.noise_estimate.evidence import (
    BOUNDARY_SHARE,
    FACING_SHARE,
    LEVELS,
    MISSING,
    OF_CLOSED,
    REGULAR_SHARE,
    SIZE,
    Evidence,
    gather_evidence,
)
from msal_cli.analysis.noise_estimate.fits import (
    FLATTEST,
    NEGLIGIBLE,
    SIX,
    TWO,
    WhiteEstimate,
    estimate_white,
    find_nearest,
)
from msal_cli.analysis.noise_estimate.level import (
    KINDS,
    MIN_PROBABILITY,
    NOISE,
    TEXTURE,
    NoiseCharacter,
    NoiseLevel,
    Reading,
)
from msal_cli.arrays import Floats
from msal_cli.kernels.connectivity import component_labels
from msal_cli.kernels.faces import dihedral_angles, flaps
from msal_cli.kernels.geometry import face_normals, ring_means
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh, cached_by_mesh

__all__ = [
    "NOISE",
    "TEXTURE",
    "NoiseCharacter",
    "NoiseLevel",
    "Reading",
    "estimate_noise",
    "estimate_regions",
    "lend_estimate",
]

WEIGHTS = Path(__file__).with_name("forests.npy")

KIND_NAMES = KINDS[:-1]
"""The outputs of the classifier: all kinds but ``unknown``."""

LEVEL_OF_KIND = {
    "correlated": "colour",
    "view": "axis",
    "quantised": "steps",
    "uneven": "regions",
    "impulsive": "rms",
    "staircase": "steps",
}
"""Which of the ``LEVELS`` measures the level of a kind; ``"white"`` that of the others."""

CORRECTED = ("white", "isotropic", "correlated", "view", "outliers", "impulsive")
"""Kinds whose measured level a forest corrects; for steps and regions it brings nothing."""

MANY_VERTICES, FEWER = 1_500, 1.6
"""With fewer vertices the odds of noise are multiplied by their share of this number to this power:
small meshes are designs rather than scans."""

MAX_RINGS, MIN_SHARED = 4, 0.95
"""Largest number of rings over which noise is correlated, and the estimate below which it is 0."""

MIN_VERTICES = 64
"""Meshes with fewer vertices get no estimate, because two rings are most of the mesh."""

NAMED = 0.5
"""Smallest probability with which a kind is reported, as a share of the probability of noise."""

PLAIN_SHARED, SURE_SHARED, RELIEF_SHARED = 0.5, 0.72, 0.9
PLAIN_MISFIT, POOR_MISFIT = 0.06, 0.1
"""Smallest probabilities with which correlated noise is reported, because filters for it would
smooth relief: if wide fits leave the same residual everywhere and it explains the levels by scale,
at misfits below the first bound; by default; and for residuals like those of smooth relief, or
misfits above the second bound."""

FEW_VERTICES, MAX_FEW = 512, 0.75
"""With fewer vertices designs look like scans (a cone of 34, a ring of 128, a patch of 432), and
the probability of noise is at most this."""

QUIET, SURE_NOISE, SURE_DESIGN = 0.06, 0.95, 0.9
"""Level, mean edge lengths, below which noise of the ``SHARED_KINDS`` needs the probability
``SURE_NOISE``; ``SURE_DESIGN`` is for terraces and noise that looks like detail of a design."""

QUIET_UNEVEN, SURE_UNEVEN = 0.07, 0.97
"""Level and probability, as above, for noise that differs by region, as detail of a model does."""

MAX_SPREAD, SURE_SPREAD = 16.0, 0.8
"""If the ratio of the 95 % and 5 % quantiles of edge lengths is greater, as in CAD exports and
after decimation, noise of the ``SHARED_KINDS`` needs ``SURE_NOISE``, other noise this."""

MAX_NON_MANIFOLD, SURE_DECIMATED = 0.001, 0.98
"""Share of non-manifold edges above which noise needs this probability, or ``SURE_DESIGN`` if it is
of the ``INDEPENDENT_KINDS``.  Decimation leaves such edges, 0.2 to 5 % on coarse parts of robots;
simulated and real scanners leave none."""

FLAT, MAX_FLAT, FLAT_FACING = 2e-4, 0.008, 0.3
"""Dihedral angle in radians below which an edge is flat up to rounding; the share of such edges
above which noise needs ``SURE_NOISE``; and the cosine to the axis above which noise along it would
bend a face.  Of 62 shapes of ``training.shapes``, white, isotropic and correlated noise of 0.2 e
leaves at most 0.0019 of the edges flat; decimated and shrink-wrapped designs have 0.01 and more,
and so have range scans with rounded depths, which are open."""

ROUNDING = (0.01, 0.1)
"""If all coordinates are rounded to steps between these, in mean edge lengths, the rounding
explains flat edges under noise, which then needs ``SURE_SPREAD``.  Of 10,729 clean foreign files
where flat edges decide, none has such steps."""

MAX_OPEN = 0.01
"""Share of boundary vertices above which a mesh may be a range scan with rounded depths."""

MAX_DOUBTFUL = MIN_PROBABILITY - 0.01
"""Largest probability of noise that is rejected for other reasons; it makes the estimate unsure."""

MAX_WHITE, SURE_SHARED_NOISE = 1.25, 0.9
"""Residual of fits over two rings at the flattest fifth of the vertices, over the level of white
noise, above which the noise is not white: 0.8 to 1.1 for white and isotropic noise on 30 shapes,
1.4 to 5 for noise correlated over two rings and more, 3.2 and more on surfaces of CT volumes.  From
this probability of noise it is then correlated, rather than relief with a trace of white noise."""

FACING, MIN_GAIN, SURE_STEPS = 0.6, 0.05, 0.95
"""Quantised depths need a mesh that faces their axis (mean squared cosine of the normals), or an
axis with at least this gain, or else this probability, because texture may hide the gain."""

MAX_SLIDE = 1.6
"""Largest ratio of the level by tangential displacements along the axis to the level by residuals:
noise along an axis has 1.0 to 1.5, range scans with uneven rows 4."""


SURE_FIELD = 0.995
"""Probability that noise along an axis needs on decimated height fields: up to 0.993 on 23 without
noise (0.995 to 0.999 on 6 more, which are terraced), 0.98 to 0.999 on scattered points with noise.
"""

FIELD_SIDED, FIELD_OUTLINE, FIELD_SPREAD, FIELD_REGULAR = 0.99, 6.0, 3.4, 0.85
"""A mesh is a decimated height field above this share of normals within 90 degrees of their mean,
up to this number of boundary vertices over the square root of all (0.5 to 5 on 95 fields; 8 to 18
on 10 of 12 decimated scans of depth cameras, which have gaps), above this ratio of the 95 % and 5 %
quantiles of edge lengths, and below this share of vertices of valence 6."""

SHARED_KINDS = ("correlated", "view", "uneven")
"""Kinds of noise that may be correlated."""

INDEPENDENT_KINDS = ("white", "isotropic", "outliers", "impulsive", "quantised")
"""Kinds of noise that detail seldom resembles."""

PASSES, MIN_HEIGHT = 20, 0.01
"""Averages over one-rings, which cover about sixty vertices, enough for an error of a tenth; and
mean edge lengths added to heights before the logarithm, so that small ones count less."""

_LENT: weakref.WeakKeyDictionary[Mesh, NoiseLevel] = weakref.WeakKeyDictionary()
"""Estimates of whole meshes by part, set by ``lend_estimate``."""


def estimate_noise(mesh: Mesh) -> NoiseLevel:
    """The noise of a mesh.

    Noise of 0.05 to 0.7 mean edge lengths is estimated with an error of some per cent if it is
    white, and of about 15 % if it is correlated.  Detail as fine as the mesh itself may look like
    noise: ``readings`` have the probabilities of both, and ``is_unsure`` means that neither is
    high.  The result does not depend on the position, orientation and scale of the mesh, nor on the
    number of threads.  The cost hardly depends on the size of the mesh.
    """
    known = _LENT.get(mesh)
    return characterize(mesh).level if known is None else known


def lend_estimate(noise: NoiseLevel, part: Mesh) -> None:
    """Use the ``noise`` of the whole mesh, whose estimate is better, for a ``part`` of it."""
    _LENT[part] = noise


def estimate_regions(mesh: Mesh) -> Floats:
    """Level of the noise around each vertex (n,), file units: that of the nearest region.

    Vertices that no face uses have 0.
    """
    estimate = characterize(mesh)
    levels: Floats | float = estimate.level.file_units
    if estimate.regions is not None:
        middles, regions = estimate.regions
        levels = regions[find_nearest(mesh.vertices, middles)]
    return np.where(mesh.topology.has_ring, levels, 0.0)


@cached_by_mesh
def local_levels(mesh: Mesh) -> Floats:
    """Level of the noise around each vertex (n,), mean edge lengths; cached by mesh.

    Heights are the normal components of the umbrella operator applied twice.  Their geometric mean
    over some rings follows the noise, and is robust against the few large heights at sharp edges.
    The result is scaled to the mean square of ``estimate_regions``.  With noise on halves and ramps
    of five models its error is a third less than that of levels by region.
    """
    rings = mesh.topology.one_ring
    second = apply_umbrella(mesh, apply_umbrella(mesh, mesh.vertices))
    heights = np.abs(np.einsum("ij,ij->i", second, mesh.vertex_normals("uniform", 1)))
    logarithms = np.log(heights / mesh.mean_edge_length + MIN_HEIGHT)
    for _ in range(PASSES):
        logarithms = ring_means(logarithms, *rings)
    levels = np.where(mesh.topology.has_ring, np.maximum(np.exp(logarithms) - MIN_HEIGHT, 0.0), 0.0)
    wanted = estimate_regions(mesh) / mesh.mean_edge_length
    square = float((levels * levels).sum())
    scale = np.sqrt(float((wanted * wanted).sum()) / square) if square > 0.0 else 0.0
    return np.asarray(levels * scale)


@dataclass(frozen=True, eq=False)
class Forest:
    """Binary trees whose leaf values are summed for each output; a leaf is its own child."""

    features: NDArray[np.int16]  # (k,) the feature that each node compares
    thresholds: NDArray[np.float32]  # (k,) float32; values up to it go left
    left: NDArray[np.int32]  # left, right: (k,) children
    right: NDArray[np.int32]
    values: NDArray[np.float32]  # (k,) values of leaves; 0 at other nodes
    roots: NDArray[np.int32]  # roots, outputs: (t,) first node and output of each tree
    outputs: NDArray[np.int16]
    start: Floats  # (o,) bias of each output
    depth: int  # depth of the deepest leaf below its root

    def evaluate(self, numbers: Floats) -> Floats:
        """The outputs (o,) for the features (f,) of one mesh."""
        compared = numbers.astype(np.float32)
        nodes = self.roots
        for _ in range(self.depth):
            goes_left = compared[self.features[nodes]] <= self.thresholds[nodes]
            nodes = np.where(goes_left, self.left[nodes], self.right[nodes])
        added = np.bincount(self.outputs, self.values[nodes], len(self.start))
        return np.asarray(self.start + added)


@dataclass(frozen=True, eq=False)
class Classifier:
    """The trained forests."""

    kinds: Forest  # a score for each kind
    rings: Forest  # the number of rings
    levels: Forest  # the logarithm of the level over the measured one, of the ``CORRECTED`` kinds
    sharpness: float  # factor of the scores that calibrates the probabilities
    # (kinds, 2) 10 % and 90 % quantiles of the true level over the estimated one
    spreads: Floats


@dataclass(frozen=True)
class Verdict:
    """The result of the classifier for one mesh."""

    noise: float  # probability that there is noise, 0 to 1
    kind: str  # the most probable kind, given that there is noise
    probability: float  # of that kind
    measured: float  # its measured level, mean edge lengths, given that there is noise
    # level, low, high: the corrected level and its interval, mean edge lengths
    level: float
    low: float
    high: float
    rings: int  # over how many rings it is correlated, 0 to 4


FOREST_ARRAYS = [field.name for field in dataclasses.fields(Forest) if field.name != "depth"]


@functools.cache
def load_classifier() -> Classifier:
    arrays = np.load(WEIGHTS)
    forests = {
        name: Forest(
            **{part: arrays[f"{name}_{part}"] for part in FOREST_ARRAYS},
            depth=int(arrays[f"{name}_depth"]),
        )
        for name in ("kinds", "rings", "levels")
    }
    return Classifier(**forests, sharpness=float(arrays["sharpness"]), spreads=arrays["spreads"])


def measured_level(numbers: Floats, kind: str, rings: int) -> float:
    """Logarithm of the measured level, mean edge lengths, of noise of a kind."""
    name = "axis_colour" if kind == "view" and rings else LEVEL_OF_KIND.get(kind, "white")
    value = float(numbers[LEVELS.index(name)])
    return value if value > MISSING else float(numbers[LEVELS.index("white")])


def _find_chances(numbers: Floats) -> Floats:
    """The probability of each kind for the features (k,) of a mesh."""
    trained = load_classifier()
    sums = trained.sharpness * trained.kinds.evaluate(numbers)
    sums[0] -= FEWER * min(float(numbers[SIZE]) - math.log(MANY_VERTICES), 0.0)
    chances = np.exp(sums - sums.max())
    return np.asarray(chances / chances.sum())


def classify(numbers: Floats, least: Mapping[str, float], is_grid: bool = False) -> Verdict:
    """Classify the noise by the features (k,) of a mesh.  Kinds below ``least`` are excluded.

    That the mesh is open and faces one way makes noise more probable only if it is a grid
    (``is_grid``), as range maps are, or the noise is along the view and not correlated.
    """
    trained = load_classifier()
    chances = _find_chances(numbers)
    by_kind = {
        name: float(chance)
        for name, chance in zip(KIND_NAMES, chances, strict=True)
        if name != "none" and chance >= least[name]
    }
    kind = max(by_kind, key=lambda name: by_kind[name])
    index = KIND_NAMES.index(kind)
    shared = float(trained.rings.evaluate(numbers)[0])
    rings = min(round(shared), MAX_RINGS) if shared > MIN_SHARED else 0
    noise, probability = 1.0 - float(chances[0]), by_kind[kind]
    is_open = numbers[BOUNDARY_SHARE] > 0.0
    if noise > 0.0 and is_open and not is_grid and (kind != "view" or rings):
        # Range scans are open and face one way, and so are parts of a sculpture, whose relief may
        # look like any noise but that of single vertices along the view.
        closed = numbers.copy()
        closed[list(OF_CLOSED)] = list(OF_CLOSED.values())
        lowered = min(noise, 1.0 - float(_find_chances(closed)[0]))
        noise, probability = lowered, probability * lowered / noise
    measured = level = measured_level(numbers, kind, rings)
    if kind in CORRECTED:
        level = measured_level(numbers, kind, MAX_RINGS)
        level += float(trained.levels.evaluate(numbers)[CORRECTED.index(kind)])
    level = math.exp(level)
    return Verdict(
        noise=noise,
        kind=kind,
        probability=probability,
        measured=math.exp(measured),
        level=level,
        low=level * min(float(trained.spreads[index, 0]), 1.0),
        high=level * max(float(trained.spreads[index, 1]), 1.0),
        rings=rings,
    )


@dataclass(frozen=True, eq=False)
class Estimate:
    """The noise of a mesh, and its level by region."""

    level: NoiseLevel
    # centres (r, 3) of the regions of uneven noise, and their levels (r,), file units
    regions: tuple[Floats, Floats] | None = None


@cached_by_mesh
def characterize(mesh: Mesh) -> Estimate:
    """The kind of the noise and the level that follows from it; cached by mesh."""
    white = estimate_white(mesh)
    n_used = int(np.count_nonzero(mesh.topology.has_ring))
    if n_used < MIN_VERTICES:
        return _without_noise(white, 1.0, "few vertices")
    evidence = gather_evidence(mesh, white)
    verdict = classify(evidence.numbers, _least_probabilities(evidence), evidence.is_grid)
    is_few = n_used < FEW_VERTICES
    if is_few:
        verdict = dataclasses.replace(verdict, noise=min(verdict.noise, MAX_FEW))
    is_named = verdict.probability >= _naming_probability(verdict, evidence)
    verdict, measured = _settle_level(verdict, evidence, white, is_named)
    is_weak = measured < NEGLIGIBLE and verdict.kind != "outliers"
    is_doubtful = is_few or _is_doubtful(mesh, verdict, measured, evidence, is_named)
    if is_doubtful or is_weak:
        probability = min(verdict.noise, MAX_DOUBTFUL) if is_doubtful else verdict.noise
        basis = _describe_fits(evidence)
        return _without_noise(white, 1.0 - probability, basis, measured, is_few)
    if _is_in_pieces(mesh):
        return _without_noise(white, 1.0, "parts of few vertices")
    return _with_noise(mesh, white, evidence, verdict, is_named)


def _settle_level(
    verdict: Verdict, evidence: Evidence, white: WhiteEstimate, is_named: bool
) -> tuple[Verdict, float]:
    """The verdict with the level that counts for its kind, and the measured level, mean edge
    lengths, by which noise is accepted."""
    measured = verdict.measured
    if not is_named and _is_surely_shared(verdict, evidence):
        measured = verdict.level
    elif not is_named:
        # If in doubt, the level by the finest fits, to which relief adds least.
        measured = min(measured, white.level)
        verdict = _with_level(verdict, measured)
    elif verdict.kind == "view" and evidence.axis is not None and not verdict.rings:
        # In range scans uneven rows look like tangential displacements larger than those of noise.
        measured = min(measured, MAX_SLIDE * evidence.axis.level)
        verdict = _with_level(verdict, min(verdict.level, measured))
    elif verdict.kind == "staircase":
        measured = evidence.steps.facing_level
        verdict = _with_level(verdict, measured)
    return verdict, measured


def _is_doubtful(
    mesh: Mesh, verdict: Verdict, measured: float, evidence: Evidence, is_named: bool
) -> bool:
    """Whether noise of the ``measured`` level is not probable enough for such a mesh."""
    needed = _needed_probability(verdict, measured, evidence)
    if mesh.topology.non_manifold_edges > MAX_NON_MANIFOLD * 0.5 * len(mesh.topology.ring):
        needed = max(needed, SURE_DESIGN if verdict.kind in INDEPENDENT_KINDS else SURE_DECIMATED)
    if verdict.kind in ("view", "quantised") and _is_decimated_field(mesh, evidence):
        needed = SURE_FIELD
    if verdict.noise < needed:
        return True
    return verdict.noise < SURE_NOISE and not _is_bent(mesh, verdict, evidence, is_named)


def _with_noise(
    mesh: Mesh, white: WhiteEstimate, evidence: Evidence, verdict: Verdict, is_named: bool
) -> Estimate:
    """The estimate that there is noise, by the verdict."""
    character = _describe(verdict, evidence, white.tail, is_named)
    readings = _order_readings(verdict.level, verdict.noise)
    level, low, high = verdict.level, verdict.low, verdict.high
    if verdict.kind == "impulsive":
        level = min(level, white.level)
    if verdict.kind == "white":
        # The fits measure white noise, so their lower bound, which allows for relief, applies.
        low = min(low, white.low)
    if readings[0].probability < MIN_PROBABILITY:
        low = 0.0
    lowest, highest, n_regions, regions = level, level, len(white.regions), None
    if character.kind == "uneven" and evidence.differences is not None:
        differences = evidence.differences
        scale = level * white.edge / np.sqrt(differences.mean)
        levels = scale * np.sqrt(differences.lows)
        lowest, highest = float(levels.min()) / white.edge, float(levels.max()) / white.edge
        low, high, n_regions = min(low, lowest), max(high, highest), len(levels)
        regions = mesh.vertices[evidence.survey.vertices[differences.middles]], levels
    noise = NoiseLevel(
        mean_edges=level,
        low=low,
        high=high,
        file_units=level * white.edge,
        rms_edges=max(verdict.level, white.rms),
        tail=white.tail,
        is_negligible=False,
        lowest=lowest,
        highest=max(highest, level),
        regions=n_regions,
        character=character,
        readings=readings,
    )
    return Estimate(noise, regions)


def _is_in_pieces(mesh: Mesh) -> bool:
    """Whether most vertices are in components of fewer than ``MIN_VERTICES``."""
    labels = component_labels(len(mesh.vertices), mesh.faces)[mesh.topology.has_ring]
    sizes = np.bincount(labels)
    return bool(sizes[sizes < MIN_VERTICES].sum() > 0.5 * len(labels))


def _with_level(verdict: Verdict, level: float) -> Verdict:
    """The verdict with another level, mean edge lengths, and a proportional interval."""
    scale = level / verdict.level
    return dataclasses.replace(
        verdict, level=level, low=scale * verdict.low, high=scale * verdict.high
    )


def _may_be_white(evidence: Evidence) -> bool:
    """Whether fits over two rings have the residual of the finest fits, as for white noise."""
    flat = evidence.survey.quantile(TWO, FLATTEST)
    finest = math.exp(evidence.numbers[LEVELS.index("white")])
    return math.isnan(flat) or math.sqrt(max(flat, 0.0)) <= MAX_WHITE * finest


def _is_surely_shared(verdict: Verdict, evidence: Evidence) -> bool:
    """Whether there surely is correlated noise, neither white noise nor relief."""
    is_relief = evidence.colour is not None and evidence.colour.is_relief
    is_noise = verdict.noise >= SURE_SHARED_NOISE and verdict.rings > 0
    return is_noise and not is_relief and not _may_be_white(evidence)


def _naming_probability(verdict: Verdict, evidence: Evidence) -> float:
    """Probability from which the kind is reported."""
    if verdict.kind != "correlated":
        return NAMED * verdict.noise
    colour = evidence.colour
    if colour is None:
        return SURE_SHARED
    if colour.is_relief or colour.misfit > POOR_MISFIT:
        return RELIEF_SHARED
    is_plain = colour.is_floor and colour.misfit < PLAIN_MISFIT
    return PLAIN_SHARED if is_plain else SURE_SHARED


def _needed_probability(verdict: Verdict, level: float, evidence: Evidence) -> float:
    """Probability from which noise of that measured ``level`` is accepted.

    It is higher where errors are likely or harmful.  Weak correlated noise is hardly visible, while
    smoothed relief is.  Detail on a part of a design is more frequent than noise on a part of a
    scan.  Correlated noise has a floor, and designs may be blocks on a grid as well.
    """
    if verdict.kind == "view" and evidence.axis is not None:
        level = min(level, evidence.axis.best_level)
    if verdict.kind == "uneven" and level < QUIET_UNEVEN:
        return SURE_UNEVEN
    is_uneven = evidence.edge_spread > MAX_SPREAD
    if verdict.kind in SHARED_KINDS and (level < QUIET or is_uneven):
        return SURE_NOISE
    is_detail = verdict.kind == "uneven" and evidence.loud_correlation > 0.0
    colour = evidence.colour
    is_patchy = verdict.kind == "correlated" and colour is not None and not colour.is_floor
    if is_detail or is_patchy or verdict.kind == "staircase":
        return SURE_DESIGN
    return SURE_SPREAD if is_uneven else 0.5


def _is_decimated_field(mesh: Mesh, evidence: Evidence) -> bool:
    sided, regular = (evidence.numbers[number] for number in (FACING_SHARE, REGULAR_SHARE))
    outline = np.count_nonzero(mesh.topology.boundary)
    is_field = sided > FIELD_SIDED and outline < FIELD_OUTLINE * math.sqrt(len(mesh.vertices))
    return bool(is_field and regular < FIELD_REGULAR and evidence.edge_spread > FIELD_SPREAD)


def has_flat_edges(mesh: Mesh, axis: Floats | None = None) -> bool:
    """Whether many edges are flat up to rounding, as in designs; with an ``axis`` (3,), of those
    faces that noise along it would bend."""
    corners = flaps(mesh.faces, mesh.topology)
    is_flat = dihedral_angles(mesh.vertices, corners) < FLAT
    if axis is not None:
        normals = face_normals(mesh.vertices, np.ascontiguousarray(corners[:, :3]))
        is_flat &= np.abs(normals @ axis) > FLAT_FACING
    return int(np.count_nonzero(is_flat)) > MAX_FLAT * len(corners)


def _is_bent(mesh: Mesh, verdict: Verdict, evidence: Evidence, is_named: bool) -> bool:
    """Whether few edges are flat that such noise would have bent, or rounding explains them."""
    if is_named and verdict.kind == "view" and evidence.axis is not None:
        is_open = mesh.topology.boundary.mean() > MAX_OPEN
        return bool(is_open) or not has_flat_edges(mesh, evidence.axis.axis)
    # Noise of other kinds may leave edges flat.
    may_bend = not is_named or verdict.kind in ("white", "isotropic", "correlated")
    is_bent = not may_bend or not has_flat_edges(mesh)
    return is_bent or (verdict.noise >= SURE_SPREAD and _is_rounded(mesh))


def _is_rounded(mesh: Mesh) -> bool:
    """Whether coordinates are rounded to steps (a single decimal, or single precision far from the
    origin) that leave edges flat by chance although there is noise."""
    gaps = [np.diff(np.unique(column)).min(initial=np.inf) for column in mesh.vertices.T]
    least, most = (bound * mesh.mean_edge_length for bound in ROUNDING)
    return all(least <= gap <= most for gap in gaps)


def _order_readings(level: float, noise: float) -> tuple[Reading, ...]:
    """Both readings, the more probable first: noise of this level, or texture only."""
    readings = Reading(NOISE, level, noise), Reading(TEXTURE, 0.0, 1.0 - noise)
    return readings if noise >= 0.5 else readings[::-1]


def _without_noise(
    white: WhiteEstimate,
    probability: float,
    basis: str,
    rejected: float = 0.0,
    is_few: bool = False,
) -> Estimate:
    """The estimate that there is no noise, or not enough to be seen; ``rejected`` is the level that
    it may have if that is unsure, as it always is for few vertices."""
    is_unsure = is_few or MIN_PROBABILITY > probability > 1.0 - MIN_PROBABILITY
    noise = NoiseLevel(
        mean_edges=0.0,
        low=0.0,
        high=rejected if is_unsure else 0.0,
        file_units=0.0,
        rms_edges=0.0,
        tail=white.tail,
        is_negligible=True,
        lowest=0.0,
        highest=0.0,
        regions=len(white.regions),
        character=NoiseCharacter("none", confidence=probability, basis=basis),
        readings=_order_readings(rejected, 1.0 - probability),
    )
    return Estimate(noise)


def _least_probabilities(evidence: Evidence) -> dict[str, float]:
    """The smallest probability of each kind; infinite if a measurement for it is missing."""
    steps = evidence.steps
    has_depths = steps.axis is not None and steps.along_gain > MIN_GAIN
    if steps.axis is not None and not has_depths:
        # The rows of a range scan are steps along an axis within the surface, not across it.
        has_depths = float(((evidence.survey.normals @ steps.axis) ** 2).mean()) > FACING
    is_known = {
        "white": _may_be_white(evidence),
        "correlated": evidence.colour is None or not evidence.colour.is_pattern,
        "view": evidence.axis is not None,
        "staircase": steps.n_axes == 3,
        "uneven": evidence.differences is not None,
    }
    least = {kind: 0.0 if is_known.get(kind, True) else math.inf for kind in KIND_NAMES}
    least["quantised"] = math.inf if steps.axis is None else 0.0 if has_depths else SURE_STEPS
    return least


def _describe(verdict: Verdict, evidence: Evidence, tail: float, is_named: bool) -> NoiseCharacter:
    """The character of the noise by a verdict, ``unknown`` unless it ``is_named``."""
    kind, far_off = verdict.kind if is_named else "unknown", max(evidence.outliers, tail)
    rings = verdict.rings if kind in SHARED_KINDS else 0
    axis = evidence.steps.axis if kind == "quantised" else None
    if kind == "view" and evidence.axis is not None:
        axis = evidence.axis.axis
    of_steps = "neighbours differ by multiples of one step"
    bases = {
        "view": "vertices slide along the axis, and what fits leave falls with the angle to it",
        "isotropic": "vertices are moved within the surface as much as along the normals",
        "quantised": of_steps,
        "staircase": of_steps,
        "outliers": f"{100.0 * far_off:.2g} % of the vertices lie far off",
        "impulsive": f"{100.0 * tail:.2g} % of the vertices stand out along the normals",
        "uneven": "what fits leave differs by region",
    }
    return NoiseCharacter(
        kind,
        rings=max(rings, 1) if kind == "correlated" else rings,
        direction="isotropic" if kind == "isotropic" else "normals" if axis is None else "axis",
        axis=None if axis is None else tuple(axis.tolist()),
        step=evidence.steps.step if kind in ("quantised", "staircase") else 0.0,
        outliers=far_off if kind == "outliers" else 0.0,
        confidence=verdict.probability,
        basis=bases.get(kind, _describe_fits(evidence)),
    )


def _describe_fits(evidence: Evidence) -> str:
    """The basis in words, such as ``fits leave 0.056 e over two rings, 0.14 e over six``."""
    two, six = (np.sqrt(max(evidence.survey.quantile(fit, 0.2), 0.0)) for fit in (TWO, SIX))
    if not np.isfinite(six):
        return f"fits leave {two:.2g} e over two rings"
    return f"fits leave {two:.2g} e over two rings, {six:.2g} e over six"
