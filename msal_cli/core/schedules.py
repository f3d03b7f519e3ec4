"""Schedules of equation (2): the time step and the fidelity to the data at each sweep."""

from __future__ import annotations

from typing import Protocol

from msal_cli.dataclass import dataclass


@dataclass(frozen=True)
class Pace:
    """One sweep's tau and lambda: lambda_i = constant + per_sigma * sigma_i.

    ``per_sigma`` is in reciprocal file units, the others are pure numbers.
    """

    time_step: float
    constant: float = 0.0
    per_sigma: float = 0.0


class Schedule(Protocol):
    """Gives the pace of every sweep; ``uses_sigma`` tells whether it looks at sigma."""

    @property
    def uses_sigma(self) -> bool:
        """Whether ``largest_sigma`` must be given."""
        ...

    def __call__(self, sweep: int, largest_sigma: float | None) -> Pace:
        """The pace of sweep 0, 1, ..., from max sigma at its start, file units."""
        ...


@dataclass(frozen=True)
class Plain:
    """The same time step tau at every sweep and no fidelity, lambda = 0 (section 2)."""

    time_step: float = 1.0
    uses_sigma = False

    def __call__(self, sweep: int, largest_sigma: float | None) -> Pace:
        """tau and no fidelity."""
        return Pace(self.time_step)


@dataclass(frozen=True)
class Constant:
    """The same time step tau and the same lambda > 0 at every sweep and vertex (section 3)."""

    time_step: float = 1.0
    fidelity: float = 0.1
    uses_sigma = False

    def __call__(self, sweep: int, largest_sigma: float | None) -> Pace:
        """tau and lambda."""
        return Pace(self.time_step, constant=self.fidelity)


@dataclass(frozen=True)
class Multiscale:
    """tau = tau_0 K^j (eq. 6) and lambda = sigma / max sigma (eq. 7), anew at every sweep j.

    With ``decay`` K below 1 later sweeps smooth less, the sooner the smaller K is; tau_0, the
    ``time_step``, is 1 in the paper.  On a mesh with sigma = 0 everywhere lambda is zero.
    """

    decay: float = 0.5
    time_step: float = 1.0
    uses_sigma = True

    def __call__(self, sweep: int, largest_sigma: float | None) -> Pace:
        """tau and 1 / max sigma."""
        largest = largest_sigma or 0.0
        return Pace(
            self.time_step * self.decay**sweep,
            per_sigma=1.0 / largest if largest > 0.0 else 0.0,
        )


@dataclass(frozen=True)
class Alternating:
    """A step ``shrink`` > 0 at even sweeps, ``inflate`` < 0 at odd ones, no fidelity (Taubin)."""

    shrink: float = 0.5
    inflate: float = -0.53
    uses_sigma = False

    def __call__(self, sweep: int, largest_sigma: float | None) -> Pace:
        """One of the two steps."""
        return Pace(self.inflate if sweep % 2 else self.shrink)
