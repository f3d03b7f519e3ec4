"""The sweep engine of equation (2): x_i <- x_i + tau dx_i + lambda_i (v_i - x_i).

Every sweep computes all of its terms from the positions that the sweep before left (Jacobi).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.kernels.compiled import compiled
from msal_cli.kernels.operators import Operator, RingOperator
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.quantiles import quantile_above_zero
from msal_cli.kernels.schedules import Pace, Schedule

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
def _moved_along_normals(
    start, stop, v, normals, heights, sigma, tau, constant, per_sigma, offsets, fidelity, x
):
    for i in range(start, stop):
        pull = min(constant + per_sigma * sigma[i], 1.0)
        if len(fidelity):
            fidelity[i] = pull
        t = offsets[i]
        t = t + tau * heights[i] - pull * t
        offsets[i] = t
        x[i, 0] = v[i, 0] + t * normals[i, 0]
        x[i, 1] = v[i, 1] + t * normals[i, 1]
        x[i, 2] = v[i, 2] + t * normals[i, 2]


@compiled
def _moved_freely(start, stop, v, moves, sigma, tau, constant, per_sigma, x):
    for i in range(start, stop):
        fidelity = min(constant + per_sigma * sigma[i], 1.0)
        for axis in range(3):
            back = v[i, axis] - x[i, axis]
            x[i, axis] += tau * moves[i, axis] + fidelity * back


def run_sweeps(
    vertices: Floats,
    operator: Operator,
    schedule: Schedule,
    iterations: int,
    on_sweep: OnSweep | None = None,
    scale: Callable[[Floats], Floats] | None = None,
    trust: Floats | None = None,
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
    trust : (n,) from 0 to 1, the part of lambda that each vertex gets; None for all of it.
    """
    if isinstance(operator, RingOperator) and iterations:
        return _swept_over_rings(vertices, operator, schedule, iterations, on_sweep, trust)
    n = len(vertices)
    x = vertices.copy()
    offsets = np.zeros(n)
    # Never written to: memory of zeros costs nothing until then.
    unused = np.zeros(n)
    fidelity = unused
    for sweep in range(iterations):
        step = operator(x)
        move, sigma = step.move, step.sigma
        if schedule.quantile is not None and sigma is None:
            if scale is None:
                raise ValueError("the schedule needs sigma, and nothing computes it")
            sigma = scale(x)
        pace: Pace = _pace(schedule, sweep, sigma, step.largest_sigma)
        if sigma is None:
            sigma = unused
        if trust is not None:
            pace, sigma = _trust(pace, sigma, trust)
        if sweep == 0:
            fidelity = _pulls(pace, sigma)
        if operator.normals is None:
            over_ranges(_moved_freely, n, vertices, move, sigma, *pace, x)
        else:
            known = vertices, operator.normals, move, sigma, *pace
            over_ranges(_moved_along_normals, n, *known, offsets, np.empty(0), x)
        if on_sweep is not None:
            on_sweep(sweep + 1, iterations)
    return Swept(x, fidelity)


def _pace(schedule: Schedule, sweep: int, sigma: Floats | None, largest: float | None) -> Pace:
    """The pace of a sweep; ``largest`` is max sigma, where it is known."""
    share = schedule.quantile
    if sigma is None or share is None:
        return schedule(sweep, None)
    if share == 1.0:
        return schedule(sweep, float(sigma.max(initial=0.0)) if largest is None else largest)
    return schedule(sweep, quantile_above_zero(sigma, share))


def _pulls(pace: Pace, sigma: Floats) -> Floats:
    """lambda (n,)."""
    pulls: Floats = np.minimum(pace.constant + pace.per_sigma * sigma, 1.0)
    return pulls


def _trust(pace: Pace, sigma: Floats, trust: Floats) -> tuple[Pace, Floats]:
    """The pace, and what replaces sigma, by which lambda_i is ``trust`` (n,) times what it
    would be: the kernels need not know of it."""
    pulls: Floats = trust * _pulls(pace, sigma)
    return Pace(pace.time_step, per_sigma=1.0), pulls


def _swept_over_rings(
    vertices: Floats,
    operator: RingOperator,
    schedule: Schedule,
    iterations: int,
    on_sweep: OnSweep | None,
    trust: Floats | None,
) -> Swept:
    """The same, with no arrays made anew for every sweep, and as few passes as can be.

    Without sigma a sweep is one pass, from one array of positions to another.  lambda by sigma
    needs the largest one, which is known only when every vertex has been looked at: then
    heights and sigma are kept, and a second pass moves.  So it is with a lambda by trust.
    """
    is_measured = schedule.quantile is not None or trust is not None
    n = len(vertices)
    assert operator.normals is not None
    offsets, fidelity, none = np.zeros(n), np.zeros(n), np.empty(0)
    x, moved = vertices, np.empty_like(vertices)
    heights, sigma = (np.empty(n), np.empty(n)) if is_measured else (none, none)
    for sweep in range(iterations):
        if is_measured:
            largest = operator.measure(x, heights, sigma)
            pace = _pace(schedule, sweep, sigma, largest)
            pulls = sigma
            if trust is not None:
                pace, pulls = _trust(pace, sigma, trust)
            first = none if sweep else fidelity
            known = vertices, operator.normals, heights, pulls, *pace
            over_ranges(_moved_along_normals, n, *known, offsets, first, moved)
            x = moved
        else:
            pace = schedule(sweep, None)
            if sweep == 0 and pace.constant:
                fidelity.fill(pace.constant)
            operator.advance(vertices, x, offsets, pace.time_step, pace.constant, moved)
            spare = np.empty_like(vertices) if sweep == 0 and iterations > 1 else x
            x, moved = moved, spare
        if on_sweep is not None:
            on_sweep(sweep + 1, iterations)
    return Swept(x, fidelity)
