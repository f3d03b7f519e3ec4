"""Detection of outlier vertices, and their projection onto the surface of their neighbours.

An outlier is a vertex that a scanner put one edge length or more off the surface, in any direction,
alone or together with up to four neighbours.  No other vertex moves.
"""

import math

import numpy as np

from msal_cli.analysis.noise_estimate import NoiseLevel, estimate_noise, has_flat_edges
from msal_cli.arrays import Flags, Floats, Longs
from msal_cli.kernels import outliers
from msal_cli.kernels.geometry import distances
from msal_cli.kernels.quantiles import median
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

ROUGH = 0.85
"""Vertices are tested if the agreement of their face normals is below it: spikes, folds and strong
noise have less, flat and smooth regions have more."""

BOUND = 1.3
"""Score above which a vertex is an outlier, where outliers are few."""

USUAL, STEP, MAX_STEPS = 0.0005, 0.17, 0.8
"""The more outliers there are, the more likely a vertex is one: the bound is reduced by ``STEP``
times the logarithm of their share over ``USUAL``, up to ``MAX_STEPS``, unless they may be noise."""

MAX_PASSES, RETURNS = 12, 2
"""Adjacent spikes mask one another, so each pass takes only those with locally maximal scores.  The
last ones project all outliers at once, each by the new positions of the others."""

NEW_SHARE = 0.1
"""If more than this share of the outliers is new, the noise of the others is estimated again."""

FEW_OUTLIERS = 0.002
"""Up to this share of the vertices outliers hardly change the estimated level of noise, which is
that of the flattest regions."""

MAX_SHARE = 0.12
"""With more than this share of the vertices they are noise rather than outliers."""

CERTAIN, MIN_CERTAIN = 3.0, 0.02
"""Score above which an outlier is certain, and the share of certain ones from which outliers are
projected by default.  At least 17 % of synthetic outliers are certain, 3 % of the spikes of a raw
scan, and none of the tips and ridges of a coarse model that look like outliers."""

FEW = 0.008
"""Fewer outliers than this share of the vertices, on a mesh without noise that has coplanar faces,
are points of the design, such as those left by shrink-wrapping."""

APART = 6.0
"""Median displacement of outliers, over the noise of the other vertices, from which they are not
just its tail.  Impulsive noise on many vertices has less, and a filter for it does better."""

MIN_ALIGNED, ALIGNED_SHARE, TIP_FACES = 3, 0.5, 3
"""Outliers are points of a design if so many of them, and such a share, have exactly the same
coordinate, like corners of long thin faces; or have at most ``TIP_FACES`` faces, which is rare in
scans."""


@dataclass(frozen=True, eq=False)
class Outliers:
    """The outliers of a mesh."""

    flags: Flags  # (n,) whether each vertex is an outlier
    vertices: Floats  # (n, 3) positions with the outliers projected, all others unchanged
    # whether to project the outliers by default: they exceed the noise and are no design
    are_clear: bool
    # share of the vertices, 0 to 1, that seemed to be outliers; above ``MAX_SHARE`` none is flagged
    share: float

    @property
    def are_too_many(self) -> bool:
        """Whether so many seemed to be outliers that none is flagged."""
        return self.share > MAX_SHARE

    @property
    def count(self) -> int:
        """The number of outliers."""
        return int(np.count_nonzero(self.flags))


def find_outliers(mesh: Mesh) -> Outliers:
    """The outliers of a mesh, and their projections onto the surface.

    A robust quadratic is fitted to the two-ring of a vertex without the vertex itself.  The score
    adds the distance of the vertex from the fit along the normal, its tangential distance from the
    mean of its neighbours, and how much rougher its faces are than they would be with the vertex on
    the fit.  It is in units of local edge lengths, and is reduced by the noise and texture around
    the vertex.  A corner, edge or tip whose surroundings continue it has a low score.

    Never outliers are vertices with coplanar faces, of needle triangles, or among edges of very
    different lengths, because CAD exports have such vertices and scans do not; nor are fixed and
    boundary vertices.  Without outliers the cost is about that of one sweep.
    """
    found = _Search(mesh, BOUND).run()
    # Few methods need it, and it takes more memory than the vertices.
    mesh.topology.release_incidence()
    return found


class _Search:
    """The state of one search: positions, scores above a ``floor``, and outliers found so far."""

    def __init__(self, mesh: Mesh, floor: float) -> None:
        n = len(mesh.vertices)
        self.mesh = mesh
        self.floor = floor
        self.positions = mesh.vertices
        self.agreements = np.ones(n)
        self.may_move = mesh.topology.has_ring.copy()
        if mesh.fixed_vertices is not None:
            self.may_move &= ~mesh.fixed_vertices
        self.scores = np.full(n, outliers.NOT_JUDGED)
        self.flags = np.zeros(n, dtype=np.bool_)
        self.noise: NoiseLevel | None = None  # cache of ``_noise``

    def run(self) -> Outliers:
        mesh = self.mesh
        n_used = max(int(np.count_nonzero(mesh.topology.has_ring)), 1)
        self._measure_agreement(np.arange(len(self.flags)))
        self._score(np.arange(len(self.flags)))
        if not (self.scores > BOUND).any():
            return Outliers(self.flags, mesh.vertices, False, 0.0)
        n_certain, are_apart, bound = 0, False, BOUND
        self.positions = mesh.vertices.copy()
        for _ in range(MAX_PASSES):
            found = outliers.pick(self.scores, bound, mesh.topology)
            if len(found):
                n_certain += int(np.count_nonzero(self.scores[found] > CERTAIN))
                self.flags[found] = True
                self._score(self._bring_back(found))
                if len(found) > NEW_SHARE * int(np.count_nonzero(self.flags)):
                    self.noise = None
            share = int(np.count_nonzero(self.flags)) / n_used
            if share > MAX_SHARE:
                return Outliers(np.zeros_like(self.flags), mesh.vertices, False, share)
            # Spikes among the others may be undetected outliers: the level without spikes counts.
            are_apart = are_apart or (
                share > USUAL
                and not self._are_in_noise(share)
                and self._are_beyond(self._noise().mean_edges)
            )
            if are_apart and self.floor == BOUND:
                # The bound becomes lower than the floor, below which no scores were computed.
                return _Search(mesh, outliers.MIN_SCORE).run()
            before, bound = bound, BOUND
            if are_apart:
                bound -= min(STEP * math.log(max(share / USUAL, 1.0)), MAX_STEPS)
            if not len(found) and bound == before:
                break
        for _ in range(RETURNS):
            self._bring_back(np.flatnonzero(self.flags))
        # Those that are no outliers once their neighbours are projected keep their positions.
        found = np.flatnonzero(self.flags)
        wrong = found[self._judge(found)[0] <= bound]
        if len(wrong):
            self.flags[wrong] = False
            self.positions[wrong] = mesh.vertices[wrong]
        self.noise = None
        count = int(np.count_nonzero(self.flags))
        are_certain = n_certain > 0 and n_certain >= MIN_CERTAIN * count
        coordinates = mesh.vertices[self.flags].T
        n_aligned = max(np.unique(x, return_counts=True)[1].max(initial=0) for x in coordinates)
        n_tips = np.count_nonzero(np.diff(mesh.topology.ring_start)[self.flags] <= TIP_FACES)
        are_designed = max(n_aligned, n_tips) >= max(MIN_ALIGNED, ALIGNED_SHARE * count)
        are_clear = not are_designed and self._are_off_noise(are_certain, count / n_used)
        return Outliers(self.flags, self.positions, are_clear, count / n_used)

    def _are_off_noise(self, are_certain: bool, share: float) -> bool:
        """Whether the outliers are displaced much farther than the noise of the other vertices.  If
        none is certain, there must be noise, and more outliers than noise alone has."""
        if (not are_certain and share <= USUAL) or self._are_in_noise(share):
            return False
        after = self._noise()
        # Detail that may be noise: the outliers must exceed its upper bound.
        is_detail = after.is_negligible and after.is_unsure
        if not self._are_beyond(after.high if is_detail else after.rms_edges):
            return False
        if after.is_negligible:
            moved = self.mesh.with_vertices(self.positions)
            return are_certain and not (share < FEW and has_flat_edges(moved))
        is_sure = are_certain or (share > USUAL and not after.is_unsure)
        return is_sure and not estimate_noise(self.mesh).is_negligible

    def _are_in_noise(self, share: float) -> bool:
        """Whether there are few outliers, displaced no farther than the noise of the whole mesh.
        That estimate is needed for a choice anyway, and saves the one without outliers."""
        are_few = share <= FEW_OUTLIERS
        return are_few and not self._are_beyond(estimate_noise(self.mesh).mean_edges)

    def _noise(self) -> NoiseLevel:
        """The noise with the outliers projected; a few of the newest may be missing."""
        if self.noise is None:
            self.noise = estimate_noise(self.mesh.with_vertices(self.positions))
        return self.noise

    def _are_beyond(self, noise_edges: float) -> bool:
        """Whether the outliers are displaced much farther than this level of noise."""
        moves = distances(self.mesh.vertices[self.flags], self.positions[self.flags])
        return len(moves) > 0 and median(moves) >= APART * noise_edges * self.mesh.mean_edge_length

    def _measure_agreement(self, changed: Longs) -> None:
        """Update the agreement of the face normals at the vertices ``changed`` (c,)."""
        mesh = self.mesh
        outliers.measure_agreement(
            self.positions, mesh.faces, mesh.topology, changed, self.agreements
        )

    def _score(self, changed: Longs) -> None:
        """Update the scores of the vertices ``changed`` (c,)."""
        self.scores[changed] = outliers.NOT_JUDGED
        is_rough = self.agreements[changed] < ROUGH
        chosen = changed[is_rough & self.may_move[changed] & ~self.flags[changed]]
        self.scores[chosen], _ = self._judge(chosen, is_known=False)

    def _judge(self, chosen: Longs, is_known: bool = True) -> tuple[Floats, Floats]:
        """Scores (c,) of vertices at their positions in the file, and projections (c, 3)."""
        mesh = self.mesh
        return outliers.judge(
            chosen,
            mesh.vertices[chosen],
            self.positions,
            mesh.faces,
            mesh.topology,
            self.agreements,
            mesh.mean_edge_length,
            is_known,
            self.floor,
        )

    def _bring_back(self, found: Longs) -> Longs:
        """Project outliers onto their fits; returns the vertices whose surroundings changed."""
        self.positions[found] = self._judge(found)[1]
        changed = outliers.find_two_rings(found, self.mesh.topology)
        self._measure_agreement(changed)
        return changed
