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


MIN_STEP = 0.05
"""Mean edge lengths: shorter steps are those of the file's digits, and no noise to speak of."""

SAME = 2e-3
"""Mean edge lengths below which two depths are the same."""

FIRST_SHARE = 0.02
"""Share of the differences that may be less than a step, for other reasons."""

ON_STEP, MOSTLY = 0.02, 0.97
"""Distance from a multiple, in steps, that counts as one, and the share that has to."""

MIN_DIFFERENCES = 100

OBLIQUE = (0.05, 0.95)
"""Squared cosines to an axis between which a place is oblique to it: terraces lie there."""

MIN_OBLIQUE = 0.08
"""Share of the places that have to be, for others to be left out."""


PARALLEL = 1e-6
"""One less the cosine of the angle up to which edges have one direction."""

AT_ONCE = 32
"""Directions that are compared with all at a time: more would take memory."""

MAX_CANDIDATES, MAX_DIRECTIONS, MIN_PARALLEL = 512, 13, 0.01
"""Edges whose direction may be an axis of a turned grid; of how many directions pairs are tried,
which marching cubes have along axes and diagonals; and the share of all edges with such a one."""

ACROSS = 2e-3
"""Cosine between axes of a grid at most."""


OF_VOXELS, OF_SLICES, SAME_HEIGHT = 0.205, 0.145, 1.2
"""Root mean square distance of terraces from the surface, in heights, where they have the same
height in all directions and where not; median over ten closed shapes, the latter with slices of
three voxels.  It depends on the shape by 10 and by 40 %."""


@dataclass(frozen=True, eq=False)
class StepEvidence:
    """Steps in the differences between neighbours, whatever they come from.

    Attributes
    ----------
    n_axes : along how many axes of a grid there are steps, 0 to 3.
    axis : (3,) unit vector across the steps; None where there are none, or along all axes.
    step : the widest, mean edges; of terraces their height.  0 for none.
    level : standard deviation that such steps make, mean edges.
    voxel_share : share of the edges that marching cubes over voxels could have.
    is_turned : whether the grid is not along the axes of the file.
    along_gain : by how much the axis explains better what is left over than the normals do.
    roughness : what is left over where the surface is oblique to the steps, in squared steps / 12.
    """

    n_axes: int
    axis: Floats | None
    step: float
    level: float
    voxel_share: float
    is_turned: bool
    along_gain: float
    roughness: float


NO_STEPS = StepEvidence(0, None, 0.0, 0.0, 0.0, False, 0.0, 0.0)


def measure_steps(mesh: Mesh, survey: Survey, groups: Groups | None) -> StepEvidence:
    """The steps along the axes of the file, along those of a turned grid, or along one axis."""
    differences = _edge_vectors(mesh, survey.vertices)
    frame, is_turned = np.eye(3), False
    steps = _axis_steps(differences)
    if not any(steps):
        is_turned = True
        for frame in _find_frames(differences):
            steps = _axis_steps(differences @ frame.T)
            if all(steps):
                break
        else:
            axis = _find_step_axis(differences)
            if axis is None:
                return NO_STEPS
            frame = np.stack([axis, axis, axis])
            steps = [_step(np.abs(differences @ axis)), 0.0, 0.0]
    if all(steps):
        step = 2.0 * max(steps)
        normals = survey.normals @ frame.T
        is_even = max(steps) < SAME_HEIGHT * min(steps)
        return StepEvidence(
            n_axes=3,
            axis=None,
            step=step,
            level=(OF_VOXELS if is_even else OF_SLICES) * step,
            voxel_share=_voxel_share(differences @ frame.T, steps),
            is_turned=is_turned,
            along_gain=0.0,
            roughness=_roughness(survey, FOUR, (normals**2).max(axis=1), None, 0.5 * step),
        )
    best = int(np.argmax(steps))
    step, axis = steps[best], frame[best]
    squares = (survey.normals @ axis) ** 2
    gain = 0.0 if groups is None else groups.misfit(None) - groups.misfit(axis)
    return StepEvidence(
        n_axes=sum(step > 0.0 for step in steps),
        axis=axis,
        step=step,
        level=step / math.sqrt(12.0),
        voxel_share=0.0,
        is_turned=is_turned,
        along_gain=gain,
        roughness=_roughness(survey, THREE, squares, squares, step),
    )


def _find_step_axis(differences: Floats) -> Floats | None:
    """The direction across which many edge vectors (d, 3) lie exactly, if their parts along it come
    in steps; None where there is none."""
    lengths = np.sqrt((differences * differences).sum(axis=1))
    some = differences[lengths > SAME] / lengths[lengths > SAME, None]
    if len(some) < MIN_DIFFERENCES:
        return None
    first = some[np.linspace(0, len(some) - 2, MAX_PAIRS).astype(np.int64)]
    # Next to one another in a ring.
    second = some[np.linspace(0, len(some) - 2, MAX_PAIRS).astype(np.int64) + 1]
    across = np.cross(first, second)
    sizes = np.sqrt((across * across).sum(axis=1))
    across = across[sizes > MIN_SINE] / sizes[sizes > MIN_SINE, None]
    compared = some[:: max(len(some) // MAX_COMPARED, 1)]
    shares = (np.abs(across @ compared.T) < PARALLEL_SINE).mean(axis=1)
    for candidate in np.argsort(-shares, kind="stable")[:MAX_STEP_AXES]:
        if shares[candidate] < MIN_LEVEL_SHARE:
            return None
        if _step(np.abs(differences @ across[candidate])):
            axis: Floats = across[candidate]
            return axis
    return None


MAX_PAIRS, MAX_COMPARED, MAX_STEP_AXES = 200, 400, 4
"""Pairs of edges whose plane may be one of equal depth, edges that are compared with each, and
planes whose steps are looked at."""

MIN_SINE, PARALLEL_SINE, MIN_LEVEL_SHARE = 0.3, 1e-4, 0.05
"""Sine between the edges of such a pair, sine to the plane up to which an edge lies in it, and the
share of all edges that do."""


def _voxel_share(differences: Floats, steps: list[float]) -> float:
    """Share of the edge vectors (d, 3) whose coordinates, in steps, have an even sum.

    All have where each vertex is in the middle of an edge of the voxels, as marching cubes over
    binary voxels puts it; those of a part that is meshed on a grid have odd sums too.
    """
    counts = np.round(differences / np.array(steps)).sum(axis=1)
    return float((counts % 2.0 == 0.0).mean()) if len(counts) else 0.0


def _roughness(
    survey: Survey, fit: int, squares: Floats, scale: Floats | None, step: float
) -> float:
    """What fits leave over in squared steps / 12, where the surface is oblique to the axis."""
    variances = survey.variances[:, fit]
    has = np.isfinite(variances) & (squares > OBLIQUE[0])
    oblique = has & (squares < OBLIQUE[1])
    if oblique.mean() > MIN_OBLIQUE:
        has = oblique
    if not has.any():
        return 0.0
    ratios = variances[has] if scale is None else variances[has] / scale[has]
    return min(float(np.median(ratios)) / (step * step / 12.0), 100.0)


def _axis_steps(differences: Floats) -> list[float]:
    """The step of edge vectors (d, 3) along each axis; 0 for none."""
    return [_step(np.abs(differences[:, axis])) for axis in range(3)]


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
    some = directions[:: max(-(-len(directions) // MAX_CANDIDATES), 1)]
    shares = np.empty(len(some))
    for start in range(0, len(some), AT_ONCE):
        block = slice(start, start + AT_ONCE)
        cosines = np.abs(np.einsum("ij,kj->ik", some[block], directions))
        shares[block] = (cosines > 1.0 - PARALLEL).mean(axis=1)
    main: list[Floats] = []
    for candidate in np.argsort(-shares, kind="stable"):
        if shares[candidate] < MIN_PARALLEL or len(main) == MAX_DIRECTIONS:
            break
        if not main or (np.abs(np.array(main) @ some[candidate]) < 1.0 - SAME).all():
            main.append(some[candidate])
    return np.array(main).reshape(-1, 3)


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
    if len(some) < MIN_DIFFERENCES:
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
    return step if step > MIN_STEP and is_on.mean() > MOSTLY else 0.0
