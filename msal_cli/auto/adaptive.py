"""The plain command's choice: parameters within the family of equation (2), for each mesh.

AL and MSAL with their Wiener and robust schedules are fast, and between them they suit every level
of noise.  On the noisy meshes of known truth in benchmarks/ground_truth.py AL with the Wiener
schedule is closer to the truth than any single setting of AL or MSAL, in angles and in positions;
where texture is as fine as the mesh, the others do better.  So a few candidates run on a part of
the mesh, Stein's lemma gives the error of each, and the least is taken.

Where there is certainly no noise the mesh stays as it is.  Where the estimate cannot tell noise
from texture, the mildest setting takes away no more than the upper end of the noise's interval.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from msal_cli.analysis.noise_estimate import SURE, NoiseLevel, estimate_noise
from msal_cli.analysis.noise_estimate.local import local_levels
from msal_cli.arrays import Floats
from msal_cli.auto.blend_weights import FLOOR
from msal_cli.auto.candidates import Candidate, wiener_al
from msal_cli.auto.choices import build_recipe, describe_noise
from msal_cli.auto.levels import FEWEST_JUDGED, RELAX, level_masks, may_follow, spread_levels
from msal_cli.auto.noise_model import ISOTROPIC, NoiseModel, build_model
from msal_cli.auto.risk import DRAWN, SteinRisk
from msal_cli.auto.sample_patch import Part, select_patch
from msal_cli.auto.trials import CandidateRuns
from msal_cli.auto.wishes import FAMILY, NONE, Choice, allow_all
from msal_cli.methods._triangles import even_out

if TYPE_CHECKING:
    from msal_cli.auto.wishes import Allowed, OnStep
    from msal_cli.mesh import Mesh


FEWEST_VERTICES = 256
"""Vertices below which the noise estimate takes the shape of coarse models for noise: a cone of 34,
a torus of 96, a ring of 128.  Scans have more."""

PART, SEEDS = 4_000, 16_384
"""Vertices that candidates run on, and places where patches of a large mesh may begin."""

PROBES = 1
"""One probe of the divergence is enough: the candidates are few, and far apart."""


MARGIN = 0.1
"""By how much less the logarithms of both errors of another candidate have to be than those of the
usual one: as much as one probe scatters."""


def choose_adaptive(
    mesh: Mesh, on_step: OnStep | None = None, is_allowed: Allowed = allow_all
) -> Choice:
    """Parameters for ``mesh`` within the family of equation (2), or none.

    The choice depends on the mesh alone, and on what ``is_allowed``: the family always is, and
    weights by local noise may not be.
    """
    step = on_step or (lambda done, total: None)
    choice = _choose(mesh, step, is_allowed)
    step(1, 1)
    return choice


def _choose(mesh: Mesh, on_step: OnStep, is_allowed: Allowed) -> Choice:
    noise = estimate_noise(mesh)
    n_used = int(np.count_nonzero(mesh.topology.has_ring))
    if n_used < FEWEST_VERTICES:
        return _keep_input(noise, f"{n_used:,} vertices are too few to tell noise from shape")
    if noise.is_negligible and noise.high < SURE:
        return _keep_input(noise, f"noise {noise.mean_edges:.2g} e; clean")
    if noise.is_negligible:
        what = f"noise not separable from texture, at most {noise.high:.2g} e"
        candidate = wiener_al(noise.high)
        made = build_recipe([candidate], np.ones((1, 1)), round(noise.high, 4))
        reason = f"{what}; {made.label}"
        return Choice(made.method, made.parameters, reason, None, noise, among=FAMILY)
    return _choose_by_risk(_build_case(mesh, noise, is_allowed), noise, on_step)


@dataclass(frozen=True, eq=False)
class _Case:
    """A mesh as the method gets it, and the noise on it as the family knows it.

    Attributes
    ----------
    mesh : with its triangles evened out by ``relax`` passes, for noise in all directions.
    model : the noise; that along the normals counts.
    edges : its level along the normals, mean edge lengths of ``mesh``; of the loudest places.
    local, levels : local noise (n,), and levels of it that get weights of their own; empty where
        the noise is the same everywhere.
    """

    mesh: Mesh
    model: NoiseModel
    edges: float
    local: Floats
    levels: tuple[float, ...]
    relax: int


def _build_case(mesh: Mesh, noise: NoiseLevel, is_allowed: Allowed) -> _Case:
    model = build_model(mesh, noise)
    relax, local = 0, np.empty(0)
    levels: tuple[float, ...] = ()
    # Trust scales the pull of one method, not a blend.
    if mesh.trust is None:
        relax = RELAX if model.direction == ISOTROPIC else 0
        if model.shares is not None and may_follow(is_allowed):
            local = local_levels(mesh)
            levels = spread_levels(local[mesh.topology.has_ring])
    model = model.along_normals() if model.direction == ISOTROPIC else model
    loudest = levels[-1] * mesh.mean_edge_length if levels else 0.0
    base = even_out(mesh, relax)
    height = model.height(mesh.topology.has_ring, mesh.vertex_normals("uniform", 1))
    edges = max(height, loudest) / base.mean_edge_length
    return _Case(base, model, edges, local, levels, relax)


def _choose_by_risk(case: _Case, noise: NoiseLevel, on_step: OnStep) -> Choice:
    mesh = case.mesh
    candidates = _candidates(mesh, case.edges, case.model.rings)
    what = describe_noise(noise)
    if noise.is_impulsive or not case.model.is_gaussian:
        # Stein's lemma holds for Gaussian noise.
        return _build_choice(case, noise, candidates[0], np.ones(1))
    part = select_patch(mesh, PART, SEEDS)
    total = len(candidates) * (1 + PROBES) + 1
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        on_step(done, total)

    model = case.model.on_part(part.numbers)
    edges = case.edges * mesh.mean_edge_length / part.mesh.mean_edge_length
    runs = CandidateRuns(part, model, DRAWN, count, edges)
    first = runs.positions(candidates[:1], np.ones(1))
    judge = runs.by_stein(candidates, first, PROBES)
    risk = judge.risk()
    places, tilts = risk.log_errors(FLOOR)
    # 0 is the error of the input.
    scores = places + tilts
    scores[0] -= MARGIN
    order = np.argsort(scores, kind="stable").tolist()
    if scores[order[0]] >= 0.0:
        return _keep_input(noise, f"{what}; every setting would add more error than it takes away")
    unit = model.height(part.judged) / mesh.mean_edge_length
    errors = np.sqrt(np.maximum(risk.positions.singles(), 0.0)) * unit
    next_best = tuple((candidates[k].label, float(errors[k])) for k in order[1:])
    weights = _weights(case, part, judge, order[0])
    choice = _build_choice(case, noise, candidates[order[0]], weights)
    return dataclasses.replace(
        choice, risk=float(errors[order[0]]), tried=len(candidates), runners_up=next_best
    )


def _weights(case: _Case, part: Part, judge: SteinRisk, at: int) -> Floats:
    """How much of a setting is best at each level of local noise, by Stein's lemma."""
    weights = []
    for judged in level_masks(part, case.local, case.levels) if case.levels else ():
        if judged.sum() < FEWEST_JUDGED:
            weights.append(1.0)
            continue
        some = judge.risk(judged).of([at]).positions
        best = float(some.gain[0] / max(some.gram[0, 0], FLOOR))
        weights.append(round(min(max(best, 0.0), 1.0), 2))
    return np.array(weights) if any(weights) else np.ones(1)


def _candidates(mesh: Mesh, level: float, rings: int) -> list[Candidate]:
    """What is tried, the usual one first; with trust only what has a data term."""
    robust = Candidate("msal", {"schedule": "robust", "K": 0.2, "iterations": 3}, 1.0)
    single = Candidate("al", {"iterations": 1, "mollify": 0}, 0.5)
    found = [wiener_al(level, rings), robust]
    return found if mesh.trust is not None else [*found, single]


def _keep_input(noise: NoiseLevel, why: str) -> Choice:
    return Choice(NONE, {}, f"{why}; left as it is", None, noise, among=FAMILY)


def _build_choice(case: _Case, noise: NoiseLevel, candidate: Candidate, weights: Floats) -> Choice:
    levels = case.levels if len(weights) > 1 else ()
    made = build_recipe([candidate], weights[:, None], round(case.edges, 4), levels, case.relax)
    reason = f"{describe_noise(noise)}; {made.label}"
    return Choice(made.method, made.parameters, reason, None, noise, among=FAMILY)
