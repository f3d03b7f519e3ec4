"""The plain command's choice: parameters within the family of equation (2), for each mesh.

AL and MSAL with their Wiener and robust schedules are fast, and between them they suit every level
of noise.  On the noisy meshes of known truth in benchmarks/ground_truth.py AL with the Wiener
schedule is closer to the truth than any single setting of AL or MSAL, in angles and in positions;
where texture is as fine as the mesh, the others do better.  So a few candidates run on a part of
the mesh, Stein's lemma gives the error of each, and the least is taken.

Noise that neighbours share, terraces and spikes are out of their reach.  Linear filters join in
there, and the error is the distance from what the learned filter makes of the part: that takes too
long for the whole mesh, but is nearer to the truth than all of them.  Where that is rough all over,
the mildest linear filter counts as much.  Weak noise of an unknown kind, or shared by direct
neighbours, looks like fine relief: there only settings that pull to the scan are tried, since
linear filters would shrink thin parts by more than the noise.

Where there is certainly no noise the mesh stays as it is.  Where the estimate cannot tell noise
from texture, the setting and the share of it are taken whose error is least in the worse case.
"""

import dataclasses

import numpy as np

from msal_cli import methods
from msal_cli.analysis.noise_estimate import NOISE, NoiseLevel, estimate_noise
from msal_cli.arrays import Floats
from msal_cli.auto import FAMILY, NONE, SECONDS, Choice, OnStep, Wishes, blends
from msal_cli.auto.blends import FLOOR, Case, build_case, hedge
from msal_cli.auto.candidates import FLATTENER, LINEAR, ROBUST_LEARNED, Candidate, wiener_al
from msal_cli.auto.noise_model import NoiseModel, is_like_draws
from msal_cli.auto.risk import CandidateRuns, SteinRisk
from msal_cli.auto.sample_patch import MACHINED, TEXTURED, Part, select_patch, surface_kind
from msal_cli.mesh import Mesh

PART = 4_000
"""Vertices that candidates run on."""

PROBES = 1
"""One probe of the divergence is enough: the candidates are few, and far apart."""


ROBUST_MSAL = Candidate("msal", {"schedule": "robust", "K": 0.2, "iterations": 3}, 1.0)

SINGLE_SWEEP = Candidate("al", {"iterations": 1, "mollify": 0}, 0.5)

MAX_COST, SMALL = 2.5, 100_000
"""Cost up to which a linear filter is for meshes of any size, and vertices up to which all are: a
run of the command takes longer to start than they take."""

WEAK = 0.15
"""Mean edge lengths of noise below which linear filters need a kind of noise that relief is not.
On statues with 0.05 to 0.1 of noise they moved thin parts by 0.1 to 0.3."""

MARGIN = 0.15
"""By how much less the logarithms of both errors of another candidate have to be than those of the
usual one where noise is drawn: one probe scatters by 0.1."""


TILTS = 0.8
"""How much of the score are angles where the learned filter stands for the truth: its normals are
nearer to that than its positions, which keep what neighbours share.  On the scans of
benchmarks/choices.py angles fell by 1.6 % for those it was chosen on, by 1 % for the others."""

MILD = 3
"""How many of the linear filters are tried on white noise: wider ones blur."""

STRONG = 0.25
"""Mean edge lengths of noise from which ``--auto`` comes much nearer to the truth on any
surface."""


BALANCED = Wishes()
"""No wish."""


def choose_adaptive(mesh: Mesh, on_step: OnStep | None = None, wishes: Wishes = BALANCED) -> Choice:
    """Parameters for ``mesh`` within the family of equation (2), or none.

    The choice depends on the mesh and the ``wishes`` alone; of these ``assume``, ``strength`` and
    ``keep`` texture count.
    """
    step = on_step or (lambda done, total: None)
    estimate, edge = estimate_noise(mesh), mesh.mean_edge_length
    noise = estimate.assume(wishes.assume, edge)
    if noise.is_negligible or not noise.mean_edges:
        what = blends.describe_rest(estimate, noise)
        choice = blends.choose_least(noise, wishes, what, None)
    else:
        assumed = noise.assume(NOISE, edge)
        choice = _choose_by_risk(mesh, assumed, step, noise.is_unsure, wishes)
    step(1, 1)
    return dataclasses.replace(choice, estimate=estimate, among=FAMILY)


def _choose_by_risk(
    mesh: Mesh, noise: NoiseLevel, on_step: OnStep, is_unsure: bool, wishes: Wishes
) -> Choice:
    """The setting with the least estimated error, or the share of one that has it in the worse case
    where it ``is_unsure`` that there is noise."""
    case = build_case(mesh, noise)
    edge, normals = case.mesh.mean_edge_length, None
    if case.model.axis is not None:
        normals = mesh.vertex_normals("uniform", 1)
    height = case.model.height(mesh.topology.has_ring, normals)
    # Along the normals, at the loudest places, in edges of the mesh that the method gets.
    loudest = case.levels[-1] * mesh.mean_edge_length if case.levels else 0.0
    evened = case.mesh.vertices - mesh.vertices
    level, mesh = max(height, loudest) / edge, case.mesh
    what = blends.describe_noise(noise, is_unsure)
    part = select_patch(mesh, PART)
    method = methods.find(FLATTENER.method)
    flat = method.denoise(part.mesh, method.validate(FLATTENER.given))
    surface = surface_kind(part.mesh.with_vertices(flat.vertices))
    model = case.model.on_part(part.numbers)
    done = total = 0

    def count() -> None:
        nonlocal done
        done += 1
        on_step(done, total)

    runs = CandidateRuns(part, model, count, level * edge / part.mesh.mean_edge_length)
    is_drawn = is_unsure or bool(case.levels) or is_like_draws(noise)
    is_rough = not is_drawn and surface_kind(runs.result(ROBUST_LEARNED)) == TEXTURED
    candidates = _candidates(case, level, noise, is_unsure, is_drawn)
    total = len(candidates) * (2 if is_drawn else 1) + 1
    shares, weights = np.ones(len(candidates)), np.ones((1, len(candidates)))
    if is_drawn:
        judge = runs.by_stein(candidates, runs.result(candidates[0]).vertices, PROBES)
        risk = judge.risk()
        places, tilts = risk.log_errors(FLOOR)
        errors = np.sqrt(np.maximum(risk.positions.singles(), 0.0)) * model.height(part.judged)
        if case.levels:
            places, tilts, weights = _rate_by_level(case, part, judge, model)
        # 0 is the error of the input.
        scores = places + tilts
        if is_unsure:
            measures = (risk.positions, risk.slopes)
            shares = np.min(
                [
                    [hedge(*pair) for pair in zip(some.gain, np.diag(some.gram), strict=True)]
                    for some in measures
                ],
                axis=0,
            )
            moved = shares**2 * np.diag(risk.positions.gram)
            if_noise = 1.0 - 2.0 * shares * risk.positions.gain + moved
            scores = np.log(np.maximum(np.maximum(if_noise, moved), FLOOR))
        scores[0] -= MARGIN
    else:
        pilots = [ROBUST_LEARNED, LINEAR[0]] if is_rough else [ROBUST_LEARNED]
        true = runs.positions(pilots, np.full(len(pilots), 1.0 / len(pilots)))
        places, tilts, errors = runs.compare(candidates, part.mesh.with_vertices(true))
        # What is farther from the truth than the input, in either measure, would be harm.
        both = 2.0 * ((1.0 - TILTS) * places + TILTS * tilts)
        scores = np.where(np.maximum(places, tilts) > 0.0, np.inf, both)
    order = np.argsort(scores, kind="stable").tolist()
    if scores[order[0]] >= 0.0:
        what += "; every setting would add more error than it takes away"
        return blends.choose_least(noise, wishes, what, None)
    errors = errors / edge
    next_best = tuple((candidates[k].label, float(errors[k])) for k in order[1:])
    best = order[0]
    members, rows = [candidates[best]], weights[:, [best]]
    if wishes.strength > 0.0:
        stronger = [*blends.stronger_candidates(round(level, 4))[1:], *_linear(mesh)]
        members, rows = blends.mix_in_stronger(
            runs, members, rows, stronger, wishes.strength, case, evened
        )
    share = round(float(shares[best]) * wishes.share, 3)
    used, parameters, label = blends.build_recipe(
        members, rows, round(level, 4), case.levels, case.relax, share
    )
    return Choice(
        used,
        parameters,
        f"{what}; {label}",
        surface,
        noise,
        risk=float(errors[best]),
        tried=len(candidates),
        runners_up=next_best,
    )


def seconds_of_better(choice: Choice, n_vertices: int) -> float | None:
    """Seconds of one core that ``--auto`` takes where it comes much nearer to the truth than a
    choice within the family: by a half and more on machined parts and under strong noise.  None
    elsewhere."""
    if choice.method == NONE or (choice.estimate is not None and choice.estimate.is_unsure):
        return None
    if choice.surface != MACHINED and choice.noise.mean_edges < STRONG:
        return None
    any_s, s_per_million = SECONDS
    return any_s + s_per_million * n_vertices / 1e6


def _rate_by_level(
    case: Case, part: Part, judge: SteinRisk, model: NoiseModel
) -> tuple[Floats, Floats, Floats]:
    """Logarithms of the squared errors of positions and slopes of every setting (k,), with as much
    of it as is best at each level of local noise, and all of it where there is most; and these
    weights (levels, k)."""
    squares, rows, total = [], [], 0.0
    for level, judged in enumerate(blends.level_masks(part, case.local, case.levels), start=1):
        risk = judge.risk(judged)
        moved = np.maximum(np.diag(risk.positions.gram), FLOOR)
        row = np.clip(risk.positions.gain / moved, 0.0, 1.0).round(2)
        if level == len(case.levels) or judged.sum() < blends.MIN_JUDGED:
            row = np.ones_like(row)
        energy = float(judged.sum()) * model.variance(judged)
        total += energy
        rows.append(row)
        squares.append(
            [
                energy * (1.0 - 2.0 * row * part_risk.gain + row**2 * np.diag(part_risk.gram))
                for part_risk in (risk.positions, risk.slopes)
            ]
        )
    places, tilts = np.log(np.maximum(np.sum(squares, axis=0) / total, FLOOR))
    return places, tilts, np.array(rows)


def _candidates(
    case: Case, level: float, noise: NoiseLevel, is_unsure: bool, is_drawn: bool
) -> list[Candidate]:
    """What is tried for noise of ``level`` mean edge lengths, the usual one first; with trust, and
    where weak noise may be relief, only what has a data term."""
    mesh = case.mesh
    found = [wiener_al(level, case.model.rings), ROBUST_MSAL]
    is_like_relief = noise.character.kind == "unknown" or noise.character.rings == 1
    if mesh.trust is not None or (not is_drawn and is_like_relief and level < WEAK):
        return found
    found.append(SINGLE_SWEEP)
    if is_unsure or (is_drawn and level < WEAK):
        return found
    return found + _linear(mesh, MILD if is_drawn else None)


def _linear(mesh: Mesh, number: int | None = None) -> list[Candidate]:
    """The first ``number`` of the linear filters, without those that take too long for ``mesh``."""
    is_small = len(mesh.vertices) <= SMALL
    return [candidate for candidate in LINEAR[:number] if is_small or candidate.cost <= MAX_COST]
