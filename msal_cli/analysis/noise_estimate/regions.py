"""Regions of a mesh, each as far from the others as can be."""

from __future__ import annotations

import numpy as np

from msal_cli.arrays import Floats, Longs

VERTICES_PER_REGION = 800
MOST_REGIONS = 16

BLOCK_VERTICES = 1 << 14
"""Vertices whose distances to all regions are in memory at a time."""


def count_regions(n_vertices: int) -> int:
    """Into how many regions a mesh is split."""
    return min(max(n_vertices // VERTICES_PER_REGION, 1), MOST_REGIONS)


def split_regions(vertices: Floats, count: int) -> tuple[Longs, Longs]:
    """Which of the vertices (c, 3) are middles of ``count`` regions, each as far from the others as
    can be; and which middle is the nearest to each vertex (c,)."""
    axes = np.ascontiguousarray(vertices.T)
    # The first one is the furthest from where they are on average.
    distances = _squared_distances(axes, axes.mean(axis=1))
    middles = np.empty(count, dtype=np.int64)
    labels = np.zeros(len(vertices), dtype=np.int64)
    for number in range(count):
        middles[number] = distances.argmax()
        from_it = _squared_distances(axes, vertices[middles[number]])
        if number == 0:
            distances = from_it
            continue
        labels[from_it < distances] = number
        np.minimum(distances, from_it, out=distances)
    return middles, labels


def find_nearest(vertices: Floats, middles: Floats) -> Longs:
    """Which of the middles (r, 3) is the nearest to each of the vertices (n, 3)."""
    nearest = np.empty(len(vertices), dtype=np.int64)
    for first in range(0, len(vertices), BLOCK_VERTICES):
        axes = np.ascontiguousarray(vertices[first : first + BLOCK_VERTICES].T)
        distances = [_squared_distances(axes, middle) for middle in middles]
        nearest[first : first + BLOCK_VERTICES] = np.argmin(distances, axis=0)
    return nearest


def _squared_distances(axes: Floats, point: Floats) -> Floats:
    """Of positions, an axis a row (3, n), from a point (3,)."""
    x, y, z = axes[0] - point[0], axes[1] - point[1], axes[2] - point[2]
    distances: Floats = x * x + y * y + z * z
    return distances
