"""Candidates on one part of the mesh: their moves, and estimates of their errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli import methods
from msal_cli.arrays import Floats
from msal_cli.auto.risk import SimulatedRisk, SteinRisk

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from msal_cli.auto.candidates import Candidate
    from msal_cli.auto.noise_model import NoiseModel
    from msal_cli.auto.sample_patch import Part
    from msal_cli.mesh import Mesh


LEAST_SHARE = 0.01
"""Members of a first result below this weight are left out of it."""


class CandidateRuns:
    """Runs of candidates on a part, each of which is made once.

    Parameters
    ----------
    part : of the mesh.
    noise : on it.
    added : what simulations put on a first result, see ``SimulatedRisk``.
    on_run : called after every run.
    edges : the noise that candidates are given, mean edge lengths of the part; None for its height.
    """

    def __init__(
        self,
        part: Part,
        noise: NoiseModel,
        added: str,
        on_run: Callable[[], object],
        edges: float | None = None,
    ) -> None:
        self.part, self.noise = part, noise
        self._added, self._on_run = added, on_run
        if edges is None:
            edges = noise.height(part.judged) / part.mesh.mean_edge_length
        self._edges = float(round(edges, 4))
        self._known: dict[str, Floats] = {}

    def moves(self, candidate: Candidate) -> Floats:
        """What a candidate moves the vertices of the part by, (m, 3)."""
        if candidate.label not in self._known:
            self._known[candidate.label] = self._runner(candidate)(self.part.mesh)
        return self._known[candidate.label]

    def positions(self, candidates: Sequence[Candidate], weights: Floats) -> Floats:
        """Vertices (m, 3) of the part as a blend of candidates by weights (k,) leaves them."""
        positions = self.part.mesh.vertices.copy()
        for weight, candidate in zip(weights, candidates, strict=True):
            if weight >= LEAST_SHARE:
                positions += weight * self.moves(candidate)
        return positions

    def by_stein(self, candidates: Sequence[Candidate], first: Floats, probes: int) -> SteinRisk:
        """Candidates rated by Stein's lemma, with normals that the part has at ``first``
        (m, 3)."""
        normals = self.part.mesh.with_vertices(first).vertex_normals("uniform")
        judge = SteinRisk(self.part, self.noise, normals, probes)
        for candidate in candidates:
            judge.add(self._run_once(candidate), self._on_run)
        return judge

    def simulate(self, candidates: Sequence[Candidate], first: Floats) -> SimulatedRisk:
        """Candidates rated on ``first`` (m, 3) with noise added to it."""
        runs = [self._runner(candidate) for candidate in candidates]
        return SimulatedRisk(self.part, first, runs, self.noise, self._added, self._on_run)

    def _run_once(self, candidate: Candidate) -> Callable[[Mesh], Floats]:
        """The same as ``_runner``, with the known result for the part itself."""
        run = self._runner(candidate)
        return lambda mesh: self.moves(candidate) if mesh is self.part.mesh else run(mesh)

    def _runner(self, candidate: Candidate) -> Callable[[Mesh], Floats]:
        """What the candidate moves a mesh like the part by."""
        method = methods.find(candidate.method)
        values = method.validate(candidate.settings(self._edges))

        def run(mesh: Mesh) -> Floats:
            moves: Floats = method.denoise(mesh, values).vertices - mesh.vertices
            return moves

        return run
