"""The umbrella operators: isotropic Laplacians from edges alone.

Both take the rows to average over as they come; ``averaged_ring`` makes them for a rule at open
edges.  A vertex with an empty row does not move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Floats, Ints
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.operators import Step
from msal_cli.kernels.parallel import fill_array


@compiled
def _umbrella(start, stop, x, ring_start, ring, moves):
    for i in range(start, stop):
        m = ring_start[i + 1] - ring_start[i]
        sx = sy = sz = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            sx += x[k, 0] - x[i, 0]
            sy += x[k, 1] - x[i, 1]
            sz += x[k, 2] - x[i, 2]
        share = 1.0 / m if m else 0.0
        moves[i, 0], moves[i, 1], moves[i, 2] = share * sx, share * sy, share * sz


@dataclass(frozen=True, eq=False)
class Umbrella:
    """dx_i = mean of x_k - x_i over the row of i; eq. (3) of Huang and Ascher.

    Attributes
    ----------
    ring_start, ring : rows to average over, (n + 1,) and (...,).
    """

    ring_start: Ints
    ring: Ints
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        """The moves (n, 3) at ``positions``, all from the same positions."""
        return Step(fill_array(_umbrella, positions.shape, positions, self.ring_start, self.ring))


@compiled
def _scale_dependent_umbrella(start, stop, x, ring_start, ring, time_step, moves):
    """l edge lengths of the row; edges without length have no direction and do not count."""
    for i in range(start, stop):
        sx = sy = sz = 0.0
        lengths = reciprocals = 0.0
        for at in range(ring_start[i], ring_start[i + 1]):
            k = ring[at]
            ex, ey, ez = x[k, 0] - x[i, 0], x[k, 1] - x[i, 1], x[k, 2] - x[i, 2]
            length = np.sqrt(ex * ex + ey * ey + ez * ez)
            if length > 0.0:
                sx += ex / length
                sy += ey / length
                sz += ez / length
                lengths += length
                reciprocals += 1.0 / length
        share = min(2.0 * time_step / lengths, 1.0 / reciprocals) if lengths > 0.0 else 0.0
        moves[i, 0], moves[i, 1], moves[i, 2] = share * sx, share * sy, share * sz


@dataclass(frozen=True, eq=False)
class ScaleDependentUmbrella:
    """min(tau, limit_i) times 2/E sum(e/l), E = sum(l), over edges e of length l (Fujiwara).

    limit_i = E / (2 sum(1/l)) is the time step at which the vertex reaches the mean of its
    neighbours with weights 1/l; beyond it the explicit iteration would overshoot.

    Attributes
    ----------
    ring_start, ring : rows to average over, (n + 1,) and (...,).
    time_step : tau, in squared file units.
    """

    ring_start: Ints
    ring: Ints
    time_step: float
    normals: None = None

    def __call__(self, positions: Floats) -> Step:
        """The moves (n, 3) at ``positions``, all from the same positions."""
        return Step(
            fill_array(
                _scale_dependent_umbrella,
                positions.shape,
                positions,
                self.ring_start,
                self.ring,
                self.time_step,
            )
        )
