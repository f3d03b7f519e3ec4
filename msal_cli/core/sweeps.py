"""The sweep engine of equation (2): x_i <- x_i + tau dx_i + lambda_i (v_i - x_i).

Every sweep computes all of its terms from the positions that the sweep before left (Jacobi).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

from msal_cli.core.operators import Step
from msal_cli.core.parallel import over_ranges

Floats = NDArray[np.float64]

OnSweep = Callable[[int, int], None]
"""Called as ``on_sweep(done, iterations)`` after every sweep."""


class NormalOperator(Protocol):
    """An operator that moves vertices along normals that do not change."""

    @property
    def normals(self) -> Floats:
        """Unit normals (n, 3), or zeros where a vertex must not move."""
        ...

    def __call__(self, positions: Floats) -> Step:
        """The step at ``positions`` (n, 3)."""
        ...


class Schedule(Protocol):
    """Gives tau and the factor that turns sigma into lambda for a sweep."""

    def __call__(self, sweep: int, sigma: Floats) -> tuple[float, float]:
        """tau and lambda / sigma at sweep 0, 1, ..."""
        ...


@dataclass(frozen=True, eq=False)
class Swept:
    """Result of a run of sweeps.

    Attributes
    ----------
    vertices : (n, 3) final positions.
    offsets : (n,), signed distance of each vertex from its start, along its normal.
    fidelity : (n,), lambda of the first sweep (Fig. 5 of the paper).
    """

    vertices: Floats
    offsets: Floats
    fidelity: Floats


@njit(cache=True, nogil=True)
def _update(start, stop, v, normals, heights, sigma, tau, per_sigma, offsets, x):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        t = offsets[i]
        t = t + tau * heights[i] - (sigma[i] * per_sigma) * t
        offsets[i] = t
        x[i, 0] = v[i, 0] + t * normals[i, 0]
        x[i, 1] = v[i, 1] + t * normals[i, 1]
        x[i, 2] = v[i, 2] + t * normals[i, 2]


def swept(
    vertices: Floats,
    operator: NormalOperator,
    schedule: Schedule,
    iterations: int,
    on_sweep: OnSweep | None = None,
) -> Swept:
    """``iterations`` sweeps of eq. (2) from ``vertices`` (n, 3), which are not changed.

    Since the operator moves along fixed normals n and the fidelity pulls back to the start v, each
    vertex stays on the line v + t n: only t is carried from sweep to sweep, so that rounding
    cannot add up to a tangential drift.
    """
    n = len(vertices)
    x = vertices.copy()
    offsets = np.zeros(n)
    fidelity = np.zeros(n)
    for sweep in range(iterations):
        step = operator(x)
        tau, per_sigma = schedule(sweep, step.sigma)
        if sweep == 0:
            fidelity = step.sigma * per_sigma
        over_ranges(
            _update,
            n,
            vertices,
            operator.normals,
            step.heights,
            step.sigma,
            tau,
            per_sigma,
            offsets,
            x,
        )
        if on_sweep is not None:
            on_sweep(sweep + 1, iterations)
    return Swept(x, offsets, fidelity)
