"""Operators of equation (2): what a sweep adds to each vertex, before time step and fidelity.

An operator is called with the current positions x (n, 3) and returns a ``Step``.  One that moves
vertices along fixed normals returns heights; the sweep engine then keeps each vertex on its
normal line, so that it cannot drift tangentially.  Others return vectors.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.exponential import exponentials
from msal_cli.core.parallel import over_ranges
from msal_cli.dataclass import dataclass

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Flags = NDArray[np.bool_]

SMALLEST_SIGMA = 1e-9
"""Floor of sigma in the exponent, in mean edge lengths: far below the rounding of any scan."""

BLOCK_EDGES = 1024
"""Edges that are worked on at a time: three arrays of them fit a first-level cache of 32 KiB."""


@dataclass(frozen=True, eq=False)
class Step:
    """What one operator call found.

    Attributes
    ----------
    move : the displacement dx before time step and fidelity, file units: (n,) heights along each
        vertex's normal, or (n, 3).
    sigma : (n,), the local scale of eq. (4), file units, zero where the one-ring is planar; None
        from an operator that does not compute it.
    """

    move: Floats
    sigma: Floats | None = None


class Operator(Protocol):
    """What a sweep adds to each vertex: the dx of equation (2).

    ``normals`` are the fixed unit normals (n, 3) along which the operator moves, zeros where a
    vertex must not move; None if it moves vertices freely.
    """

    @property
    def normals(self) -> Floats | None:
        """Fixed unit normals (n, 3), or None."""
        ...

    def __call__(self, positions: Floats) -> Step:
        """The step at ``positions`` (n, 3), every vertex from these same positions."""
        ...


@compiled
def _anisotropic_laplacian(  # type: ignore[no-untyped-def]
    start, stop, x, normals, ring_start, ring, free, floor, heights, sigma
):
    """x positions, h heights of the ring over the tangent plane; Huang & Ascher, eqs. (4), (5).

    Vertices are taken in blocks whose edges fit the first-level cache: first heights and the
    exponents of all, then all exponentials, then the weighted means.
    """
    widest = 0
    for i in range(start, stop):
        widest = max(widest, ring_start[i + 1] - ring_start[i])
    capacity = max(BLOCK_EDGES, widest)
    h = np.empty(capacity)
    g = np.empty(capacity)
    scratch = np.empty(capacity)
    scratch_bits = scratch.view(np.int64)
    i = start
    while i < stop:
        first = i
        origin = ring_start[i]
        row = 0
        while i < stop and ring_start[i + 1] - origin <= capacity:
            m = ring_start[i + 1] - origin - row
            nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
            xi, yi, zi = x[i, 0], x[i, 1], x[i, 2]
            total = 0.0
            flattest = np.inf
            for at in range(m):
                k = ring[origin + row + at]
                height = (x[k, 0] - xi) * nx + (x[k, 1] - yi) * ny + (x[k, 2] - zi) * nz
                h[row + at] = height
                total += height
                square = height * height
                flattest = square if square < flattest else flattest
            mean = total / m if m else 0.0
            deviation = 0.0
            for at in range(m):
                deviation += abs(h[row + at] - mean)
            scale = 2.0 * deviation / m if m else 0.0
            sigma[i] = scale
            # The largest weight is made 1: the quotient of eq. (5) stays the same, and cannot
            # become 0/0 where sigma is tiny.  For sigma = 0 all heights equal their mean.
            scale = scale if scale > floor else floor
            inverse = 0.5 / (scale * scale)
            for at in range(m):
                g[row + at] = (flattest - h[row + at] * h[row + at]) * inverse
            row += m
            i += 1
        exponentials(g, scratch, scratch_bits, row)
        row = 0
        for j in range(first, i):
            m = ring_start[j + 1] - origin - row
            weights = 0.0
            moment = 0.0
            for at in range(m):
                weights += g[row + at]
                moment += g[row + at] * h[row + at]
            heights[j] = moment / weights if m and free[j] else 0.0
            row += m


@dataclass(frozen=True, eq=False)
class AnisotropicLaplacian:
    """The anisotropic Laplacian of Huang and Ascher, eqs. (4) and (5).

    Over the heights h of the one-ring above a vertex's tangent plane,
    sigma = 2 mean|h - mean h|, g = exp(-h^2 / (2 sigma^2)) and d = sum(g h) / sum(g).

    Attributes
    ----------
    normals : (n, 3) unit vertex normals, kept through all sweeps; a zero normal means no motion.
    ring_start, ring : the one-rings; an empty one means no motion.
    free : (n,) bool, False for vertices that must stay (they still have a sigma).
    mean_edge_length : file units; sets the floor of sigma.
    """

    normals: Floats
    ring_start: Ints
    ring: Ints
    free: Flags
    mean_edge_length: float

    def __call__(self, positions: Floats) -> Step:
        """Heights and sigma at ``positions`` (n, 3), all from the same positions."""
        n = len(positions)
        heights, sigma = np.empty(n), np.empty(n)
        over_ranges(
            _anisotropic_laplacian,
            n,
            positions,
            self.normals,
            self.ring_start,
            self.ring,
            self.free,
            max(SMALLEST_SIGMA * self.mean_edge_length, np.finfo(np.float64).tiny ** 0.5),
            heights,
            sigma,
        )
        return Step(heights, sigma)
