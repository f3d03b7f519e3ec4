"""The bilateral operator over balls: heights weighted by closeness and by similarity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.elementary import exponentials
from msal_cli.kernels.geometry import vertex_normals
from msal_cli.kernels.operators import SMALLEST_SIGMA, Step
from msal_cli.kernels.parallel import fill_array
from msal_cli.kernels.vertex_neighbourhoods import room, vertices_around


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
        moves[i, 0], moves[i, 1], moves[i, 2] = height * nx, height * ny, height * nz


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
        around = positions, normals, *links.one_ring, self.free
        widths = (
            self.radius,
            self.closeness,
            self.similarity,
            SMALLEST_SIGMA * self.mean_edge_length,
        )
        return Step(fill_array(_ball_bilateral, positions.shape, *around, *widths))
