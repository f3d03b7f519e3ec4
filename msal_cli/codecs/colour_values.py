"""Colours as whole numbers, and colours of faces as colours of vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints, Longs

Colours = NDArray[np.uint8]

UNPAINTED = (204, 204, 204)
"""The colour of what has none beside what has one."""


@dataclass(frozen=True, eq=False)
class SurfaceColours:
    """Colours (n, 3) of the vertices, None where there are none to show, and notes about them."""

    vertices: Colours | None = None
    notes: tuple[str, ...] = ()


def average_at_vertices(faces: Ints | Longs, colours: Floats, n_vertices: int) -> Colours:
    """(n, 3) means of ``colours`` (m, 3, 3), or (m, 1, 3) for faces of one colour, 0 to 255, over
    the corners at each vertex; vertices without a face are unpainted."""
    flat = faces.reshape(-1)
    count = np.bincount(flat, minlength=n_vertices)
    spread = np.broadcast_to(colours, (len(faces), 3, 3)).reshape(-1, 3)
    means = np.tile(np.array(UNPAINTED, dtype=np.float64), (n_vertices, 1))
    is_used = count > 0
    for k in range(3):
        sums = np.bincount(flat, weights=spread[:, k], minlength=n_vertices)
        means[is_used, k] = sums[is_used] / count[is_used]
    return to_bytes(means)


def to_bytes(colours: Floats, scale: float = 1.0) -> Colours:
    """``colours`` times ``scale`` as whole numbers from 0 to 255; 0 for what is no number."""
    scaled = np.nan_to_num(colours * scale, posinf=255.0, neginf=0.0)
    return np.rint(np.clip(scaled, 0.0, 255.0)).astype(np.uint8)
