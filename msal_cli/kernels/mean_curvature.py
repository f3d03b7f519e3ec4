"""Mean curvature flow, x' = -grad(area) / area of the vertex, by explicit and implicit steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Flags, Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.conjugate_gradient import RowMatrix, conjugate_gradients
from msal_cli.kernels.connectivity import Connectivity
from msal_cli.kernels.cotangent import cotangent_weights, mixed_areas, ring_areas
from msal_cli.kernels.operators import Step
from msal_cli.kernels.parallel import fill_array

AREAS = ("mixed", "ring")

TOLERANCE = 1e-8
"""Of the implicit step's solution, in mean edge lengths: far below the rounding of any scan."""

MOST_ITERATIONS = 10_000
"""Of the conjugate gradients, for steps so long that they are hopeless to solve well."""


def vertex_areas(vertices: Floats, faces: Ints, links: Connectivity, areas: str) -> Floats:
    """Area of every vertex, (n,), in squared units.

    ``areas`` is ``"mixed"``: the mixed Voronoi area; or ``"ring"``: a third of the one-ring's.
    """
    if areas == "mixed":
        return mixed_areas(vertices, faces, links)
    return ring_areas(vertices, faces, links) / 3.0


@compiled
def _curvature_step(start, stop, x, weights, areas, ring_start, ring, free, time_step, moves):
    for i in range(start, stop):
        sx = sy = sz = 0.0
        total = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            weight = weights[at]
            sx += weight * (x[k, 0] - x[i, 0])
            sy += weight * (x[k, 1] - x[i, 1])
            sz += weight * (x[k, 2] - x[i, 2])
            total += abs(weight)
        share = 0.0
        if free[i] and total > 0.0:
            share = 1.0 / total
            if time_step * total < 2.0 * areas[i]:
                share = time_step / (2.0 * areas[i])
        moves[i, 0], moves[i, 1], moves[i, 2] = share * sx, share * sy, share * sz


@dataclass(frozen=True, eq=False)
class MeanCurvature:
    """min(tau, limit_i) / (2 A_i) sum(w (x_k - x_i)), w = cot alpha + cot beta, A vertex areas.

    limit_i = 2 A_i / sum|w| is the time step at which a vertex with positive weights reaches the
    weighted mean of its neighbours; beyond it the explicit iteration would overshoot.

    Attributes
    ----------
    faces : (m, 3), the faces that ``links`` were made from.
    free : (n,) bool, False for vertices that must stay.
    time_step : tau, in squared file units.
    areas : ``"mixed"`` or ``"ring"``.
    """

    faces: Ints
    links: Connectivity
    free: Flags
    time_step: float
    areas: str = "mixed"
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        """The moves (n, 3) at ``positions``, all from the same positions."""
        faces, links = self.faces, self.links
        weights = cotangent_weights(positions, faces, links)
        areas = vertex_areas(positions, faces, links, self.areas)
        rows = positions, weights, areas, *links.one_ring
        return Step(fill_array(_curvature_step, positions.shape, *rows, self.free, self.time_step))


@dataclass(frozen=True, eq=False)
class ImplicitMeanCurvature:
    """X' - X of one implicit step, (M + tau L) X' = M X, with L the cotangent stiffness matrix.

    L = grad(area) has the weights w / 2 of the input for good: the flow that keeps them has no
    singularities, where the one that measures them anew pinches thin parts off (Kazhdan, Solomon
    and Ben-Chen 2012).  M has the vertex areas, measured anew at every call.

    Attributes
    ----------
    faces : (m, 3), the faces that ``links`` were made from.
    weights : (e,), one for each entry of ``links.ring``.
    free : (n,) bool, False for vertices that must stay.
    time_step : tau, in squared file units.
    mean_edge_length : file units; sets the accuracy of the solution.
    areas : ``"mixed"`` or ``"ring"``.
    on_iteration : called after every iteration of the solver; what it raises ends the run.
    """

    faces: Ints
    links: Connectivity
    weights: Floats
    free: Flags
    time_step: float
    mean_edge_length: float
    areas: str = "mixed"
    on_iteration: Callable[[], object] | None = None
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        """The moves (n, 3) at ``positions``."""
        links = self.links
        areas = vertex_areas(positions, self.faces, links, self.areas)
        values = -0.5 * self.weights
        sums = np.zeros(len(positions))
        filled = np.diff(links.ring_start) > 0
        sums[filled] = np.add.reduceat(values, links.ring_start[:-1][filled])
        # (M / tau + L) (X' - X) = -L X: the moves have less rounding than positions would have,
        # and the matrix has no unit, so that tiny meshes cannot underflow.
        matrix = RowMatrix(areas / self.time_step - sums, *links.one_ring, values)
        right = np.empty_like(positions)
        RowMatrix(sums, *links.one_ring, -values).times(positions, right)
        on_iteration = self.on_iteration
        solution = conjugate_gradients(
            matrix,
            right,
            np.zeros_like(positions),
            tolerance=TOLERANCE,
            unit=self.mean_edge_length,
            most_iterations=MOST_ITERATIONS,
            held=~self.free,
            on_iteration=None if on_iteration is None else lambda *_: on_iteration(),
        )
        return Step(solution.values)
