"""How far results of different methods are from the true surface, by one estimate for all.

The search estimates its candidates on the way to a choice; here filters that are already known are
compared, such as the cells of ``msal sweep``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.arrays import Floats
from msal_cli.auto.candidates import ROBUST, SMOOTHER
from msal_cli.auto.noise_model import build_model
from msal_cli.auto.risk import MIRRORED, SimulatedRisk, SteinRisk
from msal_cli.auto.sample_patch import select_patch
from msal_cli.auto.trials import CandidateRuns

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh
    from msal_cli.methods import Method

    Filter = tuple[Method | None, Mapping[str, Any]]
    """A method and all its parameters; None moves nothing."""

PART = 6_000
"""Vertices that filters are compared on, as in the search."""


def estimate_errors(mesh: Mesh, filters: Sequence[Filter]) -> list[float] | None:
    """The estimated distance of each result from the true surface, root mean square, in mean edge
    lengths of ``mesh``; None where the mesh has no noise to speak of.

    By Stein's lemma where the noise is Gaussian, else by a simulation; see ``risk``.
    """
    noise = estimate_noise(mesh)
    if noise.is_negligible or not mesh.topology.has_ring.any():
        return None
    part = select_patch(mesh, PART)
    model = build_model(mesh, noise).on_part(part.numbers)

    def run_of(one: Filter) -> Any:
        method, values = one
        if method is None:
            return lambda mesh: np.zeros_like(mesh.vertices)
        return lambda mesh: method.denoise(mesh, values).vertices - mesh.vertices

    runs = [run_of(one) for one in filters]
    is_gaussian = model.is_gaussian and not noise.is_impulsive
    trials = CandidateRuns(part, model, lambda: None)
    first: Floats = trials.positions([SMOOTHER if is_gaussian else ROBUST], np.ones(1))
    judge: SteinRisk | SimulatedRisk
    if is_gaussian:
        judge = SteinRisk(part, model, part.mesh.with_vertices(first).vertex_normals("uniform"))
        for run in runs:
            judge.add(run, lambda: None)
    else:
        judge = SimulatedRisk(part, first, runs, model, MIRRORED, lambda: None)
    # Stein's estimate scatters about small errors, and may be below zero.
    shares = np.sqrt(np.maximum(judge.risk().positions.singles(), 0.0))
    unit = model.variance(part.judged) ** 0.5 / mesh.mean_edge_length
    return [float(share) * unit for share in shares]
