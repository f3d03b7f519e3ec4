"""Bilateral operators: heights weighted by closeness and by similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.exponential import LOG2_E, exponentials, power_of_two
from msal_cli.kernels.geometry import vertex_normals
from msal_cli.kernels.operators import SMALLEST_LENGTH, SMALLEST_SIGMA, RingOperator, Step
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
    settle,
)
from msal_cli.kernels.vertex_neighbourhoods import room, vertices_around


@compiled
def _ring_bilateral(
    start,
    stop,
    x,
    normals,
    ring_start,
    ring,
    free,
    closeness,
    similarity,
    floor,
    heights,
    sigma,
    v,
    offsets,
    tau,
    constant,
    moved,
):
    """x positions, h heights, t distances of the ring, g the product of both Gaussians.

    Blocks and last arguments as in the kernel of the anisotropic Laplacian: the two Gaussians are
    one exponential.
    """
    ring_start = ring_start.view(np.uint32)
    ring = ring.view(np.uint32)
    stop = np.uint64(stop)
    widest = most_neighbours(start, stop, ring_start)
    rows = ROWS
    # As many rows again: exponents.
    apart = VECTOR * max(BLOCK_EDGES, widest)
    room = np.zeros(rows + TWO * apart)
    lanes, shifts, chosen = widest + ONE, TWO * (widest + ONE), THREE * (widest + ONE)
    table = np.zeros(chosen + BLOCK, np.uint64)
    near = 0.5 * LOG2_E / max(closeness, floor) ** 2
    largest = 0.0
    first = np.uint64(start)
    while first < stop:
        last, fewest, most = block(first, stop, ring_start, widest, rows, table)
        for i in range(first, last):
            point = THREE * i
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
                room[apart + place] = (ex * ex + ey * ey + ez * ez) * near
                place += width
        row = rows
        # Beside what ``settle`` reads: the least exponent, the factor of squares.
        scales, sums, weights, least, factors = PARTS
        for m in range(fewest, most + ONE):
            width = table[m]
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
            for _ in range(m):
                for at in range(width):
                    # The largest weight is made 1: the quotient stays the same, and is never 0/0.
                    g = power_of_two(room[least + at] - room[apart + row + at])
                    room[weights + at] += g
                    room[sums + at] += g * room[row + at]
                row += width
            scales += width
            sums += width
            weights += width
            least += width
            factors += width
        scale = settle(
            first,
            last,
            normals,
            ring_start,
            free,
            room,
            table[chosen:],
            heights,
            sigma,
            v,
            offsets,
            tau,
            constant,
            moved,
        )
        largest = max(largest, scale)
        first = last
    return largest


@dataclass(frozen=True, eq=False)
class RingBilateral(RingOperator):
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

    def _run(
        self,
        positions: Floats,
        heights: Floats,
        sigma: Floats,
        vertices: Floats,
        offsets: Floats,
        time_step: float,
        constant: float,
        moved: Floats,
    ) -> float:
        largest = over_ranges(
            _ring_bilateral,
            len(positions),
            positions.reshape(-1),
            self.normals.reshape(-1),
            self.ring_start,
            self.ring,
            self.free,
            self.closeness,
            self.similarity,
            max(SMALLEST_SIGMA * self.mean_edge_length, SMALLEST_LENGTH),
            heights,
            sigma,
            vertices.reshape(-1),
            offsets,
            time_step,
            constant,
            moved.reshape(-1),
        )
        return float(max(largest))


@compiled
def _shortest_edge(i, x, ring_start, ring, floor):
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
def _ball_bilateral(
    start, stop, x, normals, ring_start, ring, free, radius, closeness, similarity, floor, moves
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
    weighting : of the face normals in a vertex normal, as in ``kernels.geometry.vertex_normals``.
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
            *links.one_ring,
            self.free,
            self.radius,
            self.closeness,
            self.similarity,
            SMALLEST_SIGMA * self.mean_edge_length,
            moves,
        )
        return Step(moves)
