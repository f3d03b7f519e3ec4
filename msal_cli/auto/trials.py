"""Candidates on one part of the mesh: their moves, and estimates of their errors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msal_cli import methods
from msal_cli.arrays import Floats
from msal_cli.auto.noise_model import ISOTROPIC
from msal_cli.auto.risk import DRAWN, SimulatedRisk, SteinRisk
from msal_cli.auto.sample_patch import select_patch
from msal_cli.methods._triangles import even_out

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from msal_cli.auto.candidates import Candidate
    from msal_cli.auto.noise_model import NoiseModel
    from msal_cli.auto.sample_patch import Part
    from msal_cli.mesh import Mesh


RELAX = 2
"""Passes that even out triangles where noise is in all directions: more hardly help, and move
vertices from their places."""

MIN_LEFT, MAX_LEFT = 0.28, 0.62
"""Bounds of the squared error of evened triangles by Stein's lemma, in parts of the noise.  It is
0.44 to 0.6 where noise is in all directions.  Less says that it is only along the normals, and more
that the triangles are uneven by themselves."""

PATCH = 4_000
"""Vertices on which that is judged."""

LEAST_SHARE = 0.01
"""Members of a first result below this weight are left out of it."""


class CandidateRuns:
    """Runs of candidates on a part, each of which is made once.

    Parameters
    ----------
    part : of the mesh.
    noise : on it.
    on_run : called after every run.
    edges : the noise that candidates are given, mean edge lengths of the part; None for its height.
    """

    def __init__(
        self,
        part: Part,
        noise: NoiseModel,
        on_run: Callable[[], object],
        edges: float | None = None,
    ) -> None:
        self.part, self.noise = part, noise
        self._on_run = on_run
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

    def result(self, candidate: Candidate) -> Mesh:
        """The part as a candidate leaves it."""
        return self.part.mesh.with_vertices(self.part.mesh.vertices + self.moves(candidate))

    def by_stein(self, candidates: Sequence[Candidate], first: Floats, probes: int) -> SteinRisk:
        """Candidates rated by Stein's lemma, with normals that the part has at ``first``
        (m, 3)."""
        normals = self.part.mesh.with_vertices(first).vertex_normals("uniform")
        judge = SteinRisk(self.part, self.noise, normals, probes)
        for candidate in candidates:
            judge.add(self._run_once(candidate), self._on_run)
        return judge

    def simulate(
        self, candidates: Sequence[Candidate], first: Floats, added: str = DRAWN
    ) -> SimulatedRisk:
        """Candidates rated on ``first`` (m, 3) with noise on it; see ``SimulatedRisk``."""
        runs = [self._runner(candidate) for candidate in candidates]
        return SimulatedRisk(self.part, first, runs, self.noise, added, self._on_run)

    def compare(self, candidates: Sequence[Candidate], true: Mesh) -> tuple[Floats, Floats, Floats]:
        """Errors of candidates (k,) if ``true`` is the surface of the part: logarithms of the
        squared errors of positions across the surface and of face normals, in parts of those of
        the part; and the root mean square of the former, file units.

        How vertices lie within the surface does not count.
        """
        from msal_cli.kernels.geometry import face_normals

        across, normals = true.vertex_normals("uniform"), face_normals(true.vertices, true.faces)
        rows = []
        for vertices in (self.part.mesh.vertices, *(self.result(k).vertices for k in candidates)):
            heights = np.einsum("ij,ij->i", vertices - true.vertices, across)[self.part.judged]
            cosines = np.einsum("ij,ij->i", face_normals(vertices, true.faces), normals)
            angle = float(np.arccos(np.clip(cosines, -1.0, 1.0)).mean())
            rows.append((float(np.sqrt((heights * heights).mean())), angle))
        lengths, angles = np.maximum(np.array(rows), np.finfo(float).tiny).T
        places, tilts = 2.0 * np.log(lengths / lengths[0]), 2.0 * np.log(angles / angles[0])
        return places[1:], tilts[1:], lengths[1:]

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


def count_relaxing(mesh: Mesh, noise: NoiseModel) -> int:
    """Passes that even out triangles before anything else: where noise is in all directions, and
    takes away what noise adds to the triangles, not what was uneven before."""
    if noise.direction != ISOTROPIC:
        return 0
    part = select_patch(mesh, PATCH)
    judge = SteinRisk(part, noise.on_part(part.numbers), part.mesh.vertex_normals("uniform"), 1)
    judge.add(lambda one: even_out(one, RELAX).vertices - one.vertices, lambda: None)
    left = float(judge.risk().positions.singles()[0])
    return RELAX if MIN_LEFT <= left <= MAX_LEFT else 0
