"""Detection of repeating patterns (knurls, threads, fabric, layers of a print), which noise lacks.

Around some vertices the heights above a cubic polynomial are decomposed into plane waves by greedy
selection.  A few waves explain nearly all of a pattern, and the first one has the same length
everywhere; the waves selected in noise have different lengths.  Waves of hardly more than two edges
cannot be distinguished from noise.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from msal_cli.analysis.noise_estimate.fits import Survey
from msal_cli.arrays import Flags, Floats, Floats32
from msal_cli.kernels.patch_fits import collect_near
from msal_cli.kernels.quantiles import median
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh

PLACES, FIRST_PLACES = 24, 6
"""Vertices that are tested, and how many of them are tested first, which is enough to reject most
noise; a mesh with fewer has no verdict."""

REACH, MIN_AROUND, MAX_AROUND = 7.0, 60, 250
"""Radius of the neighbourhood of a vertex, mean edge lengths, and its fewest and most vertices."""

SHORTEST, STEP, PERIODS, DIRECTIONS = 2.1, 1.16, 11, 12
"""The shortest wave in mean edge lengths, the ratio of consecutive wave lengths, and the numbers of
lengths and of directions."""

GRID = np.indices((PERIODS, DIRECTIONS)).reshape(2, -1).T.astype(np.float32)
AROUND = (np.indices((3, 3)).reshape(2, -1).T - 1.0).astype(np.float32)
"""Waves as pairs of logarithm of the length and direction, in steps: the initial grid, and the
offsets for the refinement of the best wave."""

LONGEST = 8.5
"""Length in steps (7.4 edges) above which correlated noise may have its first wave everywhere."""

WAVES, DEGREE = 6, 3

FIRST_ALIKE, MIN_ALIKE, MIN_EXPLAINED = 0.8, 0.9, 0.91
"""A pattern is assumed if at this share of the first vertices, then of all, the length of the first
wave is within a step of the median, and waves explain this part of the squared heights.  Under
noise of each kind on eleven models at most 0.83 of the vertices agree where 0.85 is explained; with
white noise of 0.1 mean edge lengths on two threads and flutes 0.9 is explained."""

MAX_GAIN = 2.0
"""Largest ratio of what a later wave explains to what an earlier one does: they come in order of
size, except for those that earlier ones hide.  It changes none of 1,600 verdicts."""

TINY = 1e-4
"""Root mean square of heights, mean edge lengths, below which a neighbourhood is smooth."""

MIN_INDEPENDENT = 0.005
"""Waves are ignored if less of their square is independent of polynomials and other waves."""


def is_patterned(mesh: Mesh, survey: Survey) -> bool:
    """Whether the surface of ``mesh`` has a repeating pattern at vertices of the ``survey``."""
    count = min(PLACES, len(survey.vertices))
    at = ((np.arange(count) + 0.5) * (len(survey.vertices) / max(count, 1))).astype(np.int64)
    # Interleaved, so that the first ones are spread over the mesh.
    at = np.concatenate([at[first::4] for first in range(4)])
    is_met = np.zeros(len(mesh.vertices), dtype=np.bool_)
    places = (Place.look_at(mesh, int(survey.vertices[k]), survey.normals[k], is_met) for k in at)
    found = (place for place in places if place is not None)
    first = list(itertools.islice(found, FIRST_PLACES))
    if len(first) < FIRST_PLACES or not _are_patterned(first, FIRST_ALIKE):
        return False
    return _are_patterned([*first, *found], MIN_ALIKE)


def _are_patterned(places: Sequence[Place], min_alike: float) -> bool:
    lengths = np.array([place.find_length() for place in places])
    usual = median(lengths)
    if usual > LONGEST or float((np.abs(lengths - usual) <= 1.0).mean()) < min_alike:
        return False
    unlike = 0
    for place in places:
        unlike += not place.is_explained()
        # This is the slowest part, and most meshes fail at the first vertices.
        if 2 * unlike > len(places):
            return False
    return True


@dataclass(frozen=True, eq=False)
class Place:
    """The neighbourhood of a vertex."""

    points: Floats32  # (k, 2) positions in the tangent plane, mean edge lengths
    known: Floats32  # (k, c) orthonormal basis of the polynomials and selected waves
    rest: Floats32  # (k,) residual heights, scaled to length 1
    grid: Waves  # the waves of ``GRID`` without their projection on polynomials

    @classmethod
    def look_at(cls, mesh: Mesh, vertex: int, normal: Floats, is_met: Flags) -> Place | None:
        """The neighbourhood of a vertex, without vertices whose normals face away; None if it is
        too small or smooth.  ``is_met`` (n,) is a buffer, False before and after."""
        reach, normals = REACH * mesh.mean_edge_length, mesh.vertex_normals("uniform", 1)
        rings, found = mesh.topology.one_ring, np.empty(MAX_AROUND, dtype=np.int64)
        count = collect_near(vertex, normal, reach, mesh.vertices, normals, *rings, is_met, found)
        around = found[:count]
        if len(around) < MIN_AROUND:
            return None
        offsets = (mesh.vertices[around] - mesh.vertices[vertex]) / mesh.mean_edge_length
        _, _, axes = np.linalg.svd(normal[None])
        (x, y), heights = axes[1:] @ offsets.T, offsets @ normal
        powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
        known, _ = np.linalg.qr(np.stack([x**i * y**j for i, j in powers], axis=1))
        rest = heights - known @ (known.T @ heights)
        size = math.sqrt(float(rest @ rest))
        if size <= math.sqrt(len(around)) * TINY:
            return None
        points = np.stack([x, y], axis=1).astype(np.float32)
        known = known.astype(np.float32)
        grid = Waves.make(points, GRID).without(known)
        return cls(points, known, (rest / size).astype(np.float32), grid)

    def find_length(self) -> float:
        """Length of the best wave of ``GRID``, in steps."""
        return float(GRID[self.grid.find_best(self.rest)][0])

    def is_explained(self) -> bool:
        """Whether the best ``WAVES`` explain enough of the squared heights."""
        known, rest, grid = self.known, self.rest, self.grid
        left = 1.0
        for later in reversed(range(WAVES)):
            wave = GRID[grid.find_best(rest)]
            for nearer in (0.5, 0.25):
                tried = wave + np.float32(nearer) * AROUND
                waves = Waves.make(self.points, tried).without(known)
                best = waves.find_best(rest)
                wave = tried[best]
            pair = waves.rows[:, best].T
            pair, _ = np.linalg.qr(pair - known @ (known.T @ pair))
            grid, known = grid.without(pair), np.concatenate([known, pair], axis=1)
            rest = rest - pair @ (pair.T @ rest)
            before, left = left, float(rest @ rest)
            if left - later * MAX_GAIN * (before - left) > 1.0 - MIN_EXPLAINED:
                return False
        return True


@dataclass(frozen=True, eq=False)
class Waves:
    """Plane waves at the vertices of a neighbourhood; they are fitted without their projection on
    orthonormal columns (k, c)."""

    rows: Floats32  # (2, w, k) cosines and sines, with those projections
    # squares, both: squared lengths (2, w) and products (w,) of cosines and sines without them
    squares: Floats32
    both: Floats32

    @classmethod
    def make(cls, points: Floats32, waves: Floats32) -> Waves:
        """The ``waves`` (w, 2), in steps, at ``points`` (k, 2), mean edge lengths."""
        turns = (np.pi / DIRECTIONS) * waves[:, 1]
        numbers = 2.0 * math.pi / (SHORTEST * STEP ** waves[:, 0])
        directions = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        phases = (numbers[:, None] * directions).astype(np.float32) @ points.T
        rows = np.stack([np.cos(phases), np.sin(phases)])
        return cls(rows, *_products(rows))

    def without(self, known: Floats32) -> Waves:
        """The waves without their projection on the columns ``known`` (k, c) as well."""
        squares, both = _products(self.rows @ known)
        return Waves(self.rows, self.squares - squares, self.both - both)

    def find_best(self, rest: Floats32) -> int:
        """Index of the wave that explains most of the squared residual ``rest`` (k,)."""
        (even, odd), (even_square, odd_square) = self.rows @ rest, self.squares
        size = even_square * odd_square - self.both * self.both
        gained = even**2 * odd_square - 2.0 * even * odd * self.both + odd**2 * even_square
        is_there = size > MIN_INDEPENDENT * len(rest) ** 2
        return int(np.where(is_there, gained / np.where(is_there, size, 1.0), 0.0).argmax())


def _products(rows: Floats32) -> tuple[Floats32, Floats32]:
    """Squared lengths (2, w) and scalar products (w,) of pairs of rows (2, w, k)."""
    return np.einsum("ijk,ijk->ij", rows, rows), np.einsum("jk,jk->j", *rows)
