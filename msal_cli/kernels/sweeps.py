"""The sweeps of equation (2), x_i <- x_i + tau dx_i + lambda_i (v_i - x_i), and their schedules.

A schedule gives the time step tau and the fidelity to the data lambda at each sweep.  Each sweep
computes all of its terms from the positions after the previous sweep (Jacobi).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from msal_cli.arrays import Floats
from msal_cli.kernels import vectors as vec
from msal_cli.kernels.library import compiled
from msal_cli.kernels.operators import Operator
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.quantiles import quantile_above_zero
from msal_cli.light_dataclass import dataclass


class Pace(NamedTuple):
    """One sweep's tau and lambda: lambda_i = min(1, constant + per_sigma * sigma_i).

    ``per_sigma`` is in reciprocal file units, the others are pure numbers.
    """

    time_step: float
    constant: float = 0.0
    per_sigma: float = 0.0


@dataclass(frozen=True)
class Schedule:
    """tau = tau_0 K^j and lambda of sweep j = 0, 1, ...

    The default is tau = 1 and no fidelity, lambda = 0 (section 2); a ``fidelity`` above zero is a
    constant lambda (section 3).  With ``decay`` K below 1 (eq. 6) later sweeps smooth less, the
    sooner the smaller K is.

    With a ``quantile`` of 1 lambda = sigma / max sigma (eq. 7), updated at each sweep.  A single
    spike may determine max sigma, and all other lambda are then nearly 0.  With a quantile q below
    1 lambda = min(1, sigma / q-quantile of the sigma above zero); planes and vertices without faces
    do not count.  The smaller q is, the stronger the pull; if all sigma are zero there is none.

    ``outward_step`` < 0 is tau at odd sweeps (Taubin).
    """

    time_step: float = 1.0
    fidelity: float = 0.0
    decay: float = 1.0
    quantile: float | None = None
    outward_step: float | None = None

    def __call__(self, sweep: int, scale: float | None) -> Pace:
        """The pace of sweep 0, 1, ..., from the quantile of sigma at its start, file units."""
        step = self.time_step * self.decay**sweep
        if sweep % 2 and self.outward_step is not None:
            step = self.outward_step
        return Pace(step, self.fidelity, 1.0 / scale if scale else 0.0)


@dataclass(frozen=True)
class Wiener(Schedule):
    """A single pull at the end, by how far the local power of the residual exceeds that of noise:
    see ``kernels.restoration``.

    ``noise`` is its standard deviation in mean edge lengths, None to estimate it; ``caution``
    scales the assumed power of the noise: greater restores less.
    """

    noise: float | None = None
    caution: float = 1.0


OnSweep = Callable[[int, int], None]
"""Called as ``on_sweep(done, iterations)`` after each sweep."""


@dataclass(frozen=True, eq=False)
class SweepResult:
    """Result of a run of sweeps."""

    vertices: Floats  # (n, 3) final positions
    fidelity: Floats  # (n,), lambda of the first sweep (Fig. 5 of the paper)


@compiled
def _move_along_normals(
    start, stop, v, normals, heights, sigma, tau, constant, per_sigma, offsets, x
):
    for i in range(start, stop):
        pull = min(constant + per_sigma * sigma[i], 1.0)
        t = offsets[i]
        t = t + tau * heights[i] - pull * t
        offsets[i] = t
        vec.store(x, i, vec.add_scaled(vec.load(v, i), t, vec.load(normals, i)))


@compiled
def _move_freely(start, stop, v, moves, sigma, tau, constant, per_sigma, x):
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
) -> SweepResult:
    """``iterations`` sweeps of eq. (2) from ``vertices`` (n, 3), which are not changed.

    If the operator moves along fixed normals n the fidelity pulls back along n too, so each vertex
    stays on the line v + t n: only t is updated, and rounding causes no tangential drift.

    Parameters
    ----------
    on_sweep : called after each sweep; an exception that it raises ends the run.
    scale : gives sigma (n,) of eq. (4) at positions (n, 3), for a schedule that uses it over an
        operator that does not compute it.
    trust : (n,) from 0 to 1, the part of lambda that each vertex gets; None for all of it.
    """
    n = len(vertices)
    x = vertices.copy()
    offsets = np.zeros(n)
    # Never written to, so it takes no memory.
    unused = np.zeros(n)
    fidelity = unused
    for sweep in range(iterations):
        step = operator(x)
        move, sigma, largest = step.move, step.sigma, step.largest_sigma
        if schedule.quantile is not None and sigma is None:
            if scale is None:
                raise ValueError("the schedule needs sigma, and nothing computes it")
            sigma = scale(x)
        pace = _pace(schedule, sweep, sigma, largest)
        pulled = unused if sigma is None else sigma
        if trust is not None:
            # Included here, so that the kernels need no trust.
            pulled = trust * _pulls(pace, pulled)
            pace = Pace(pace.time_step, per_sigma=1.0)
        if sweep == 0:
            fidelity = _pulls(pace, pulled)
        if operator.normals is None:
            over_ranges(_move_freely, n, vertices, move, pulled, *pace, x)
        else:
            known = vertices, operator.normals, move, pulled, *pace
            over_ranges(_move_along_normals, n, *known, offsets, x)
        # The next step reuses their memory.
        del step, move, sigma, pulled
        if on_sweep is not None:
            on_sweep(sweep + 1, iterations)
    return SweepResult(x, fidelity)


def _pace(schedule: Schedule, sweep: int, sigma: Floats | None, largest: float | None) -> Pace:
    """The pace of a sweep; ``largest`` is max sigma, if known."""
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
