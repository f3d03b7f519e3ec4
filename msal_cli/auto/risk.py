"""The estimated error of any blend of filters, without ground truth.

A blend with weights w moves the vertices by d = sum w_k d_k, where d_k are the displacements of
filter k.  Its squared error over the vertices is a quadratic in w,

    |d - (t - y)|^2 = w'Mw - 2 w'b + c,   M_kl = <d_k, d_l>,  b_k = <d_k, t - y>,  c = |t - y|^2

for noisy positions y = t + noise.  M is known; the truth t, and so b and c, are not.  So the result
of a first filter, the pilot, takes the place of the truth.  ``CandidateRuns.rate`` and ``compare``
use the given mesh as y, but filters find that noise simpler than the true one.  ``SimulatedRisk``
instead adds a sample of the noise to the pilot, and runs each filter on that.  Noise of unknown
kind cannot be sampled: what the pilot removed is added with the opposite sign, which has the same
correlation, direction and level everywhere.

Errors are measured in positions and in slopes, which are differences along edges over the edge
length; the angles between face normals depend on the slopes.  For isotropic noise the whole
difference counts, not only its normal part, so that the slopes also measure how jagged triangles
are.  Only ``judged`` vertices count.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from msal_cli import methods
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.arrays import Flags, Floats
from msal_cli.auto.candidates import LEARNED, ROBUST_LEARNED, Candidate, wiener_al
from msal_cli.auto.samples import ISOTROPIC, NoiseModel, Part, build_model, select_patch
from msal_cli.kernels.geometry import face_normals
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import Method
from msal_cli.methods._sliding import even_out

Run = Callable[[Mesh], Floats]
"""A function that returns the displacements (m, 3) of a filter on a mesh."""

SEED = 3
"""Seed of the simulated noise."""

DRAWN, MIRRORED = "drawn", "mirrored"
"""What a simulation adds to the pilot, see ``SimulatedRisk``."""

MIN_EDGE = 0.3
"""Mean edge lengths; shorter edges count as this long, because single slivers would dominate."""

MIN_SHARE, MIN_NOISE = 1e-9, 1e-6
"""Errors are divided by at least this share of the largest squared displacement, and by at least
this level of noise, mean edge lengths."""


@dataclass(frozen=True, eq=False)
class Quadratic:
    """Squared error of a blend over that of the input: 1 - 2 w'b + w'Mw."""

    gram: Floats  # (k, k), M over c
    gain: Floats  # (k,), b over c

    def at(self, weights: Floats) -> float:
        """The value for weights (k,); errors of the estimate may make it negative."""
        # No BLAS product, see ``_known``.
        gained = np.einsum("i,i->", weights, self.gain)
        return float(1.0 - 2.0 * gained + np.einsum("i,ij,j->", weights, self.gram, weights))

    def singles(self) -> Floats:
        """The value of each single filter (k,)."""
        value: Floats = 1.0 - 2.0 * self.gain + np.diag(self.gram)
        return value

    def of(self, members: Sequence[int]) -> Quadratic:
        """The same for some of the filters."""
        rows = np.array(members, dtype=np.int64)
        return Quadratic(self.gram[np.ix_(rows, rows)], self.gain[rows])


@dataclass(frozen=True, eq=False)
class Risk:
    """Errors of blends of the same filters, in positions and in slopes."""

    positions: Quadratic
    slopes: Quadratic

    def of(self, members: Sequence[int]) -> Risk:
        """The same for some of the filters."""
        return Risk(self.positions.of(members), self.slopes.of(members))


def _slopes(
    mesh: Mesh, normals: Floats, judged: Flags, is_isotropic: bool = False
) -> Callable[[Floats], Floats]:
    """A function of displacements (m, 3): the differences along the ``judged`` edges over the edge
    length, of the components along ``normals`` (m, 3), or of vectors if ``is_isotropic``.

    Only the tangential part of edges counts for their length: noise lengthens the normal part, and
    the slopes would depend on the noise.
    """
    links = mesh.topology
    counts = np.diff(links.ring_start)
    first = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    kept = (first < links.ring) & judged[first] & judged[links.ring]
    first, second = first[kept], links.ring[kept]
    mean_normals = normals[first] + normals[second]
    length = np.sqrt(np.einsum("ij,ij->i", mean_normals, mean_normals))
    mean_normals /= np.maximum(length, 1e-9)[:, None]
    edges = mesh.vertices[first] - mesh.vertices[second]
    edges -= np.einsum("ij,ij->i", edges, mean_normals)[:, None] * mean_normals
    lengths = np.sqrt(np.einsum("ij,ij->i", edges, edges))
    floor = MIN_EDGE * float(lengths.mean()) if len(lengths) else 1.0
    lengths = np.maximum(lengths, max(floor, np.finfo(float).tiny))[:, None]
    directions = 1.0 / lengths if is_isotropic else mean_normals / lengths

    def slopes(moves: Floats) -> Floats:
        difference = moves[first] - moves[second]
        if is_isotropic:
            return np.asarray(difference * directions).reshape(-1)
        return np.asarray(np.einsum("ij,ij->i", difference, directions))

    return slopes


class SimulatedRisk:
    """Runs filters on a simulated mesh: ``pilot`` (m, 3), taken as truth, with ``noise``.

    ``added`` is what is added to the pilot: a sample of the noise (``DRAWN``), or what the pilot
    removed, with the opposite sign (``MIRRORED``).
    """

    def __init__(
        self,
        part: Part,
        pilot: Floats,
        runs: Sequence[Run],
        noise: NoiseModel,
        added: str,
        on_run: Callable[[], object],
    ) -> None:
        noise = noise.at_level(max(noise.level, MIN_NOISE * part.mesh.mean_edge_length))
        self._part, self._is_isotropic = part, noise.direction == ISOTROPIC
        truth = part.mesh.with_vertices(pilot)
        self._normals = truth.vertex_normals("uniform")
        if added == MIRRORED:
            moved = pilot - part.mesh.vertices
        else:
            generator = np.random.Generator(np.random.PCG64(SEED))
            moved = noise.draw(truth, self._normals, generator)
        self._noisy = truth.with_vertices(pilot + moved)
        self._back = pilot - self._noisy.vertices
        self._moves = np.empty((len(runs), *pilot.shape))
        for k, run in enumerate(runs):
            self._moves[k] = run(self._noisy)
            on_run()

    @property
    def level(self) -> float:
        """Root mean square of the added noise over the judged vertices, file units."""
        judged = self._part.judged
        return float(np.sqrt(_square(self._back[judged]) / max(int(judged.sum()), 1)))

    def risk(self, judged: Flags | None = None) -> Risk:
        """The risk of blends over the vertices ``judged`` (m,); None for those of the part."""
        judged = self._part.judged if judged is None else judged
        slopes = _slopes(self._noisy, self._normals, judged, self._is_isotropic)
        seen = np.where(judged[None, :, None], self._moves, 0.0)
        return Risk(
            _known(seen, np.where(judged[:, None], self._back, 0.0)),
            _known(np.stack([slopes(move) for move in self._moves]), slopes(self._back)),
        )


def _square(values: Floats) -> float:
    """The sum of squares, in one fixed order."""
    flat = values.reshape(-1)
    return float(np.einsum("i,i->", flat, flat))


def _known(rows: Floats, wanted: Floats) -> Quadratic:
    """The quadratic error of combinations of rows (k, ...) that approximate ``wanted`` (...).

    Scalar products are summed in a fixed order, not by a BLAS product, whose last digit may depend
    on the number of threads.
    """
    flat = rows.reshape(len(rows), -1)
    gram = np.empty((len(flat), len(flat)))
    for k, row in enumerate(flat):
        gram[k, k:] = np.einsum("ij,j->i", flat[k:], row)
        gram[k:, k] = gram[k, k:]
    # Without noise each displacement is an error, which is then large but finite.
    scale = max(_square(wanted), MIN_SHARE * float(np.diag(gram).max()), np.finfo(float).tiny)
    return Quadratic(gram / scale, np.einsum("ij,j->i", flat, wanted.reshape(-1)) / scale)


# Runs of candidates on one part of the mesh


RELAX = 2
"""Passes that relax triangles under isotropic noise: more hardly help, and displace vertices."""

MIN_LEFT, MAX_LEFT = 0.32, 0.8
"""Bounds of the squared error of relaxed triangles by Stein's lemma, over the squared noise, for
isotropic noise, which has 0.42 to 0.66.  Outside them the noise is only along the normals (0.93 and
more), or the triangles are uneven without noise."""

MIN_FLATTER = 0.6
"""Reduction of the logarithm of the squared error of angles that one pass on uneven triangles
needs.  On 25 foreign meshes and those of benchmarks/ground_truth.py, noise along the normals that
was classified as isotropic had up to 0.53, isotropic noise of 0.15 and more mostly 0.7 to 2.4."""

RELAX_PATCH, PROBE_STEP = 4_000, 0.1
"""Vertices of the part on which relaxing is evaluated, and size of the probe's displacements, in
standard deviations of the noise."""


class CandidateRuns:
    """Runs of candidates on a part of a mesh; each result is cached.

    Parameters
    ----------
    part : of the mesh.
    noise : on it.
    edges : the noise that candidates are given, mean edge lengths of the part; None for its height.
    """

    def __init__(self, part: Part, noise: NoiseModel, edges: float | None = None) -> None:
        self.part, self.noise = part, noise
        if edges is None:
            edges = noise.height(part.judged) / part.mesh.mean_edge_length
        self._edges = float(round(edges, 4))
        self._known: dict[tuple[str, str], Floats] = {}

    def moves(self, candidate: Candidate, mesh: Mesh | None = None) -> Floats:
        """Displacements (m, 3) by a candidate on the part, or on a ``mesh`` with the same faces."""
        method = methods.find(candidate.method)
        values = method.validate(candidate.settings(self._edges))
        if mesh is not None:
            return np.asarray(method.denoise(mesh, values).vertices - mesh.vertices)
        # Candidates with other settings may have the same label.
        key = candidate.method, repr(values)
        if key not in self._known:
            scanned = self.part.mesh
            self._known[key] = method.denoise(scanned, values).vertices - scanned.vertices
        return self._known[key]

    def result(self, candidate: Candidate) -> Mesh:
        """The part after a candidate."""
        return self.part.mesh.with_vertices(self.part.mesh.vertices + self.moves(candidate))

    def simulate(
        self,
        candidates: Sequence[Candidate],
        pilot: Candidate,
        on_run: Callable[[], object],
        added: str = DRAWN,
    ) -> SimulatedRisk:
        """Simulate candidates with the result of the ``pilot`` as the truth; ``on_run`` is called
        after each.  See ``SimulatedRisk``."""
        runs = [functools.partial(self.moves, candidate) for candidate in candidates]
        truth = self.result(pilot).vertices
        return SimulatedRisk(self.part, truth, runs, self.noise, added, on_run)

    def rate(self, candidates: Sequence[Candidate], true: Mesh, judged: Flags) -> Risk:
        """The risk of candidates over the vertices ``judged`` (m,) if ``true`` is the surface of
        the part.  Tangential displacements do not count."""
        mesh, normals = self.part.mesh, true.vertex_normals("uniform")
        slopes = _slopes(mesh, normals, judged)
        moves = [true.vertices - mesh.vertices, *map(self.moves, candidates)]
        heights = np.stack([np.einsum("ij,ij->i", move, normals) for move in moves])[:, judged]
        tilts = np.stack([slopes(move) for move in moves])
        places = _known(heights[1:], heights[0])
        return Risk(places, _known(tilts[1:], tilts[0]))

    def compare(self, moves: Sequence[Floats], true: Mesh) -> tuple[Floats, Floats, Floats]:
        """Errors of k ``moves`` (m, 3) if ``true`` is the surface of the part: logarithms of the
        squared errors of normal positions and of face normals over those of the part, (k,) each,
        and the root mean square of the former, file units.

        Tangential displacements do not count.
        """
        across, normals = true.vertex_normals("uniform"), face_normals(true.vertices, true.faces)
        rows = []
        for move in (np.zeros(3), *moves):
            vertices = self.part.mesh.vertices + move
            heights = np.einsum("ij,ij->i", vertices - true.vertices, across)[self.part.judged]
            cosines = np.einsum("ij,ij->i", face_normals(vertices, true.faces), normals)
            angle = float(np.arccos(np.clip(cosines, -1.0, 1.0)).mean())
            square = (heights * heights).sum() / max(len(heights), 1)
            rows.append((float(np.sqrt(square)), angle))
        lengths, angles = np.maximum(np.array(rows), np.finfo(float).tiny).T
        places, tilts = 2.0 * np.log(lengths / lengths[0]), 2.0 * np.log(angles / angles[0])
        return places[1:], tilts[1:], lengths[1:]


def count_relaxing(mesh: Mesh, noise: NoiseModel) -> int:
    """The number of passes that relax the triangles before other filters.

    It is ``RELAX`` for isotropic noise if the passes remove the noise of the triangles rather than
    earlier unevenness; 1 if the result of AL after one pass is much nearer in its angles to that of
    the learned filter; else 0.

    For Gaussian noise the mean of <moves, noise> is the variance times the divergence of the moves
    (Stein's lemma), which one random probe u estimates: u . (moves(y + e u) - moves(y)) / e.
    """
    if noise.direction != ISOTROPIC:
        return 0
    part = select_patch(mesh, RELAX_PATCH)
    mesh, inside = part.mesh, part.judged
    noise = noise.on_part(part.numbers)
    generator = np.random.Generator(np.random.PCG64(1))
    push = noise.scale * np.where(generator.random(mesh.vertices.shape) < 0.5, -1.0, 1.0)
    moves = _relaxing_moves(mesh)
    change = _relaxing_moves(mesh.with_vertices(mesh.vertices + PROBE_STEP * push)) - moves
    divergence = float(np.einsum("ij,ij->", push[inside], change[inside])) / PROBE_STEP
    gain = -divergence / max(_square(push[inside]), np.finfo(float).tiny)
    variance = 3.0 * max(int(inside.sum()), 1) * noise.height(inside) ** 2
    left = 1.0 - 2.0 * gain + _square(moves[inside]) / max(variance, np.finfo(float).tiny)
    if MIN_LEFT <= left <= MAX_LEFT:
        return RELAX
    noise = noise.along_normals()
    edges = noise.height(inside) / mesh.mean_edge_length
    runs = CandidateRuns(part, noise, edges)
    usual, evened = wiener_al(edges), even_out(mesh, 1)
    moves = runs.moves(usual, evened) + (evened.vertices - mesh.vertices)
    tilts = runs.compare([runs.moves(usual), moves], runs.result(LEARNED))[1]
    return int(tilts[1] < tilts[0] - MIN_FLATTER)


def _relaxing_moves(mesh: Mesh) -> Floats:
    """Displacements (m, 3) of vertices by relaxing the triangles."""
    return even_out(mesh, RELAX).vertices - mesh.vertices


# Errors of given filters, such as the cells of msal sweep

Filter = tuple[Method | None, Mapping[str, Any]]
"""A method and all its parameters; None is the unchanged mesh."""


def estimate_errors(mesh: Mesh, filters: Sequence[Filter]) -> list[float] | None:
    """The estimated root mean square distance of each result from the true surface, in mean edge
    lengths of ``mesh``, as in ``Choice.risk``; None if the noise is negligible.

    By a simulation with the result of the learned filter as the truth; see ``SimulatedRisk``.
    """
    noise = estimate_noise(mesh)
    if noise.is_negligible:
        return None
    part = select_patch(mesh)
    model = build_model(mesh, noise).on_part(part.numbers)
    is_gaussian = not noise.character.step and not noise.is_impulsive
    first = CandidateRuns(part, model).result(LEARNED if is_gaussian else ROBUST_LEARNED)
    normals, is_isotropic = first.vertex_normals("uniform"), model.direction == ISOTROPIC
    model = model.along_normals()

    def run(given: Filter, mesh: Mesh) -> Floats:
        method, values = given
        if method is None:
            return np.zeros_like(mesh.vertices)
        moves: Floats = method.denoise(mesh, values).vertices - mesh.vertices
        # Under isotropic noise tangential displacements do not count.
        heights = np.einsum("ij,ij->i", moves, normals)[:, None]
        return heights * normals if is_isotropic else moves

    runs = [functools.partial(run, given) for given in filters]
    added = DRAWN if is_gaussian else MIRRORED
    judge = SimulatedRisk(part, first.vertices, runs, model, added, lambda: None)
    shares = np.sqrt(np.maximum(judge.risk().positions.singles(), 0.0))
    unit = model.height(part.judged) / mesh.mean_edge_length
    return [float(share) * unit for share in shares]
