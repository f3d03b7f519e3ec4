"""Schedules of equation (2): the time step and the fidelity to the data at each sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol


class Pace(NamedTuple):
    """One sweep's tau and lambda: lambda_i = min(1, constant + per_sigma * sigma_i).

    ``per_sigma`` is in reciprocal file units, the others are pure numbers.
    """

    time_step: float
    constant: float = 0.0
    per_sigma: float = 0.0


class Schedule(Protocol):
    """Gives the pace of every sweep."""

    @property
    def quantile(self) -> float | None:
        """Which quantile of the sigma above zero it must be given, 1 for max sigma; None for none.

        It is the least that at least this share of them do not exceed.
        """
        ...

    def __call__(self, sweep: int, scale: float | None) -> Pace:
        """The pace of sweep 0, 1, ..., from that quantile at its start, file units."""
        ...


@dataclass(frozen=True)
class Plain:
    """The same time step tau at every sweep and no fidelity, lambda = 0 (section 2)."""

    time_step: float = 1.0
    quantile = None

    def __call__(self, sweep: int, scale: float | None) -> Pace:
        """tau and no fidelity."""
        return Pace(self.time_step)


@dataclass(frozen=True)
class Constant:
    """The same time step tau and the same lambda > 0 at every sweep and vertex (section 3)."""

    time_step: float = 1.0
    fidelity: float = 0.1
    quantile = None

    def __call__(self, sweep: int, scale: float | None) -> Pace:
        """tau and lambda."""
        return Pace(self.time_step, constant=self.fidelity)


@dataclass(frozen=True)
class Multiscale:
    """tau = tau_0 K^j (eq. 6) and lambda = sigma / max sigma (eq. 7), anew at every sweep j.

    With ``decay`` K below 1 later sweeps smooth less, the sooner the smaller K is; tau_0, the
    ``time_step``, is 1 in the paper.  On a mesh with sigma = 0 everywhere lambda is zero.

    max sigma may belong to a single spike, beside which every other lambda is next to nothing.
    With a ``quantile`` q below 1 it is not needed: lambda = min(1, sigma / q-quantile of sigma),
    the quantile being that of the sigma above zero, so that planes and vertices without faces do
    not count.  The smaller q is, the stronger the pull.
    """

    decay: float = 0.5
    time_step: float = 1.0
    quantile: float | None = 1.0

    def __call__(self, sweep: int, scale: float | None) -> Pace:
        """tau and 1 / scale."""
        scale = scale or 0.0
        return Pace(
            self.time_step * self.decay**sweep, per_sigma=1.0 / scale if scale > 0.0 else 0.0
        )


@dataclass(frozen=True)
class Alternating:
    """A step ``shrink`` > 0 at even sweeps, ``inflate`` < 0 at odd ones, no fidelity (Taubin)."""

    shrink: float = 0.5
    inflate: float = -0.53
    quantile = None

    def __call__(self, sweep: int, scale: float | None) -> Pace:
        """One of the two steps."""
        return Pace(self.inflate if sweep % 2 else self.shrink)


@dataclass(frozen=True)
class Wiener:
    """The same time step tau at every sweep, and one pull at the end, by how far the local power
    of what the sweeps took exceeds that of noise: see ``kernels.restoration``.

    ``noise`` is its standard deviation in mean edge lengths, None if it is to be estimated;
    ``caution`` scales the assumed power of the noise.
    """

    time_step: float = 1.0
    noise: float | None = None
    caution: float = 1.0
    quantile = None

    def __call__(self, sweep: int, scale: float | None) -> Pace:
        """tau and no fidelity."""
        return Pace(self.time_step)
