"""The choice of the plain command: parameters within the family of equation (2), for each mesh.

AL and MSAL with their Wiener and robust schedules are fast, and between them they suit each level
of noise.  On the noisy meshes with ground truth in benchmarks/ground_truth.py, AL with the Wiener
schedule is closer to the truth than any single setting of AL or MSAL, in angles and in positions;
where texture is as fine as the mesh, the others are better.  Correlated noise, terraces and spikes
need linear filters, which are candidates too.

So a few candidates run on a part of the mesh, and the one nearest to the result of the learned
filter is chosen.  That filter is nearer to the truth than all of them, but too slow for the whole
mesh.  On textured surfaces with noise that is not white, the mean of its result and that of the
mildest linear filter is the reference.  Weak noise that is of an unknown kind, or correlated over
one ring, looks like fine relief: then only settings with a data term are candidates, since linear
filters would shrink thin parts by more than the noise.

If there is certainly no noise the mesh is not changed.  If the estimate cannot tell noise from
texture, the setting and its share are chosen for the smallest error in the worse case.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np

from msal_cli.analysis.noise_estimate import NOISE, NoiseLevel, estimate_noise, lend_estimate
from msal_cli.arrays import Floats
from msal_cli.auto import NONE, SECONDS, Choice, Wishes, blends
from msal_cli.auto.blends import FLOOR, Case, build_case, hedge
from msal_cli.auto.candidates import LEARNED, LINEAR, ROBUST_LEARNED, Candidate, wiener_al
from msal_cli.auto.risk import RELAX, CandidateRuns
from msal_cli.auto.samples import DRAWN_KINDS, MACHINED, TEXTURED, Part, select_patch, surface_kind
from msal_cli.mesh import Mesh

PART = 4_000
"""Vertices of the part that candidates run on."""

ROBUST_MSAL = Candidate("msal", {"schedule": "robust", "K": 0.2, "iterations": 3}, 1.0)

SINGLE_SWEEP = Candidate("al", {"iterations": 1, "mollify": 0}, 0.5)

MAX_COST, SMALL = 2.5, 100_000
"""Largest cost of linear filters for meshes of any size, and number of vertices up to which all of
them are candidates, because starting the command takes longer."""

WEAK = 0.15
"""Level of noise, mean edge lengths, below which linear filters need a kind of noise that cannot be
relief.  On statues with noise of 0.05 to 0.1 they moved thin parts by 0.1 to 0.3."""

MARGIN = 0.15
"""Under white or isotropic noise the score of AL with the Wiener schedule is reduced by this,
because the learned filter smooths relief, as linear ones do, and so favours them."""

TILTS = 0.8
"""Weight of angles in the score; positions have the rest.  The normals of the learned filter are
nearer to the truth than its positions, which keep correlated noise.  Angles fell by 1.6 % on the
scans of benchmarks/choices.py on which the weight was chosen, and by 1 % on the others."""

MIXED, MIX_SHARES, MIX_MARGIN = 3, (0.25, 0.5, 0.75), 0.04
"""How many of the best candidates are mixed, two at a time, on small meshes; the shares of the
second one; and by how much a mixture has to score less than the best one.  On the held-out scans of
benchmarks/choices.py angles are 2.3 % less than without mixtures, vertex errors 2.0 %.  Neither
mixtures of all candidates nor weights by least squares are better."""

MILD = 3
"""Number of linear filters that are candidates under white noise; wider ones blur.  If triangles
were relaxed there is one more.  Where that one is chosen, under isotropic noise of 0.2, 0.25 and
0.35 on the meshes of benchmarks/ground_truth.py and 25 foreign ones, angles are smaller by 13, 16
and 24 %, and vertex errors greater by 8, 1 and -1 %."""

ALONG_NORMALS = ("white", "uneven", "impulsive", "correlated", "unknown")
"""Kinds of noise under which the tangential displacements (sliding) of linear filters are removed,
unless angles grow by more than ``MAX_RISE``.  On the eleven models of benchmarks/scanner_cases.py
vertex errors under white noise are then smaller by 14 to 27 %, angles by 1 to 2 %; under correlated
noise by 3 %, where triangles are uneven by up to 60 %, with angles greater by 0.4 and 7 %.  Noise
in other directions slides itself.  Candidates are compared with their sliding: without it Taubin's
filter was chosen on a bunny, with an angle of 5.9 degrees, where AL with the Wiener schedule has
5.3."""

MAX_RISE = 0.2
"""Largest rise of the logarithm of the squared error of angles, that of 10 % greater ones.  It is
0.34 and more on the slivers of volumes, whose noise sliding removes."""

STRONG = 0.25
"""Level of noise, mean edge lengths, from which ``--auto`` is much better on any surface."""

BALANCED = Wishes()


def choose_adaptive(mesh: Mesh, wishes: Wishes = BALANCED) -> Choice:
    """Choose parameters for ``mesh`` within the family of equation (2), or no change.

    The choice depends only on the mesh and on ``assume``, ``strength`` and ``keep`` of the
    ``wishes``; of ``keep`` only texture has an effect.
    """
    estimate, edge = estimate_noise(mesh), mesh.mean_edge_length
    noise = estimate.assume(wishes.assume, edge)
    if noise.is_negligible or not noise.mean_edges:
        what = blends.describe_rest(estimate, noise)
        return blends.choose_least(noise, wishes, what, None)
    return _choose_by_risk(mesh, noise.assume(NOISE, edge), noise.is_unsure, wishes)


def _choose_by_risk(mesh: Mesh, noise: NoiseLevel, is_unsure: bool, wishes: Wishes) -> Choice:
    """The setting with the smallest estimated error; if it ``is_unsure`` that there is noise, the
    setting and its share with the smallest error in the worse case."""
    case = build_case(mesh, noise)
    edge, normals = case.mesh.mean_edge_length, None
    if case.model.axis is not None:
        normals = mesh.vertex_normals("uniform", 1)
    height = case.model.height(mesh.topology.has_ring, normals)
    # The level along the normals, of the noisiest regions, in edges of the relaxed mesh.
    loudest = case.levels[-1] * mesh.mean_edge_length if case.levels else 0.0
    level, given, mesh = max(height, loudest) / edge, mesh, case.mesh
    what = blends.describe_noise(noise, is_unsure)

    def run_on(part: Part) -> CandidateRuns:
        if part.mesh is not given:
            lend_estimate(noise, part.mesh)
        model = case.model.on_part(part.numbers)
        return CandidateRuns(part, model, level * edge / part.mesh.mean_edge_length)

    part = select_patch(mesh, PART)
    runs = run_on(part)
    is_drawn = is_unsure or bool(case.levels) or noise.character.kind in DRAWN_KINDS
    true = runs.result(LEARNED if is_drawn else ROBUST_LEARNED)
    surface = surface_kind(true)
    if surface == TEXTURED and not is_drawn:
        halves = [0.5 * runs.moves(candidate) for candidate in (ROBUST_LEARNED, LINEAR[0])]
        true = true.with_vertices(part.mesh.vertices + halves[0] + halves[1])
    candidates = _candidates(case, level, noise, is_unsure, is_drawn)
    shares, weights = np.ones(len(candidates)), np.ones((1, len(candidates)))
    moves = [runs.moves(candidate) for candidate in candidates]
    if case.levels:
        weights = _weigh_by_level(case, runs, candidates, true)
        local = case.local[part.numbers]
        moves = [
            np.interp(local, case.levels, column)[:, None] * move
            for column, move in zip(weights.T, moves, strict=True)
        ]
    places, tilts, errors = runs.compare(moves, true)
    if is_unsure:
        risk = runs.rate(candidates, true, part.judged)
        shares = np.array([hedge([risk], alone) for alone in np.eye(len(candidates))])
        moved = shares**2 * np.diag(risk.positions.gram)
        if_noise = 1.0 - 2.0 * shares * risk.positions.gain + moved
        scores = np.log(np.maximum(np.maximum(if_noise, moved), FLOOR))
    else:
        scores = _score(places, tilts)
        if is_drawn:
            scores[0] -= MARGIN
    order = np.argsort(scores, kind="stable").tolist()
    if scores[order[0]] >= 0.0:
        what += "; every setting would add more error than it takes away"
        return blends.choose_least(noise, wishes, what, None)
    errors, best = errors / edge, order[0]
    numbers, mixture, error = [best], np.ones(1), float(errors[best])
    if not is_unsure and mesh.trust is None and len(mesh.vertices) <= SMALL:
        score, pair, pair_weights, length = _find_mixture(runs, moves, true, order[:MIXED])
        if score < scores[best] - MIX_MARGIN:
            numbers, mixture, error = pair, pair_weights, length / edge
    members = [_undo_sliding(candidates[k], noise, runs, true) for k in numbers]
    rows = weights[:, numbers] * mixture
    if wishes.strength > 0.0:
        stronger = [*blends.stronger_candidates(round(level, 4))[1:], *_linear(mesh)]
        runs = run_on(select_patch(mesh, blends.STRENGTH_PART))
        members, rows = blends.mix_in_stronger(runs, members, rows, stronger, wishes.strength, case)
    share = round(float(shares[best]) * wishes.share, 3)
    used, parameters, label = blends.build_recipe(members, rows, round(level, 4), share, case)
    return Choice(
        used,
        parameters,
        f"{what}; {label}",
        surface,
        noise,
        # That of the whole displacement, by these members alone.
        risk=error if share == 1.0 and wishes.strength <= 0.0 else None,
        tried=len(candidates),
        runners_up=tuple(
            (candidates[k].label, float(errors[k])) for k in order[1:4] if scores[k] < 0.0
        ),
    )


def _score(places: Floats, tilts: Floats) -> Floats:
    """Scores (k,) of results from their errors as ``CandidateRuns.compare`` gives them, less is
    better.  A result farther from the reference than the input, in either measure, is harmful."""
    scores = 2.0 * ((1.0 - TILTS) * places + TILTS * tilts)
    scores[np.maximum(places, tilts) > 0.0] = np.inf
    return scores


def _find_mixture(
    runs: CandidateRuns, moves: Sequence[Floats], true: Mesh, numbers: Sequence[int]
) -> tuple[float, list[int], Floats, float]:
    """The best mixture of two of the candidates ``numbers``: its score, their numbers and weights
    (2,), and its error in file units."""
    mixtures = [
        ([first, second], np.array([1.0 - share, share]))
        for first, second in itertools.combinations(numbers, 2)
        for share in MIX_SHARES
    ]
    mixed = [np.tensordot(weights, [moves[k] for k in pair], 1) for pair, weights in mixtures]
    places, tilts, errors = runs.compare(mixed, true)
    scores = _score(places, tilts)
    best = int(np.argmin(scores))
    return float(scores[best]), *mixtures[best], float(errors[best])


def _undo_sliding(
    chosen: Candidate, noise: NoiseLevel, runs: CandidateRuns, true: Mesh
) -> Candidate:
    """The candidate, for a linear filter without its sliding if that is no part of the noise and
    angles hardly grow."""
    if chosen not in LINEAR or noise.character.kind not in ALONG_NORMALS:
        return chosen
    undone = dataclasses.replace(chosen, given={**chosen.given, "sliding": "undone"})
    _, tilts, _ = runs.compare([runs.moves(chosen), runs.moves(undone)], true)
    return undone if tilts[1] < tilts[0] + MAX_RISE else chosen


def seconds_of_better(choice: Choice, n_vertices: int) -> float | None:
    """Seconds on one core of ``--auto`` if it comes much nearer to the truth than a choice within
    the family for a mesh that surely has noise, by half and more: on machined parts and under
    strong noise.  None in other cases."""
    if choice.method == NONE:
        return None
    if choice.surface != MACHINED and choice.noise.mean_edges < STRONG:
        return None
    any_s, s_per_million = SECONDS
    return any_s + s_per_million * n_vertices / 1e6


def _weigh_by_level(
    case: Case, runs: CandidateRuns, candidates: list[Candidate], true: Mesh
) -> Floats:
    """Weights (levels, k): the best share of each setting at each level of local noise if ``true``
    is the surface, and 1 at the highest level."""
    rows = np.ones((len(case.levels), len(candidates)))
    masks = blends.level_masks(runs.part, case.local, case.levels)
    for row, judged in zip(rows[:-1], masks[:-1], strict=True):
        if judged.sum() >= blends.MIN_JUDGED:
            positions = runs.rate(candidates, true, judged).positions
            moved = np.maximum(np.diag(positions.gram), FLOOR)
            row[:] = np.clip(positions.gain / moved, 0.0, 1.0).round(2)
    return rows


def _candidates(
    case: Case, level: float, noise: NoiseLevel, is_unsure: bool, is_drawn: bool
) -> list[Candidate]:
    """The candidates for noise of ``level`` mean edge lengths, the default one first.  With trust,
    and where weak noise may be relief, only those with a data term."""
    mesh = case.mesh
    found = [wiener_al(level, case.model.rings), ROBUST_MSAL]
    is_like_relief = noise.character.kind == "unknown" or noise.character.rings == 1
    if mesh.trust is not None or (not is_drawn and is_like_relief and level < WEAK):
        return found
    found.append(SINGLE_SWEEP)
    if is_unsure or (is_drawn and level < WEAK):
        return found
    mild = MILD + 1 if case.relax == RELAX else MILD
    return found + _linear(mesh, mild if is_drawn else None)


def _linear(mesh: Mesh, number: int | None = None) -> list[Candidate]:
    """The first ``number`` of the linear filters, without those that are too slow for ``mesh``."""
    is_small = len(mesh.vertices) <= SMALL
    return [candidate for candidate in LINEAR[:number] if is_small or candidate.cost <= MAX_COST]
