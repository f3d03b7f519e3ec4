"""Face normals diffused across edges, the less the more an edge is bent.

A step of the heat equation on the surface, in finite volumes: each face is a cell, and what passes
between two of them is proportional to the length of their edge and to the difference of their
normals, and to one over the way between their centroids.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.elementary import LOG2_E, power_of_two
from msal_cli.kernels.geometry import VANISHED, face_normals_and_areas, usable_areas
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.quantiles import median
from msal_cli.kernels.ring_blocks import ONE, THREE, TWO, most_neighbours
from msal_cli.kernels.robust_laplacian import PER_MEDIAN
from msal_cli.kernels.vectors import write_unit

LONGEST = 0.75
"""Share of a normal that one step may replace by those beside it: with 1 chequered noise stays."""

LEAST_SIMILARITY = 1e-6
"""Floor of the width mu: differences of normals below it are rounding."""

BLOCK_PAIRS = np.uint64(1024)
"""Pairs of faces that are worked on at a time: what belongs to them fits a first-level cache."""


@compiled
def _square(x, i, j):
    """Of the distance between two vertices; x flat."""
    p, q = THREE * i, THREE * j
    dx, dy, dz = x[p] - x[q], x[p + ONE] - x[q + ONE], x[p + TWO] - x[q + TWO]
    return dx * dx + dy * dy + dz * dz


@compiled
def _shares(start, stop, x, faces, areas, ring_start, ring, time_step, shares):
    """min(tau / A, limit) l / d: edge length l, way between centroids d, own area A, 0 for none.

    All arrays are flat; x positions.  Of two faces with a common edge the centroids are a third
    as far apart as the corners that are off it.
    """
    for f in range(np.uint64(start), np.uint64(stop)):
        p = THREE * f
        a, b, c = np.uint64(faces[p]), np.uint64(faces[p + ONE]), np.uint64(faces[p + TWO])
        row, end = np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])
        total = 0.0
        for at in range(row, end):
            g = np.uint64(ring[at])
            q = THREE * g
            i, j, k = np.uint64(faces[q]), np.uint64(faces[q + ONE]), np.uint64(faces[q + TWO])
            # Without branches: where in the faces their edge is cannot be predicted.
            has_b = (b == i) | (b == j) | (b == k)
            has_c = (c == i) | (c == j) | (c == k)
            left = c if has_c else b
            right = b if has_b & has_c else a
            apex = a if has_b & has_c else (b if has_c else c)
            edge = _square(x, left, right)
            way = _square(x, apex, i + j + k - left - right) / 9.0
            share = np.sqrt(edge / way)
            counts = (areas[f] > 0.0) & (areas[g] > 0.0) & (way > 0.0)
            share = share if counts else 0.0
            shares[at] = share
            total += share
        step = 0.0
        if total > 0.0:
            step = LONGEST / total
            if time_step < step * areas[f]:
                step = time_step / areas[f]
        for at in range(row, end):
            shares[at] *= step


@compiled
def _diffuse(start, stop, n, shares, inverse, ring_start, ring, result):
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
            write_unit(sx, sy, sz, VANISHED, n, i, result)


@compiled
def _differences(start, stop, n, ring_start, ring, lengths):
    """|n - m| over the neighbours of greater number, -1 for all that do not count; n flat."""
    for f in range(np.uint64(start), np.uint64(stop)):
        own = THREE * f
        nx, ny, nz = n[own], n[own + ONE], n[own + TWO]
        is_usable = (nx != 0.0) | (ny != 0.0) | (nz != 0.0)
        for at in range(np.uint64(ring_start[f]), np.uint64(ring_start[f + ONE])):
            g = THREE * ring[at]
            mx, my, mz = n[g], n[g + ONE], n[g + TWO]
            dx, dy, dz = mx - nx, my - ny, mz - nz
            length = np.sqrt(dx * dx + dy * dy + dz * dz)
            counts = is_usable & ((mx != 0.0) | (my != 0.0) | (mz != 0.0)) & (g > own)
            lengths[at] = length if counts else -1.0


def difference_width(normals: Floats, ring_start: Ints, ring: Ints) -> float:
    """1.4826 times the median absolute deviation of |n - m| over neighbours n, m.

    ``normals`` (m, 3), zero for faces that have none, which are left out; the rows are those of
    ``face_rings``.  Zero where there are no neighbours.
    """
    lengths = np.empty(len(ring))
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    over_ranges(_differences, len(normals), normals.reshape(-1), *rows, lengths)
    lengths = lengths[lengths >= 0.0]
    if not len(lengths):
        return 0.0
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
    areas = usable_areas(normals, areas)
    rows = ring_start.view(np.uint32), ring.view(np.uint32)
    corners = faces.reshape(-1).view(np.uint32)
    shares = np.empty(len(ring))
    over_ranges(_shares, count, vertices.reshape(-1), corners, areas, *rows, time_step, shares)
    inverse = 0.5 * LOG2_E / max(similarity, LEAST_SIMILARITY) ** 2
    spare = np.empty_like(normals)
    for _ in range(steps):
        flat = normals.reshape(-1), shares, inverse, *rows, spare.reshape(-1)
        over_ranges(_diffuse, count, *flat)
        normals, spare = spare, normals
        if on_step is not None:
            on_step()
    return normals
