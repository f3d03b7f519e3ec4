"""The sweep engine of equation (2): x_i <- x_i + tau dx_i + lambda_i (v_i - x_i).

Every sweep computes all of its terms from the positions that the sweep before left (Jacobi).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from msal_cli.core.compiled import compiled
from msal_cli.core.operators import Operator
from msal_cli.core.parallel import over_ranges
from msal_cli.core.schedules import Pace, Schedule
from msal_cli.dataclass import dataclass

Floats = NDArray[np.float64]

OnSweep = Callable[[int, int], None]
"""Called as ``on_sweep(done, iterations)`` after every sweep."""


@dataclass(frozen=True, eq=False)
class Swept:
    """Result of a run of sweeps.

    Attributes
    ----------
    vertices : (n, 3) final positions.
    fidelity : (n,), lambda of the first sweep (Fig. 5 of the paper).
    """

    vertices: Floats
    fidelity: Floats


@compiled
def _moved_along_normals(  # type: ignore[no-untyped-def]
    start, stop, v, normals, heights, sigma, tau, constant, per_sigma, offsets, x
):
    for i in range(start, stop):
        t = offsets[i]
        t = t + tau * heights[i] - (constant + per_sigma * sigma[i]) * t
        offsets[i] = t
        x[i, 0] = v[i, 0] + t * normals[i, 0]
        x[i, 1] = v[i, 1] + t * normals[i, 1]
        x[i, 2] = v[i, 2] + t * normals[i, 2]


@compiled
def _moved_freely(start, stop, v, moves, sigma, tau, constant, per_sigma, x):  # type: ignore[no-untyped-def]
    for i in range(start, stop):
        fidelity = constant + per_sigma * sigma[i]
        for axis in range(3):
            back = v[i, axis] - x[i, axis]
            x[i, axis] += tau * moves[i, axis] + fidelity * back


def swept(
    vertices: Floats,
    operator: Operator,
    schedule: Schedule,
    iterations: int,
    on_sweep: OnSweep | None = None,
    scale: Callable[[Floats], Floats] | None = None,
) -> Swept:
    """``iterations`` sweeps of eq. (2) from ``vertices`` (n, 3), which are not changed.

    Under an operator that moves along fixed normals n the fidelity pulls back along n too, so each
    vertex stays on the line v + t n: only t is carried from sweep to sweep, and rounding cannot
    add up to a tangential drift.

    Parameters
    ----------
    on_sweep : called after every sweep; what it raises ends the run.
    scale : gives sigma (n,) of eq. (4) at positions (n, 3), for a schedule that uses it over an
        operator that does not compute it.
    """
    n = len(vertices)
    x = vertices.copy()
    offsets = np.zeros(n)
    # Never written to: memory of zeros costs nothing until then.
    unused = np.zeros(n)
    fidelity = unused
    for sweep in range(iterations):
        step = operator(x)
        sigma = step.sigma
        if sigma is None and schedule.uses_sigma:
            if scale is None:
                raise ValueError("the schedule needs sigma, and nothing computes it")
            sigma = scale(x)
        pace: Pace = schedule(sweep, sigma)
        if sigma is None:
            sigma = unused
        if sweep == 0:
            fidelity = pace.constant + pace.per_sigma * sigma
        if operator.normals is None:
            over_ranges(
                _moved_freely,
                n,
                vertices,
                step.move,
                sigma,
                pace.time_step,
                pace.constant,
                pace.per_sigma,
                x,
            )
        else:
            over_ranges(
                _moved_along_normals,
                n,
                vertices,
                operator.normals,
                step.move,
                sigma,
                pace.time_step,
                pace.constant,
                pace.per_sigma,
                offsets,
                x,
            )
        if on_sweep is not None:
            on_sweep(sweep + 1, iterations)
    return Swept(x, fidelity)
