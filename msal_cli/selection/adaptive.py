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

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli import methods
from msal_cli.noise_estimate import SURE, NoiseLevel, estimated
from msal_cli.noise_model import NoiseModel
from msal_cli.selection import FAMILY, NONE, Choice
from msal_cli.selection.candidates import Candidate, wiener_al
from msal_cli.selection.patches import representative
from msal_cli.selection.risk import Risk, Stein
from msal_cli.selection.weighing import FLOOR

if TYPE_CHECKING:
    from collections.abc import Callable

    from msal_cli.mesh import Mesh
    from msal_cli.selection import OnStep

Floats = NDArray[np.float64]

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


def chosen(mesh: Mesh, on_step: OnStep | None = None) -> Choice:
    """Parameters for ``mesh`` within the family of equation (2), or none.

    The choice depends on the mesh alone.
    """
    step = on_step or (lambda done, total: None)
    choice = _chosen(mesh, step)
    step(1, 1)
    return choice


def _chosen(mesh: Mesh, on_step: OnStep) -> Choice:
    noise = estimated(mesh)
    n_used = int(np.count_nonzero(mesh.links.has_ring))
    if n_used < FEWEST_VERTICES:
        return _none(noise, f"{n_used:,} vertices are too few to tell noise from shape")
    if noise.is_negligible and noise.high < SURE:
        return _none(noise, f"noise {noise.mean_edges:.2g} e; clean")
    if noise.is_negligible:
        what = f"noise not separable from texture, at most {noise.high:.2g} e"
        return _choice(noise, what, noise.high, wiener_al(noise.high))
    return _by_risk(mesh, noise, on_step)


def _by_risk(mesh: Mesh, noise: NoiseLevel, on_step: OnStep) -> Choice:
    level = noise.rms_edges if noise.is_impulsive else noise.mean_edges
    candidates = _candidates(mesh, level)
    what = f"{'impulsive noise' if noise.is_impulsive else 'noise'} {level:.2g} e"
    if noise.is_impulsive:
        # Stein's lemma holds for Gaussian noise.
        return _choice(noise, what, level, candidates[0])
    part = representative(mesh, PART, SEEDS)
    edges = round(level * mesh.mean_edge_length / part.mesh.mean_edge_length, 4)
    usual, *others = [_run(one, edges) for one in candidates]
    moves = usual(part.mesh)
    first = part.mesh.moved(part.mesh.vertices + moves)
    # What the usual one does to the part itself is known.
    runs = [lambda mesh: moves if mesh is part.mesh else usual(mesh), *others]
    model = NoiseModel(level * mesh.mean_edge_length)
    judge = Stein(part, model, first.vertex_normals("uniform"), PROBES)
    total = len(runs) * (1 + PROBES) + 1
    done = 0

    def count() -> None:
        nonlocal done
        done += 1
        on_step(done, total)

    for run in runs:
        judge.add(run, count)
    risk = judge.risk()
    scores = _scores(risk)
    scores[0] -= MARGIN
    order = np.argsort(scores, kind="stable").tolist()
    if scores[order[0]] >= 0.0:
        return _none(noise, f"{what}; every setting would add more error than it takes away")
    errors = np.sqrt(np.maximum(risk.positions.singles(), 0.0)) * level
    next_best = tuple((candidates[k].label, float(errors[k])) for k in order[1:])
    return _choice(
        noise, what, level, candidates[order[0]], float(errors[order[0]]), len(runs), next_best
    )


def _scores(risk: Risk) -> Floats:
    """Logarithms of the errors of positions and slopes together (k,); 0 is that of the input."""
    places = np.log(np.maximum(risk.positions.singles(), FLOOR))
    tilts = np.log(np.maximum(risk.slopes.singles(), FLOOR))
    scores: Floats = places + tilts
    return scores


def _candidates(mesh: Mesh, level: float) -> list[Candidate]:
    """What is tried, the usual one first; with trust only what has a data term."""
    robust = Candidate("msal", {"schedule": "robust", "K": 0.2, "iterations": 3}, 1.0)
    single = Candidate("al", {"iterations": 1, "mollify": 0}, 0.5)
    found = [wiener_al(level), robust]
    return found if mesh.trust is not None else [*found, single]


def _run(candidate: Candidate, edges: float) -> Callable[[Mesh], Floats]:
    """What the candidate moves a mesh by, for noise of so many mean edge lengths."""
    method = methods.find(candidate.method)
    parameters = method.settled(candidate.settings(edges))

    def run(mesh: Mesh) -> Floats:
        moves: Floats = method.denoised(mesh, parameters).vertices - mesh.vertices
        return moves

    return run


def _none(noise: NoiseLevel, why: str) -> Choice:
    return Choice(NONE, {}, f"{why}; left as it is", None, noise, among=FAMILY)


def _choice(
    noise: NoiseLevel,
    what: str,
    level: float,
    candidate: Candidate,
    risk: float | None = None,
    tried: int = 0,
    others: tuple[tuple[str, float], ...] = (),
) -> Choice:
    parameters = methods.find(candidate.method).settled(candidate.settings(round(level, 4)))
    return Choice(
        candidate.method,
        parameters,
        f"{what}; {candidate.label}",
        None,
        noise,
        risk,
        tried,
        others,
        FAMILY,
    )
