"""Bilateral operators: heights weighted by closeness and by similarity."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.connectivity import Connectivity
from msal_cli.core.exponential import BLOCK, exponentials
from msal_cli.core.geometry import vertex_normals
from msal_cli.core.operators import SMALLEST_SIGMA, Step
from msal_cli.core.parallel import over_ranges
from msal_cli.core.reach import room, vertices_around
from msal_cli.dataclass import dataclass

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Flags = NDArray[np.bool_]


@compiled
def _ring_bilateral(  # type: ignore[no-untyped-def]
    start, stop, x, normals, ring_start, ring, free, closeness, similarity, floor, heights, sigma
):
    """x positions, h heights, t distances of the ring, g the product of both Gaussians.

    Blocks as in the kernel of the anisotropic Laplacian: the two Gaussians are one exponential.
    """
    widest = 0
    for i in range(start, stop):
        widest = max(widest, ring_start[i + 1] - ring_start[i])
    capacity = max(BLOCK, widest)
    h = np.empty(capacity)
    g = np.empty(capacity)
    scratch = np.empty(capacity)
    scratch_bits = scratch.view(np.int64)
    near = 0.5 / max(closeness, floor) ** 2
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
            for at in range(m):
                k = ring[origin + row + at]
                ex, ey, ez = x[k, 0] - xi, x[k, 1] - yi, x[k, 2] - zi
                height = ex * nx + ey * ny + ez * nz
                h[row + at] = height
                g[row + at] = (ex * ex + ey * ey + ez * ez) * near
                total += height
            mean = total / m if m else 0.0
            deviation = variance = 0.0
            for at in range(m):
                offset = h[row + at] - mean
                deviation += abs(offset)
                variance += offset * offset
            sigma[i] = 2.0 * deviation / m if m else 0.0
            scale = similarity
            if scale == 0.0 and m:
                scale = np.sqrt(variance / m)
            scale = scale if scale > floor else floor
            alike = 0.5 / (scale * scale)
            least = np.inf
            for at in range(m):
                exponent = g[row + at] + h[row + at] * h[row + at] * alike
                g[row + at] = exponent
                least = exponent if exponent < least else least
            # The largest weight is made 1: the quotient stays the same, and is never 0/0.
            for at in range(m):
                g[row + at] = least - g[row + at]
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
class RingBilateral:
    """d = sum(w h) / sum(w) over the one-ring, w = exp(-t^2 / 2 sigma_c^2 - h^2 / 2 sigma_s^2).

    h are the heights of the neighbours over a vertex's tangent plane and t their distances; the
    variant that Huang and Ascher call "our BF" (section 2.3).

    Attributes
    ----------
    normals : (n, 3) unit vertex normals, kept through all sweeps; a zero normal means no motion.
    ring_start, ring : the one-rings; an empty one means no motion.
    free : (n,) bool, False for vertices that must stay (they still have a sigma).
    mean_edge_length : file units; sets the floor of sigma_c and sigma_s.
    closeness : sigma_c, file units.
    similarity : sigma_s, file units; 0 takes the standard deviation of the heights of each ring.
    """

    normals: Floats
    ring_start: Ints
    ring: Ints
    free: Flags
    mean_edge_length: float
    closeness: float
    similarity: float = 0.0

    def __call__(self, positions: Floats) -> Step:
        """Heights, and sigma of eq. (4), at ``positions`` (n, 3), all from the same positions."""
        n = len(positions)
        heights, sigma = np.empty(n), np.empty(n)
        over_ranges(
            _ring_bilateral,
            n,
            positions,
            self.normals,
            self.ring_start,
            self.ring,
            self.free,
            self.closeness,
            self.similarity,
            SMALLEST_SIGMA * self.mean_edge_length,
            heights,
            sigma,
        )
        return Step(heights, sigma)


@compiled
def _shortest_edge(i, x, ring_start, ring, floor):  # type: ignore[no-untyped-def]
    """Length of the shortest edge at i that is longer than the floor; 0 if none is."""
    shortest = np.inf
    for at in range(ring_start[i], ring_start[i + 1]):
        k = ring[at]
        dx, dy, dz = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
        square = dx * dx + dy * dy + dz * dz
        if square > floor * floor:
            shortest = min(shortest, square)
    return np.sqrt(shortest) if shortest < np.inf else 0.0


@compiled
def _ball_bilateral(  # type: ignore[no-untyped-def]
    start,
    stop,
    x,
    normals,
    ring_start,
    ring,
    free,
    radius,
    closeness,
    similarity,
    floor,
    moves,
):
    """x positions, h heights, t distances of the neighbourhood, g the product of both Gaussians."""
    capacity = room(start, stop, ring_start)
    mark = np.full(len(ring_start) - 1, -1, dtype=np.int32)
    found = np.empty(capacity, dtype=np.int32)
    squares = np.empty(capacity)
    h = np.empty(capacity)
    g = np.empty(capacity)
    scratch = np.empty(capacity)
    scratch_bits = scratch.view(np.int64)
    for i in range(start, stop):
        moves[i, 0] = moves[i, 1] = moves[i, 2] = 0.0
        if not free[i]:
            continue
        width = closeness
        if width == 0.0:
            width = _shortest_edge(i, x, ring_start, ring, floor)
        width = max(width, floor)
        reach = radius if radius > 0.0 else 2.0 * width
        count = vertices_around(i, x, ring_start, ring, reach * reach, mark, found, squares)
        nx, ny, nz = normals[i, 0], normals[i, 1], normals[i, 2]
        mean = 0.0
        for at in range(count):
            k = found[at]
            ex, ey, ez = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
            h[at] = ex * nx + ey * ny + ez * nz
            mean += abs(h[at])
        scale = similarity
        if scale == 0.0:
            mean /= count
            variance = 0.0
            for at in range(count):
                offset = abs(h[at]) - mean
                variance += offset * offset
            scale = np.sqrt(variance / count)
        scale = max(scale, floor)
        near = 0.5 / (width * width)
        alike = 0.5 / (scale * scale)
        # The vertex itself, at height and distance 0, has weight 1: the sum cannot vanish.
        for at in range(count):
            g[at] = -(squares[at] * near) - h[at] * h[at] * alike
        exponentials(g, scratch, scratch_bits, count)
        weights = moment = 0.0
        for at in range(count):
            weights += g[at]
            moment += g[at] * h[at]
        height = moment / weights
        moves[i, 0] = height * nx
        moves[i, 1] = height * ny
        moves[i, 2] = height * nz


@dataclass(frozen=True, eq=False)
class BallBilateral:
    """d n with d = sum(w h) / sum(w) over a ball, and n the normals of the current positions.

    w = exp(-t^2 / 2 sigma_c^2 - h^2 / 2 sigma_s^2) with h the heights over the tangent plane and t
    the distances of the vertices, the vertex itself among them, that edges join to it within
    ``radius`` (Fleishman, Drori and Cohen-Or 2003).

    Attributes
    ----------
    faces, links : (m, 3) and its neighbourhoods.
    free : (n,) bool, False for vertices that must stay.
    mean_edge_length : file units; sets the floor of sigma_c and sigma_s.
    radius : file units; 0 takes 2 sigma_c.
    closeness : sigma_c, file units; 0 takes the length of each vertex's shortest edge.
    similarity : sigma_s, file units; 0 takes the standard deviation of |h| in each neighbourhood.
    weighting : of the face normals in a vertex normal, as in ``core.geometry.vertex_normals``.
    """

    faces: Ints
    links: Connectivity
    free: Flags
    mean_edge_length: float
    radius: float = 0.0
    closeness: float = 0.0
    similarity: float = 0.0
    weighting: str = "uniform"
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        """The moves (n, 3) at ``positions``, all from the same positions."""
        links = self.links
        normals = vertex_normals(positions, self.faces, self.weighting)
        moves = np.empty_like(positions)
        over_ranges(
            _ball_bilateral,
            len(positions),
            positions,
            normals,
            links.ring_start,
            links.ring,
            self.free,
            self.radius,
            self.closeness,
            self.similarity,
            SMALLEST_SIGMA * self.mean_edge_length,
            moves,
        )
        return Step(moves)
