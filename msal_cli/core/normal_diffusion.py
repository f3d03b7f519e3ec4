"""Face normals diffused across edges, the less the more an edge is bent.

A step of the heat equation on the surface, in finite volumes: each face is a cell, and what passes
between two of them is proportional to the length of their edge and to the difference of their
normals, and to one over the way between their centroids.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.exponential import LOG2_E, power_of_two
from msal_cli.core.face_rings import face_centroids
from msal_cli.core.geometry import VANISHED, face_normals_and_areas
from msal_cli.core.medians import median
from msal_cli.core.parallel import over_ranges
from msal_cli.core.ring_blocks import ONE, THREE, TWO, most_neighbours
from msal_cli.core.robust_laplacian import PER_MEDIAN

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

LONGEST = 0.75
"""Share of a normal that one step may replace by those beside it: with 1 chequered noise stays."""

LEAST_SIMILARITY = 1e-6
"""Floor of the width mu: differences of normals below it are rounding."""

BLOCK_PAIRS = np.uint64(1024)
"""Pairs of faces that are worked on at a time: what belongs to them fits a first-level cache."""


@compiled
def _shares(start, stop, x, faces, centroids, areas, ring_start, ring, time_step, shares):  # type: ignore[no-untyped-def]
    """min(tau / A, limit) l / d: edge length l, way between centroids d, own area A, 0 for none."""
    for f in range(start, stop):
        total = 0.0
        for at in range(ring_start[f], ring_start[f + 1]):
            g = ring[at]
            left = right = -1
            for corner in range(3):
                i = faces[f, corner]
                if i == faces[g, 0] or i == faces[g, 1] or i == faces[g, 2]:
                    right = left
                    left = i
            edge = way = 0.0
            for axis in range(3):
                edge += (x[left, axis] - x[right, axis]) ** 2
                way += (centroids[f, axis] - centroids[g, axis]) ** 2
            shares[at] = 0.0
            if areas[f] > 0.0 and areas[g] > 0.0 and way > 0.0:
                shares[at] = np.sqrt(edge / way)
            total += shares[at]
        step = 0.0
        if total > 0.0:
            step = LONGEST / total
            if time_step < step * areas[f]:
                step = time_step / areas[f]
        for at in range(ring_start[f], ring_start[f + 1]):
            shares[at] *= step


@compiled
def _diffused(start, stop, n, shares, inverse, ring_start, ring, result):  # type: ignore[no-untyped-def]
    """n normals, flat as the result; ``inverse`` is 1 / (2 mu^2 ln 2).

    Faces are taken in blocks: the exponents of all, then all powers as vector code, then the sums.
    All indices are unsigned, so that none is looked at for its sign.
    """
    stop = np.uint64(stop)
    weights = np.empty(np.int64(max(BLOCK_PAIRS, most_neighbours(start, stop, ring_start))))
    capacity = np.uint64(len(weights))
    f = np.uint64(start)
    while f < stop:
        first = f
        origin = np.uint64(ring_start[f])
        while f < stop and np.uint64(ring_start[f + ONE]) - origin <= capacity:
            own = THREE * f
            nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
            for at in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
                g = THREE * ring[at]
                dx, dy, dz = n[g] - nx, n[g + ONE] - ny, n[g + TWO] - nz
                weights[at - origin] = -(dx * dx + dy * dy + dz * dz) * inverse
            f += ONE
        count = np.uint64(ring_start[f]) - origin
        for at in range(count):
            weights[at] = shares[origin + at] * power_of_two(weights[at])
        for i in range(first, f):
            own = THREE * i
            nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
            sx = sy = sz = 0.0
            for at in range(np.uint64(ring_start[i]), np.uint64(ring_start[i + ONE])):
                g = THREE * ring[at]
                weight = weights[at - origin]
                sx += weight * (n[g] - nx)
                sy += weight * (n[g + ONE] - ny)
                sz += weight * (n[g + TWO] - nz)
            sx, sy, sz = nx + sx, ny + sy, nz + sz
            length = np.sqrt(sx * sx + sy * sy + sz * sz)
            if length > VANISHED:
                nx, ny, nz = sx / length, sy / length, sz / length
            result[own] = nx
            result[own + ONE] = ny
            result[own + TWO] = nz


def difference_width(normals: Floats, ring_start: Ints, ring: Ints) -> float:
    """1.4826 times the median absolute deviation of |n - m| over neighbours n, m.

    ``normals`` (m, 3), zero for faces that have none, which are left out; the rows are those of
    ``face_rings``.  Zero where there are no neighbours.
    """
    usable = (normals != 0.0).any(axis=1)
    own = np.repeat(np.arange(len(normals), dtype=np.int32), np.diff(ring_start))
    pairs = usable[own] & usable[ring]
    if not pairs.any():
        return 0.0
    lengths = np.sqrt(((normals[own[pairs]] - normals[ring[pairs]]) ** 2).sum(axis=1))
    return float(PER_MEDIAN * median(np.abs(lengths - median(lengths))))


def diffused_normals(
    vertices: Floats,
    faces: Ints,
    ring_start: Ints,
    ring: Ints,
    similarity: float,
    time_step: float,
    steps: int,
    on_step: Callable[[], object] | None = None,
) -> Floats:
    """Unit face normals (m, 3) after ``steps`` steps from those of the mesh.

    n_i <- n_i + sum(s_ij g_ij (n_j - n_i)), normalised, with g = exp(-|n_j - n_i|^2 / (2 mu^2))
    and s_ij = tau l_ij / (d_ij A_i).  A face for which the s would add up to more than 3/4 takes a
    shorter step.  Faces without area keep a zero normal and count not.

    Parameters
    ----------
    vertices, faces : (n, 3) and (m, 3).
    ring_start, ring : rows of the faces that share an edge with each, from ``face_rings``.
    similarity : mu, a pure number.
    time_step : tau, in squared file units.
    on_step : called after every step; what it raises ends the run.
    """
    count = len(faces)
    normals, areas = face_normals_and_areas(vertices, faces)
    areas[~(normals != 0.0).any(axis=1)] = 0.0
    shares = np.empty(len(ring))
    over_ranges(
        _shares,
        count,
        vertices,
        faces,
        face_centroids(vertices, faces),
        areas,
        ring_start,
        ring,
        time_step,
        shares,
    )
    inverse = 0.5 * LOG2_E / max(similarity, LEAST_SIMILARITY) ** 2
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    spare = np.empty_like(normals)
    for _ in range(steps):
        over_ranges(
            _diffused, count, normals.reshape(-1), shares, inverse, *rows, spare.reshape(-1)
        )
        normals, spare = spare, normals
        if on_step is not None:
            on_step()
    return normals
