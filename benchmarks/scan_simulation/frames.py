"""The frame of a scanner: its axes, and the size of its cells."""

from __future__ import annotations

import numpy as np

from benchmarks.scan_simulation.settings import ScannerSettings
from msal_cli.arrays import Floats
from msal_cli.mesh import Mesh


def build_frame(direction: Floats | tuple[float, float, float]) -> Floats:
    """Three unit vectors (3, 3), one a row, at right angles, the third along ``direction``.

    For the z axis they are the axes themselves.
    """
    third = np.asarray(direction, dtype=np.float64)
    third = third / np.abs(third).max()
    third = third / np.sqrt((third * third).sum())
    guess = np.array([1.0, 0.0, 0.0] if abs(third[0]) < 0.9 else [0.0, 1.0, 0.0])
    first = guess - (guess * third).sum() * third
    first /= np.sqrt((first * first).sum())
    return np.stack([first, np.cross(third, first), third])


def turn(vertices: Floats, frame: Floats) -> Floats:
    """Coordinates (n, 3) in the frame; summed in one order, whatever library multiplies."""
    return np.stack([(vertices * axis).sum(axis=1) for axis in frame], axis=1)


def turn_back(vertices: Floats, frame: Floats) -> Floats:
    """Positions (n, 3) for coordinates in the frame."""
    positions: Floats = (
        vertices[:, :1] * frame[0] + vertices[:, 1:2] * frame[1] + vertices[:, 2:] * frame[2]
    )
    return positions


def cell_length(mesh: Mesh, settings: ScannerSettings) -> float:
    """Edge of a cell, file units."""
    if settings.cell_edges is not None:
        return settings.cell_edges * mesh.mean_edge_length
    used = mesh.vertices[mesh.topology.has_ring]
    return float(np.ptp(used, axis=0).max()) / settings.cells
