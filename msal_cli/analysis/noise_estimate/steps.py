"""Depths in steps: rounding along an axis, and the terraces of surfaces out of voxels.

Differences between neighbours are multiples of one step then, exactly, and what fits leave over is
as large as the step makes it.  Both are needed: the coordinates of a regular grid come in steps
too, and of a box on it no fit leaves anything.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.direction import Groups
from msal_cli.analysis.noise_estimate.survey import FOUR, THREE, Survey
from msal_cli.arrays import Floats

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh


LEAST_STEP = 0.05
"""Mean edge lengths: shorter steps are those of the file's digits, and no noise to speak of."""

SAME = 2e-3
"""Mean edge lengths below which two depths are the same."""

FIRST_SHARE = 0.02
"""Share of the differences that may be less than a step, for other reasons."""

ON_STEP, MOSTLY = 0.02, 0.97
"""Distance from a multiple, in steps, that counts as one, and the share that has to."""

FEWEST_DIFFERENCES = 100

OBLIQUE = (0.05, 0.95)
"""Squared cosines to an axis between which a place is oblique to it: terraces lie there."""

FEWEST_OBLIQUE = 0.08
"""Share of the places that have to be, for others to be left out."""

ROUGH = (0.15, 40.0)
"""What is left over, in squared steps / 12, where a step is the cause: the least and the most."""

BENT = 0.05
"""Height of a vertex above the middle of its ring, mean edges, from which it is at a step."""

LEAST_TURNS, BENT_SHARE = 0.1, 0.35
"""Share of the vertices at steps that turn the rarer way, or of all that are at steps, from which
these are terraces.  Blocks with flat sides have 0 to 0.05 and 0.05 to 0.24, scans by voxels and
slices 0.2 to 0.5 and 0.19 to 0.7; of thin plates the latter only."""

PARALLEL = 1e-6
"""One less the cosine of the angle up to which edges have one direction."""

AT_ONCE = 32
"""Directions that are compared with all at a time: more would take memory."""

MOST_CANDIDATES, MOST_DIRECTIONS, LEAST_PARALLEL = 512, 13, 0.01
"""Edges whose direction may be an axis of a turned grid; of how many directions pairs are tried,
which marching cubes have along axes and diagonals; and the share of all edges with such a one."""

ACROSS = 2e-3
"""Cosine between axes of a grid at most."""

FACING = 0.6
"""Mean squared cosine to an axis with which a mesh faces it as a whole."""

LEAST_GAIN = 0.05
"""By how much an axis explains better what is left over, where it does not."""

OF_VOXELS, OF_SLICES, SAME_HEIGHT = 0.205, 0.145, 1.2
"""Root mean square distance of terraces from the surface, in heights, where they have the same
height in all directions and where not; median over ten closed shapes, the latter with slices of
three voxels.  It depends on the shape by 10 and by 40 %."""


@dataclass(frozen=True)
class Steps:
    """Depths in steps.

    Attributes
    ----------
    axis : (3,) unit vector; None for terraces in all directions.
    step : distance of the depths, or height of the terraces, mean edges.
    level : standard deviation of what is rounded, along the axis, or of the distance of terraces
        from the surface; mean edges.
    is_sure : whether nothing but what is assumed would leave them.
    """

    axis: Floats | None
    step: float
    level: float
    is_sure: bool


def find_steps(mesh: Mesh, survey: Survey, groups: Groups | None) -> Steps | None:
    """Steps along a coordinate axis of the file, or along all of a grid, which may be turned; None
    where there are none."""
    differences = _edge_vectors(mesh, survey.vertices)
    steps = _axis_steps(differences)
    if all(steps):
        is_sure = _has_voxel_edges(differences, steps)
        return _find_terraces(survey, survey.normals, steps, is_sure)
    if not any(steps):
        for frame in _find_frames(differences):
            turned = differences @ frame.T
            steps = _axis_steps(turned)
            if all(steps) and _has_voxel_edges(turned, steps):
                return _find_terraces(survey, survey.normals @ frame.T, steps, is_sure=True)
        return None
    for axis in np.argsort(steps)[::-1]:
        squares = survey.normals[:, axis] ** 2
        if not steps[axis] or not _is_rough(survey, THREE, squares, squares, steps[axis]):
            continue
        direction = np.eye(3)[axis]
        if squares.mean() > FACING or (groups is not None and _is_along(groups, direction)):
            return Steps(direction, steps[axis], steps[axis] / math.sqrt(12.0), is_sure=True)
    return None


def _find_terraces(
    survey: Survey, normals: Floats, steps: list[float], is_sure: bool
) -> Steps | None:
    """Terraces on a grid; the normals (c, 3) are in its axes."""
    # Surfaces out of voxels have their vertices in the middle of the voxels' edges.
    step = 2.0 * max(steps)
    closest = (normals**2).max(axis=1)
    everywhere = np.ones(len(closest))
    if not _is_rough(survey, FOUR, closest, everywhere, 0.5 * step):
        return None
    if not _turns_both_ways(survey):
        return None
    is_even = max(steps) < SAME_HEIGHT * min(steps)
    return Steps(None, step, (OF_VOXELS if is_even else OF_SLICES) * step, is_sure)


def _axis_steps(differences: Floats) -> list[float]:
    """The step of edge vectors (d, 3) along each axis; 0 for none."""
    return [_step(np.abs(differences[:, axis])) for axis in range(3)]


def _has_voxel_edges(differences: Floats, steps: list[float]) -> bool:
    """Whether edge vectors (d, 3) are those of marching cubes over binary voxels.

    Each vertex is in the middle of an edge of the voxels, so one of its coordinates, in steps, is
    odd and the others are even.  All edges have an even sum of steps then; those of a part that is
    meshed on a grid have odd sums too.
    """
    counts = np.round(differences / np.array(steps)).sum(axis=1)
    return bool((counts % 2.0 == 0.0).mean() > MOSTLY)


def _find_frames(differences: Floats) -> Iterator[Floats]:
    """Axes (3, 3), one a row, of turned grids that edge vectors (d, 3) may lie on: two directions
    across one another that many edges have, and the third one."""
    lengths = np.sqrt((differences * differences).sum(axis=1))
    directions = differences[lengths > SAME] / lengths[lengths > SAME, None]
    main = _main_directions(directions)
    for first, second in itertools.combinations(main, 2):
        if abs(float(first @ second)) < ACROSS:
            third = np.cross(first, second)
            third /= math.sqrt(float(third @ third))
            yield np.stack([first, np.cross(third, first), third])


def _main_directions(directions: Floats) -> Floats:
    """Those (m, 3) of the directions (d, 3) that many have, the most frequent first."""
    some = directions[:: max(-(-len(directions) // MOST_CANDIDATES), 1)]
    shares = np.empty(len(some))
    for start in range(0, len(some), AT_ONCE):
        block = slice(start, start + AT_ONCE)
        cosines = np.abs(np.einsum("ij,kj->ik", some[block], directions))
        shares[block] = (cosines > 1.0 - PARALLEL).mean(axis=1)
    main: list[Floats] = []
    for candidate in np.argsort(-shares, kind="stable"):
        if shares[candidate] < LEAST_PARALLEL or len(main) == MOST_DIRECTIONS:
            break
        if not main or (np.abs(np.array(main) @ some[candidate]) < 1.0 - SAME).all():
            main.append(some[candidate])
    return np.array(main).reshape(-1, 3)


def _turns_both_ways(survey: Survey) -> bool:
    """Whether steps go up and down, or are nearly everywhere.

    The edges of a block that is meshed on a grid look like terraces to fits, but all of them are
    convex.
    """
    heights = (survey.offsets * survey.normals).sum(axis=1)
    n_convex = int(np.count_nonzero(heights > BENT))
    n_concave = int(np.count_nonzero(heights < -BENT))
    n_bent = n_convex + n_concave
    return min(n_convex, n_concave) >= LEAST_TURNS * n_bent or n_bent >= BENT_SHARE * len(heights)


def _is_along(groups: Groups, axis: Floats) -> bool:
    """Whether what fits leave over is better explained along an axis than along the normals."""
    return groups.misfit(axis) < groups.misfit(None) - LEAST_GAIN


def _edge_vectors(mesh: Mesh, vertices: NDArray[np.int64]) -> Floats:
    """From the vertices to their neighbours (d, 3), mean edges."""
    starts, ring = mesh.topology.ring_start, mesh.topology.ring
    counts = (starts[vertices + 1] - starts[vertices]).astype(np.int64)
    ends = np.cumsum(counts)
    at = np.arange(int(ends[-1]) if len(ends) else 0)
    at += np.repeat(starts[vertices] - (ends - counts), counts)
    vectors = mesh.vertices[ring[at]] - np.repeat(mesh.vertices[vertices], counts, axis=0)
    scaled: Floats = vectors / mesh.mean_edge_length
    return scaled


def _step(differences: Floats) -> float:
    """The step of which differences without sign (d,) are multiples; 0 for none."""
    some = differences[differences > SAME]
    if len(some) < FEWEST_DIFFERENCES:
        return 0.0
    rank = int(FIRST_SHARE * len(some))
    step = float(np.partition(some, rank)[rank])
    for _ in range(3):
        multiples = np.round(some / step)
        near = (multiples > 0.0) & (np.abs(some / step - multiples) < 2.0 * ON_STEP)
        if not near.any():
            return 0.0
        step = float((multiples * some)[near].sum() / (multiples * multiples)[near].sum())
    is_on = np.abs(some / step - np.round(some / step)) < ON_STEP
    return step if step > LEAST_STEP and is_on.mean() > MOSTLY else 0.0


def _is_rough(survey: Survey, fit: int, squares: Floats, scale: Floats, step: float) -> bool:
    """Whether fits leave over what a step makes, where the surface is oblique to its axis."""
    variances = survey.variances[:, fit]
    has = np.isfinite(variances) & (squares > OBLIQUE[0])
    oblique = has & (squares < OBLIQUE[1])
    if oblique.mean() > FEWEST_OBLIQUE:
        has = oblique
    if not has.any():
        return False
    ratio = float(np.median(variances[has] / scale[has])) / (step * step / 12.0)
    return ROUGH[0] < ratio < ROUGH[1]
