"""Schedules of equation (2): the time step and the fidelity to the data at each sweep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Plain:
    """The same time step tau at every sweep and no fidelity, lambda = 0 (section 2)."""

    time_step: float = 1.0

    def __call__(self, sweep: int, sigma: Floats) -> tuple[float, float]:
        """tau, and the factor that makes lambda of sigma."""
        return self.time_step, 0.0


@dataclass(frozen=True)
class Multiscale:
    """tau = K^j (eq. 6) and lambda = sigma / max sigma (eq. 7), anew at every sweep j = 0, 1, ...

    With ``decay`` K below 1 later sweeps smooth less, the sooner the smaller K is.  On a mesh with
    sigma = 0 everywhere lambda is zero.
    """

    decay: float = 0.5

    def __call__(self, sweep: int, sigma: Floats) -> tuple[float, float]:
        """tau, and the factor that makes lambda of sigma: 1 / max sigma."""
        largest = float(sigma.max(initial=0.0))
        return self.decay**sweep, 1.0 / largest if largest > 0.0 else 0.0
