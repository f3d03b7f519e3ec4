"""Operators of equation (2): what a sweep adds to each vertex, before time step and fidelity.

An operator is called with the current positions x (n, 3) and returns a ``Step``.  One that moves
vertices along fixed normals returns heights; the sweep engine then keeps each vertex on its
normal line, so that it cannot drift tangentially.  Others return vectors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.elementary import LOG2_E, power_of_two
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.ring_blocks import (
    BLOCK,
    BLOCK_EDGES,
    ONE,
    PARTS,
    ROWS,
    THREE,
    TWO,
    VECTOR,
    block,
    most_neighbours,
)

SMALLEST_SIGMA = 1e-9
"""Floor of sigma in the exponent, in mean edge lengths: far below the rounding of any scan."""

SMALLEST_LENGTH = np.finfo(np.float64).tiny ** 0.5
"""Its square is still a number: the floor on a mesh of no size."""


@dataclass(frozen=True, eq=False)
class Step:
    """What one operator call found.

    Attributes
    ----------
    move : the displacement dx before time step and fidelity, file units: (n,) heights along each
        vertex's normal, or (n, 3).
    sigma : (n,), the local scale of eq. (4), file units, zero where the one-ring is planar; None
        from an operator that does not compute it.
    largest_sigma : its maximum, where it was found on the way.
    """

    move: Floats
    sigma: Floats | None = None
    largest_sigma: float | None = None


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
def _filter_rings(
    start,
    stop,
    x,
    normals,
    ring_start,
    ring,
    free,
    floor,
    closeness,
    similarity,
    heights,
    sigma,
    v,
    offsets,
    tau,
    constant,
    moved,
):
    """x positions, h heights of the ring over the tangent plane; Huang & Ascher, eqs. (4), (5).

    Points are flat, three numbers each.  With a ``closeness`` the weight g is a product of two
    Gaussians, which are one exponential; without it (0) it is that of eq. (5).  Without ``moved``
    it writes heights and sigma and returns the largest sigma; with it, it makes the whole sweep:
    new offsets t, and v + t n into ``moved``.
    """
    ring_start, ring = ring_start.view(np.uint32), ring.view(np.uint32)
    stop = np.uint64(stop)
    widest = most_neighbours(start, stop, ring_start)
    is_bilateral = closeness > 0.0
    # As many rows again as heights: exponents by distance.
    apart = VECTOR * max(BLOCK_EDGES, widest)
    room = np.zeros(ROWS + (TWO * apart if is_bilateral else apart))
    lanes, shifts, chosen = widest + ONE, TWO * (widest + ONE), THREE * (widest + ONE)
    table = np.zeros(chosen + BLOCK, np.uint64)
    near = 0.5 * LOG2_E / max(closeness, floor) ** 2
    largest = 0.0
    first = np.uint64(start)
    while first < stop:
        last, fewest, most = block(first, stop, ring_start, widest, ROWS, table)
        for i in range(first, last):
            point = THREE * i
            # The signs of both factors are turned, so that x_k is loaded as it is subtracted.
            nx, ny, nz = -normals[point], -normals[point + ONE], -normals[point + TWO]
            xi, yi, zi = x[point], x[point + ONE], x[point + TWO]
            edge = np.uint64(ring_start[i])
            m = ring_start[i + ONE] - edge
            lane = table[lanes + m]
            table[lanes + m] = lane + ONE
            table[chosen + i - first] = lane
            place = lane + table[shifts + m]
            width = table[m]
            for e in range(edge, edge + m):
                k = THREE * ring[e]
                ex, ey, ez = xi - x[k], yi - x[k + ONE], zi - x[k + TWO]
                room[place] = ex * nx + ey * ny + ez * nz
                if is_bilateral:
                    room[apart + place] = (ex * ex + ey * ey + ez * ez) * near
                place += width
        row = ROWS
        scales, sums, weights, least, factors = PARTS
        for m in range(fewest, most + ONE):
            width = table[m]
            if is_bilateral:
                # Exponents by distance are added to those by height.
                for at in range(width):
                    room[least + at] = np.inf
                    room[scales + at] = 0.0
                    room[sums + at] = 0.0
                    room[weights + at] = 0.0
                    room[factors + at] = 0.0
                place = row
                for _ in range(m):
                    for at in range(width):
                        room[sums + at] += room[place + at]
                    place += width
                for at in range(width):
                    room[sums + at] /= max(m, ONE)
                place = row
                for _ in range(m):
                    for at in range(width):
                        offset = room[place + at] - room[sums + at]
                        room[scales + at] += abs(offset)
                        room[factors + at] += offset * offset
                    place += width
                for at in range(width):
                    room[scales + at] = 2.0 * room[scales + at] / max(m, ONE)
                    scale = np.sqrt(room[factors + at] / max(m, ONE))
                    scale = scale if similarity == 0.0 else similarity
                    scale = scale if scale > floor else floor
                    room[factors + at] = 0.5 * LOG2_E / (scale * scale)
                    room[sums + at] = 0.0
                place = row
                for _ in range(m):
                    for at in range(width):
                        h = room[place + at]
                        exponent = room[apart + place + at] + h * h * room[factors + at]
                        room[apart + place + at] = exponent
                        room[least + at] = min(room[least + at], exponent)
                    place += width
                place = row
                for _ in range(m):
                    for at in range(width):
                        g = power_of_two(room[least + at] - room[apart + place + at])
                        room[weights + at] += g
                        room[sums + at] += g * room[place + at]
                    place += width
                row += m * width
            else:
                for at in range(width):
                    room[least + at] = np.inf
                    room[scales + at] = 0.0
                    room[sums + at] = 0.0
                    room[weights + at] = 0.0
                place = row
                for _ in range(m):
                    for at in range(width):
                        h = room[place + at]
                        room[sums + at] += h
                        room[least + at] = min(room[least + at], h * h)
                    place += width
                for at in range(width):
                    room[sums + at] /= max(m, ONE)
                place = row
                for _ in range(m):
                    for at in range(width):
                        room[scales + at] += abs(room[place + at] - room[sums + at])
                    place += width
                for at in range(width):
                    scale = 2.0 * room[scales + at] / max(m, ONE)
                    room[scales + at] = scale
                    scale = scale if scale > floor else floor
                    room[factors + at] = 0.5 * LOG2_E / (scale * scale)
                    room[sums + at] = 0.0
                for _ in range(m):
                    for at in range(width):
                        h = room[row + at]
                        # The largest weight is made 1: the quotient of eq. (5) stays the same,
                        # and cannot become 0/0 where sigma is tiny.
                        g = power_of_two((room[least + at] - h * h) * room[factors + at])
                        room[weights + at] += g
                        room[sums + at] += g * h
                    row += width
            scales += width
            sums += width
            weights += width
            least += width
            factors += width
        scales, sums, weights = PARTS[0], PARTS[1], PARTS[2]
        for i in range(first, last):
            lane = table[chosen + i - first]
            moves = free[i] and ring_start[i + ONE] > ring_start[i]
            height = room[sums + lane] / room[weights + lane] if moves else 0.0
            if len(moved):
                t = offsets[i]
                t = t + tau * height - constant * t
                offsets[i] = t
                point = THREE * i
                moved[point] = v[point] + t * normals[point]
                moved[point + ONE] = v[point + ONE] + t * normals[point + ONE]
                moved[point + TWO] = v[point + TWO] + t * normals[point + TWO]
            else:
                heights[i] = height
                sigma[i] = room[scales + lane]
                largest = max(largest, room[scales + lane])
        first = last
    return largest


@dataclass(frozen=True, eq=False)
class RingOperator:
    """What operators along fixed normals over one-rings share: a sweep with no arrays of its own.

    Attributes
    ----------
    normals : (n, 3) unit vertex normals, kept through all sweeps; a zero normal means no motion.
    ring_start, ring : the one-rings; an empty one means no motion.
    free : (n,) bool, False for vertices that must stay (they still have a sigma).
    mean_edge_length : file units; sets the floor of sigma and of widths.
    closeness, similarity : see ``RingBilateral``.
    """

    normals: Floats
    ring_start: Ints
    ring: Ints
    free: Flags
    mean_edge_length: float
    closeness: float = 0.0
    similarity: float = 0.0

    def __call__(self, positions: Floats) -> Step:
        """Heights and sigma at ``positions`` (n, 3), all from the same positions."""
        heights, sigma = np.empty(len(positions)), np.empty(len(positions))
        return Step(heights, sigma, self.measure(positions, heights, sigma))

    def measure(self, positions: Floats, heights: Floats, sigma: Floats) -> float:
        """Write heights (n,) and sigma (n,) at ``positions`` (n, 3); returns the largest sigma."""
        none = np.empty(0)
        return self._run(positions, heights, sigma, none, none, 0.0, 0.0, none)

    def advance(
        self,
        vertices: Floats,
        positions: Floats,
        offsets: Floats,
        time_step: float,
        constant: float,
        moved: Floats,
    ) -> None:
        """A whole sweep in one pass, with the same lambda for all: v + t n into ``moved`` (n, 3).

        ``vertices`` are v, ``positions`` where they are now, both (n, 3); ``offsets`` t (n,) are
        changed.  ``moved`` shares no memory with the others.
        """
        none, v = np.empty(0), vertices.reshape(-1)
        self._run(positions, none, none, v, offsets, time_step, constant, moved.reshape(-1))

    def _run(self, positions: Floats, *outcome: Floats | float) -> float:
        floor = max(SMALLEST_SIGMA * self.mean_edge_length, SMALLEST_LENGTH)
        widths = floor, self.closeness, self.similarity
        rings = self.normals.reshape(-1), self.ring_start, self.ring, self.free
        flat = positions.reshape(-1)
        return float(
            max(over_ranges(_filter_rings, len(positions), flat, *rings, *widths, *outcome))
        )


class AnisotropicLaplacian(RingOperator):
    """The anisotropic Laplacian of Huang and Ascher, eqs. (4) and (5).

    Over the heights h of the one-ring above a vertex's tangent plane,
    sigma = 2 mean|h - mean h|, g = exp(-h^2 / (2 sigma^2)) and d = sum(g h) / sum(g).
    """


class RingBilateral(RingOperator):
    """d = sum(w h) / sum(w) over the one-ring, w = exp(-t^2 / 2 sigma_c^2 - h^2 / 2 sigma_s^2).

    h are the heights of the neighbours over a vertex's tangent plane and t their distances; the
    variant that Huang and Ascher call "our BF" (section 2.3).  ``closeness`` is sigma_c > 0, and
    ``similarity`` sigma_s, file units; 0 takes the standard deviation of the heights of each ring.
    """
