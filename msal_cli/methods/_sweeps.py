"""What the methods of equation (2) share: parameters, operators, the schedule, and the run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats
from msal_cli.kernels.operators import (
    DEVIATIONS,
    WEIGHTS,
    AnisotropicLaplacian,
    Operator,
    RobustLaplacian,
)
from msal_cli.kernels.sweeps import (
    Schedule,
    SweepResult,
    Wiener,
    run_sweeps,
)
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result, Timer, parameter


@dataclass(frozen=True)
class NormalParameters:
    """Iterations, and the vertex normals that heights, and sigma of eq. (4), are measured along."""

    iterations: int = parameter(
        4,
        "sweeps over all vertices",
        symbol="n",
        low=0,
        high=1000,
        more="smoother; under the multiscale schedule many sweeps lead back to the input",
    )
    mollify: int = parameter(
        1,
        "passes that average the normals over the one-ring before the first sweep",
        low=0,
        high=100,
        more="smoother normals: flatter flats under heavy noise, softer edges",
    )
    normals: str = parameter(
        "uniform",
        "how face normals count in a vertex normal: alike, or by face area",
        choices=("uniform", "area"),
    )
    boundary: str = parameter(
        "free",
        "vertices at open edges: filtered like the others with the neighbours they have, or fixed",
        choices=("free", "fixed"),
    )


WIENER_BYTES_PER_FACE = 60
"""Memory of the Wiener schedule beyond that of the others; see ``Method.bytes_per_face``."""

MAX_NOISE_MULTISCALE = 0.15
"""Mean edge lengths: with stronger noise the multiscale schedules leave much of it.  At 0.2 ten
passes of Taubin's filter have the smaller angles on most models of benchmarks/ground_truth.py."""


class ScheduleTraits:
    """What the parameter ``schedule`` of a method and those that belong to it mean."""

    schedule: str
    K: float
    quantile: float
    noise: float
    caution: float
    time_step = 1.0
    fidelity = 0.0

    def build_schedule(self) -> Schedule:
        """The schedule that these parameters describe."""
        if self.schedule == "constant":
            return Schedule(self.time_step, self.fidelity)
        if self.schedule == "multiscale":
            return Schedule(self.time_step, decay=self.K, quantile=1.0)
        if self.schedule == "robust":
            return Schedule(self.time_step, decay=self.K, quantile=self.quantile)
        if self.schedule == "wiener":
            return Wiener(self.time_step, noise=self.noise or None, caution=self.caution)
        return Schedule(self.time_step)

    @property
    def has_data_term(self) -> bool:
        """Whether vertices are pulled back to where they were scanned."""
        return self.schedule != "plain"

    @property
    def bytes_per_face(self) -> int:
        """See ``Method.bytes_per_face``."""
        return WIENER_BYTES_PER_FACE if self.schedule == "wiener" else 0

    @property
    def most_noise_edges(self) -> float:
        """See ``Method.most_noise_edges``."""
        is_multiscale = self.schedule in ("multiscale", "robust")
        return MAX_NOISE_MULTISCALE if is_multiscale else math.inf

    @property
    def uses_largest_sigma(self) -> bool:
        """See ``Method.uses_largest_sigma``."""
        return self.schedule == "multiscale"


def quantile_parameter() -> Any:
    """The parameter of the robust schedule."""
    return parameter(
        0.99,
        "robust schedule: quantile of sigma, from 0 to 1, that replaces max sigma",
        symbol="q",
        low=0.0,
        high=1.0,
        low_open=True,
        more="smoother; 1 is the multiscale schedule",
    )


def noise_parameter(of: str = "wiener schedule: ") -> Any:
    """A parameter of the Wiener schedule."""
    return parameter(
        0.0,
        of + "standard deviation of the noise; 0 estimates it",
        low=0.0,
        high=100.0,
        unit="mean edge lengths",
        more="smoother, above 0",
    )


def caution_parameter(default: float = 1.0, of: str = "wiener schedule: ") -> Any:
    """The other parameter of the Wiener schedule."""
    return parameter(
        default,
        of + "factor of the assumed power of the noise",
        low=0.0,
        high=100.0,
        more="smoother, less texture",
    )


@dataclass(frozen=True)
class ScheduledParameters(ScheduleTraits, NormalParameters):
    """Parameters of a method whose operator can run under any schedule of equation (2)."""

    time_step: float = parameter(
        1.0,
        "share of the operator's step that the first sweep takes",
        symbol="tau",
        low=0.0,
        high=1.0,
        low_open=True,
        more="smoother",
    )
    schedule: str = parameter(
        "plain",
        "how the sweeps go on: alike; with a constant pull to the data; multiscale, as in msal; "
        "robust, unaffected by spikes; or alike, and what is more than noise comes back (wiener)",
        choices=("plain", "constant", "multiscale", "robust", "wiener"),
    )
    fidelity: float = parameter(
        0.1,
        "constant schedule: pull towards the scanned position at every sweep",
        symbol="lambda",
        low=0.0,
        high=1.0,
        more="closer to the input",
    )
    K: float = parameter(
        0.5,
        "multiscale and robust schedules: factor by which the smoothing shrinks from sweep to "
        "sweep",
        symbol="K",
        low=0.0,
        high=1.0,
        low_open=True,
        more="smoother; less keeps more texture, and more noise",
    )
    quantile: float = quantile_parameter()
    noise: float = noise_parameter()
    caution: float = caution_parameter()


@dataclass(frozen=True)
class ScaleParameters(ScheduledParameters):
    """Parameters of a method whose normals serve only sigma of eq. (4), and so the fidelity."""

    mollify: int = parameter(
        1,
        "multiscale schedule: passes that average the normals along which sigma is measured",
        low=0,
        high=100,
        more="a lambda that follows the noise less",
    )
    normals: str = parameter(
        "uniform",
        "multiscale schedule: how face normals count in these normals: alike, or by face area",
        choices=("uniform", "area"),
    )


def free_vertices(mesh: Mesh, boundary: str) -> NDArray[np.bool_]:
    """Which vertices (n,) may move, for the parameter ``boundary``; fixed vertices may not."""
    edge = mesh.topology.boundary
    free: NDArray[np.bool_] = ~edge if boundary == "fixed" else np.ones_like(edge)
    return free if mesh.fixed_vertices is None else free & ~mesh.fixed_vertices


def anisotropic_laplacian(mesh: Mesh, parameters: NormalParameters) -> AnisotropicLaplacian:
    """The operator of eq. (5) along the mesh's own normals."""
    return AnisotropicLaplacian(
        mesh.vertex_normals(parameters.normals, parameters.mollify),
        mesh.topology.ring_start,
        mesh.topology.ring,
        free_vertices(mesh, parameters.boundary),
        mesh.mean_edge_length,
    )


def run(
    mesh: Mesh,
    parameters: NormalParameters,
    operator: Callable[[], Operator],
    schedule: Schedule,
    on_sweep: OnSweep,
) -> Result:
    """Sweeps of the operator that ``operator()`` makes, under ``schedule``.

    Making it counts as the stage ``normals``.  For a schedule that needs sigma over an operator
    that does not compute it, sigma is that of eq. (4) along the mesh's vertex normals.  lambda is
    scaled by the mesh's trust, where it has such.  The
    result's field ``fidelity`` is lambda of the first sweep, of the Wiener schedule that at the
    end.
    """
    timer = Timer()
    made = operator()
    laplacian = anisotropic_laplacian(mesh, parameters) if schedule.quantile is not None else None

    def scale(positions: Floats) -> Floats:
        assert laplacian is not None
        sigma = laplacian(positions).sigma
        assert sigma is not None
        return sigma

    timer.start_sweeps()
    result = run_sweeps(
        mesh.vertices,
        made,
        schedule,
        parameters.iterations,
        on_sweep,
        scale,
        mesh.trust,
    )
    if isinstance(schedule, Wiener) and parameters.iterations:
        result = _restore(mesh, parameters, result.vertices, schedule)
    return timer.finish(result.vertices, {"fidelity": result.fidelity})


def resolve_noise_level(mesh: Mesh, noise: float) -> float:
    """Noise in file units from the parameter ``noise`` in mean edge lengths, 0 for the estimate,
    which is taken for noise where it is unsure."""
    from msal_cli.analysis.noise_estimate import NOISE, estimate_noise

    if noise:
        return noise * mesh.mean_edge_length
    return estimate_noise(mesh).assume(NOISE, mesh.mean_edge_length).file_units


def _restore(
    mesh: Mesh, parameters: NormalParameters, smooth: Floats, schedule: Wiener
) -> SweepResult:
    """Positions from which the sweeps came to ``smooth`` (n, 3), as far as more than noise went.

    What comes back comes along the mesh's normals.
    """
    from msal_cli.kernels.restoration import restoration

    noise = resolve_noise_level(mesh, schedule.noise or 0.0)
    normals = mesh.vertex_normals(parameters.normals, parameters.mollify)
    residual = np.einsum("ij,ij->i", smooth - mesh.vertices, normals)
    links = mesh.topology
    found = restoration(residual, links.ring_start, links.ring, noise, schedule.caution)
    pull = found.returned if mesh.trust is None else mesh.trust * found.returned
    share = found.share if mesh.trust is None else mesh.trust * found.share
    smooth -= pull[:, None] * normals
    return SweepResult(smooth, share)


@dataclass(frozen=True)
class HeightParameters(NormalParameters):
    """Parameters of the anisotropic Laplacian and its variants."""

    weights: str = parameter(
        "gauss",
        "how the weight of a neighbour falls with its height: to nothing at a height (tukey), "
        "to almost nothing (gauss), slowly (lorentz, huber), or not at all (none)",
        choices=WEIGHTS,
    )
    deviation: str = parameter(
        "mean",
        "scale of the heights: 2 mean or 1.4826 median absolute deviations; the median keeps "
        "sharper edges under weak noise, and leaves strong noise in place",
        choices=DEVIATIONS,
    )


def height_operator(
    mesh: Mesh, parameters: HeightParameters, scaling: str = "none", time_step: float = 0.0
) -> Operator:
    """The operator of eq. (5) with the chosen weights and scales.

    ``scaling`` is that of section 4.3, with ``time_step`` in squared file units.
    """
    chosen = (parameters.weights, parameters.deviation, scaling)
    if chosen == ("gauss", "mean", "none"):
        return anisotropic_laplacian(mesh, parameters)
    return RobustLaplacian(
        mesh.vertex_normals(parameters.normals, parameters.mollify),
        mesh.faces,
        mesh.topology,
        free_vertices(mesh, parameters.boundary),
        mesh.mean_edge_length,
        *chosen,
        time_step,
    )
