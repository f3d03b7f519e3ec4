"""Frames in which the parts of a scene stand: matrices (4, 4) that take columns."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats

_STEEPEST = 1e6
_LARGEST = 1e30
"""Larger entries of a frame could take float32 positions beyond what can be computed with."""

_IDENTITY = np.eye(4)

PLACEMENT = "placement in the scene"
"""Among the properties of a scene whose only mesh is denoised in its own frame, while the scene
turns, scales or shifts it."""


def is_usable(frame: Floats) -> bool:
    """Whether positions can be taken through a frame and back without harm."""
    try:
        with np.errstate(all="ignore"):
            is_steep = not np.linalg.cond(frame[:3, :3]) < _STEEPEST
    except np.linalg.LinAlgError:
        return False
    return not is_steep and bool(np.abs(frame).max() < _LARGEST)


def is_placed(frame: Floats) -> bool:
    """Whether a frame puts a mesh elsewhere than where its own numbers put it."""
    return not np.array_equal(frame, _IDENTITY)


def transform(points: Floats, frame: Floats) -> Floats:
    """Points (n, 3) after a transform; bit for bit the same for the identity.

    Those that are too large for it become infinite.
    """
    if not is_placed(frame):
        return points
    with np.errstate(over="ignore", invalid="ignore"):
        result: Floats = points @ frame[:3, :3].T + frame[:3, 3]
    return result
