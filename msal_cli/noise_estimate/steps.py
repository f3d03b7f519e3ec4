"""Depths in steps: rounding along an axis, and the terraces of surfaces out of voxels.

Differences between neighbours are multiples of one step then, exactly, and what fits leave over is
as large as the step makes it.  Both are needed: the coordinates of a regular grid stand in steps
too, and of a box on it no fit leaves anything.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from msal_cli.noise_estimate.direction import Groups
from msal_cli.noise_estimate.survey import FOUR, THREE, Survey

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]

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
"""Squared cosines to an axis between which a place is oblique to it: terraces stand there."""

FEWEST_OBLIQUE = 0.08
"""Share of the places that have to be, for others to be left out."""

ROUGH = (0.15, 40.0)
"""What is left over, in squared steps / 12, where a step is the cause: the least and the most."""

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
    """

    axis: Floats | None
    step: float
    level: float


def find_steps(mesh: Mesh, survey: Survey, groups: Groups | None) -> Steps | None:
    """Steps along a coordinate axis of the file, or along all; None where there are none."""
    differences = _edge_vectors(mesh, survey.vertices)
    steps = [_step(np.abs(differences[:, axis])) for axis in range(3)]
    if not any(steps):
        return None
    if all(steps):
        # Surfaces out of voxels have their vertices in the middle of the voxels' edges.
        step = 2.0 * max(steps)
        closest = (survey.normals**2).max(axis=1)
        if _is_rough(survey, FOUR, closest, np.ones(len(closest)), 0.5 * step):
            is_even = max(steps) < SAME_HEIGHT * min(steps)
            return Steps(None, step, (OF_VOXELS if is_even else OF_SLICES) * step)
        return None
    for axis in np.argsort(steps)[::-1]:
        squares = survey.normals[:, axis] ** 2
        if not steps[axis] or not _is_rough(survey, THREE, squares, squares, steps[axis]):
            continue
        direction = np.eye(3)[axis]
        if squares.mean() > FACING or (groups is not None and _is_along(groups, direction)):
            return Steps(direction, steps[axis], steps[axis] / math.sqrt(12.0))
    return None


def _is_along(groups: Groups, axis: Floats) -> bool:
    """Whether what fits leave over is better explained along an axis than along the normals."""
    return groups.misfit(axis) < groups.misfit(None) - LEAST_GAIN


def _edge_vectors(mesh: Mesh, vertices: NDArray[np.int64]) -> Floats:
    """From the vertices to their neighbours (d, 3), mean edges."""
    starts, ring = mesh.links.ring_start, mesh.links.ring
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
