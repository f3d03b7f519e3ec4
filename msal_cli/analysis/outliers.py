"""Outlier vertices: found, and brought back to the surface that their neighbours make.

Single vertices that a scanner puts one edge and more out of the surface, in any direction, also two
to five neighbours together.  Nothing else moves.
"""

import math

import numpy as np

from msal_cli.analysis.noise_estimate import (
    NoiseLevel,
    estimate_noise,
    has_flat_edges,
    has_uneven_edges,
    is_non_manifold,
)
from msal_cli.analysis.noise_estimate.patterns import are_mirrored
from msal_cli.arrays import Flags, Floats, Longs
from msal_cli.kernels import outliers
from msal_cli.kernels.geometry import distances
from msal_cli.kernels.quantiles import median
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

ROUGH = 0.85
"""Agreement of a vertex's face normals below which it is looked at: spikes and folds have less, and
so has strong noise; flat and smooth places have more."""

BOUND = 1.3
"""Score from which a vertex is an outlier where few others are."""

USUAL, STEP, MAX_STEPS = 0.0005, 0.17, 0.8
"""Where more than the ``USUAL`` share of vertices are outliers, a vertex is one more likely: the
bound is less by ``STEP`` for each factor of e, up to ``MAX_STEPS``, unless they may be noise."""

MAX_PASSES = 12
"""Spikes hide one another: each pass takes the ones furthest out among their neighbours."""

NEW_SHARE = 0.1
"""Share of the outliers that are new, above which the noise of the others is estimated anew."""

RETURNS = 2
"""Passes that bring back all outliers at once, each among the places of the others."""

FEW_OUTLIERS = 0.002
"""Share of the vertices up to which outliers hardly change the level of the noise, which is that of
the flattest places."""

MAX_SHARE = 0.12
"""Share of the vertices beyond which they are noise rather than outliers."""

CERTAIN, MIN_CERTAIN = 3.0, 0.02
"""Score from which an outlier is certain, and the share of the outliers that are certain from which
they are brought back by default.  Of planted ones 17 % are and more, of the spikes of
a raw scan 3 %, and none of the tips and ridges of a coarse model that seem to be outliers."""

FEW = 0.008
"""Share of the vertices below which outliers of a mesh without noise whose edges are flat to
rounding are points of the design, such as what shrink-wrapping leaves."""

APART = 6.0
"""Ways of the outliers, in the median, over the noise of all others, from which that is so: those
of impulsive noise on many vertices are its tail, and a filter that knows of them does better."""

MIN_ALIGNED, ALIGNED_SHARE, TIP_FACES = 3, 0.5, 3
"""How many outliers, and what share of them, with exactly the same coordinate are points of a
design: corners of its long thin faces.  So are as many that are tips of only ``TIP_FACES`` faces,
which hardly a vertex of a scan is, and such a share with mirror images."""


@dataclass(frozen=True, eq=False)
class Outliers:
    """The outliers of a mesh."""

    flags: Flags  # (n,) which vertices they are
    vertices: Floats  # (n, 3) positions with them brought back, all others as they were
    # whether they are to be brought back by default: some are certain, and they are no tail of the
    # noise
    are_clear: bool
    # of the vertices, 0 to 1, that seemed to be outliers; beyond ``MAX_SHARE`` none is flagged
    share: float

    @property
    def are_too_many(self) -> bool:
        """Whether so many seemed to be outliers that none is flagged."""
        return self.share > MAX_SHARE

    @property
    def count(self) -> int:
        """How many they are."""
        return int(np.count_nonzero(self.flags))


def find_outliers(mesh: Mesh) -> Outliers:
    """The outliers of a mesh, and their places on the surface.

    A vertex is compared with a robust fit of degree 2 to its two-ring without itself: how far it is
    across and along the surface, how rough its faces make the surface, and how rough it would be
    with the vertex in its place.  All is in units of the local edges, less what noise and texture
    around it explain.  Corners, edges and tips that their faces around them go on are smooth that
    way.  Nor are vertices of flat sides, exact to rounding, of needle triangles and among edges of
    very unlike lengths: exports of designs have such, meshes from scanners do not.  Fixed vertices,
    and those on open borders, are never outliers.  It costs about as much as
    one sweep where there are none.
    """
    return _Search(mesh, BOUND).run()


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
        # Of the others, once it is estimated.
        self.noise: NoiseLevel | None = None

    def run(self) -> Outliers:
        """All passes."""
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
            # What is not found yet is among the spikes, so they do not count here.
            are_apart = are_apart or (
                share > USUAL
                and not self._are_in_noise(share)
                and self._are_beyond(self._noise().mean_edges)
            )
            if are_apart and self.floor == BOUND:
                # The bound gets lower, and scores up to this one were left out.
                return _Search(mesh, outliers.MIN_SCORE).run()
            before, bound = bound, BOUND
            if are_apart:
                bound -= min(STEP * math.log(max(share / USUAL, 1.0)), MAX_STEPS)
            if not len(found) and bound == before:
                break
        for _ in range(RETURNS):
            self._bring_back(np.flatnonzero(self.flags))
        # What is no outlier any more now that its neighbours are in their places goes back.
        found = np.flatnonzero(self.flags)
        wrong = found[self._judge(found)[0] <= bound]
        if len(wrong):
            self.flags[wrong] = False
            self.positions[wrong] = mesh.vertices[wrong]
        self.noise = None
        count = int(np.count_nonzero(self.flags))
        are_certain = n_certain > 0 and n_certain >= MIN_CERTAIN * count
        # Along one of the axes of the file.
        at = mesh.vertices[self.flags].T
        n_aligned = max(np.unique(x, return_counts=True)[1].max(initial=0) for x in at)
        n_tips = np.count_nonzero(np.diff(mesh.topology.ring_start)[self.flags] <= TIP_FACES)
        are_designed = max(n_aligned, n_tips) >= max(MIN_ALIGNED, ALIGNED_SHARE * count)
        are_designed |= are_mirrored(mesh, np.flatnonzero(self.flags), ALIGNED_SHARE)
        are_clear = not are_designed and self._are_off_noise(are_certain, count / n_used)
        return Outliers(self.flags, self.positions, are_clear, count / n_used)

    def _are_off_noise(self, are_certain: bool, share: float) -> bool:
        """Whether the others have much less noise than the outliers.  Where none of these is
        certain, there must be noise, and more of them than noise alone seems to have; points of a
        design that were moved look like noise."""
        if (not are_certain and share <= USUAL) or self._are_in_noise(share):
            return False
        after = self._noise()
        # What looks like noise, and is not, is detail, which outliers exceed as well.
        is_detail = after.is_negligible and after.is_unsure
        if not self._are_beyond(after.high if is_detail else after.rms_edges):
            return False
        if after.is_negligible:
            moved = self.mesh.with_vertices(self.positions)
            is_design = has_uneven_edges(moved) or is_non_manifold(moved)
            is_design |= share < FEW and has_flat_edges(moved)
            return are_certain and not is_design
        is_sure = are_certain or (share > USUAL and not after.is_unsure)
        return is_sure and not estimate_noise(self.mesh).is_negligible

    def _are_in_noise(self, share: float) -> bool:
        """Whether few outliers went no further than the noise of the mesh as it is, which a choice
        asks for as well: that of the others need not be estimated."""
        few = share <= FEW_OUTLIERS
        return few and not self._are_beyond(estimate_noise(self.mesh).mean_edges)

    def _noise(self) -> NoiseLevel:
        """The noise of all others, or of nearly as many."""
        if self.noise is None:
            self.noise = estimate_noise(self.mesh.with_vertices(self.positions))
        return self.noise

    def _are_beyond(self, noise_edges: float) -> bool:
        """Whether the outliers went much further than noise of so many mean edge lengths does."""
        ways = distances(self.mesh.vertices[self.flags], self.positions[self.flags])
        return len(ways) > 0 and median(ways) >= APART * noise_edges * self.mesh.mean_edge_length

    def _measure_agreement(self, changed: Longs) -> None:
        """Set the agreement of the faces around vertices (c,) whose surroundings have changed."""
        mesh = self.mesh
        outliers.measure_agreement(
            self.positions, mesh.faces, mesh.topology, changed, self.agreements
        )

    def _score(self, changed: Longs) -> None:
        """Set the scores of such vertices."""
        self.scores[changed] = outliers.NOT_JUDGED
        is_rough = self.agreements[changed] < ROUGH
        chosen = changed[is_rough & self.may_move[changed] & ~self.flags[changed]]
        self.scores[chosen], _ = self._judge(chosen, is_known=False)

    def _judge(self, chosen: Longs, is_known: bool = True) -> tuple[Floats, Floats]:
        """Scores (c,) of vertices where the file has them, and their places (c, 3) on the fit."""
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
        """Move outliers to their places on the fits; the vertices whose surroundings change."""
        self.positions[found] = self._judge(found)[1]
        changed = outliers.find_two_rings(found, self.mesh.topology)
        self._measure_agreement(changed)
        return changed
