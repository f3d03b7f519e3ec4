"""The common part of the methods of equation (2): parameters, operators, schedules, and the run."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from msal_cli.arrays import Floats, Ints
from msal_cli.errors import UsageError
from msal_cli.kernels.connectivity import averaging_ring
from msal_cli.kernels.operators import DEVIATIONS, WEIGHTS, Operator, RingOperator, RobustLaplacian
from msal_cli.kernels.sweeps import Schedule, SweepResult, Wiener, run_sweeps
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer


@dataclass(frozen=True)
class NormalParameters:
    """Iterations, and the vertex normals along which heights and sigma of eq. (4) are measured."""

    iterations: int = fields.iterations(
        4,
        "sweeps over all vertices",
        "smoother; under the multiscale schedule many sweeps lead back to the input",
    )
    mollify: int = fields.mollify()
    normals: str = fields.parameter(
        "uniform",
        "how face normals count in a vertex normal: alike, or by face area",
        choices=("uniform", "area"),
    )
    boundary: str = fields.boundary(
        "free", "filtered like the others with the neighbours they have"
    )


WIENER_BYTES_PER_FACE = 60
"""Additional memory of the Wiener schedule; see ``Method.bytes_per_face_of``."""

MAX_NOISE_MULTISCALE = 0.15
"""Level of noise, mean edge lengths, above which the multiscale schedules leave much of it.  At 0.2
ten iterations of Taubin's filter have smaller angles on most models of
benchmarks/ground_truth.py."""


class ScheduleTraits(NormalParameters):
    """The meaning of a method's parameter ``schedule`` and of those that belong to it."""

    schedule: str
    K: float
    quantile: float
    noise: float
    caution: float
    time_step = 1.0
    fidelity = 0.0
    has_own_step = False  # True if the operator uses ``time_step``, and schedules are shares of it

    def __post_init__(self) -> None:
        if self.K != type(self).K and self.schedule not in ("multiscale", "robust"):
            raise UsageError(
                f"K = {self.K:g} means nothing to the schedule {self.schedule}",
                hint="set schedule=multiscale or robust, or leave K out",
            )

    def build_schedule(self) -> Schedule:
        step = 1.0 if self.has_own_step else self.time_step
        if self.schedule == "constant":
            return Schedule(step, self.fidelity)
        if self.schedule in ("multiscale", "robust"):
            share = 1.0 if self.schedule == "multiscale" else self.quantile
            return Schedule(step, decay=self.K, quantile=share)
        if self.schedule == "wiener":
            return Wiener(step, noise=self.noise or None, caution=self.caution)
        return Schedule(step)

    @property
    def has_data_term(self) -> bool:
        """Whether vertices are pulled back to their scanned positions."""
        return self.schedule != "plain"

    @property
    def schedule_bytes_per_face(self) -> int:
        return WIENER_BYTES_PER_FACE if self.schedule == "wiener" else 0

    @property
    def most_noise_edges(self) -> float:
        is_multiscale = self.schedule in ("multiscale", "robust")
        return MAX_NOISE_MULTISCALE if is_multiscale else math.inf

    @property
    def uses_largest_sigma(self) -> bool:
        return self.schedule == "multiscale"


@dataclass(frozen=True)
class ScheduledParameters(ScheduleTraits):
    """Parameters of a method whose operator can run under any schedule of equation (2)."""

    time_step: float = fields.share(
        1.0,
        "share of the operator's step that the first sweep takes",
        "smoother",
        symbol="tau",
        above=0.0,
    )
    schedule: str = fields.parameter(
        "plain",
        "how the sweeps go on: alike; with a constant pull to the data; multiscale, as in msal; "
        "robust, unaffected by spikes; or alike, and what is more than noise comes back (wiener)",
        choices=("plain", "constant", "multiscale", "robust", "wiener"),
    )
    fidelity: float = fields.share(
        0.1,
        "constant schedule: pull towards the scanned position at every sweep",
        "closer to the input",
        symbol="lambda",
    )
    K: float = fields.share(
        0.5,
        "multiscale and robust schedules: factor by which the smoothing shrinks from sweep to "
        "sweep",
        "smoother; less keeps more texture, and more noise",
        symbol="K",
        above=0.0,
    )
    quantile: float = fields.quantile()
    noise: float = fields.noise()
    caution: float = fields.caution()


@dataclass(frozen=True)
class ScaleParameters(ScheduledParameters):
    """Parameters of a method whose normals serve only sigma of eq. (4), and so the fidelity."""

    mollify: int = fields.mollify(
        1,
        "multiscale schedule: passes that average the normals along which sigma is measured",
        "a lambda that follows the noise less",
    )
    normals: str = fields.parameter(
        "uniform",
        "multiscale schedule: how face normals count in these normals: alike, or by face area",
        choices=("uniform", "area"),
    )


@dataclass(frozen=True)
class ScheduledRingParameters(ScaleParameters):
    """Parameters of an operator of equation (2) that averages over one-rings."""

    boundary: str = fields.rim()


def free_vertices(mesh: Mesh, boundary: str) -> NDArray[np.bool_]:
    """Whether each vertex (n,) may move by the parameter ``boundary`` and is not fixed."""
    edge = mesh.topology.boundary
    free: NDArray[np.bool_] = ~edge if boundary == "fixed" else np.ones_like(edge)
    return free if mesh.fixed_vertices is None else free & ~mesh.fixed_vertices


def ring_of(mesh: Mesh, boundary: str) -> tuple[Ints, Ints]:
    """The rings to average over in CSR form, (n + 1,) and (...,), for the parameter ``boundary``.

    Those of fixed vertices are empty: a vertex without neighbours does not move.
    """
    starts, ring = averaging_ring(mesh.faces, mesh.topology, boundary)
    if mesh.fixed_vertices is None:
        return starts, ring
    counts = np.diff(starts)
    kept = ring[np.repeat(~mesh.fixed_vertices, counts)]
    counts[mesh.fixed_vertices] = 0
    starts = np.concatenate([np.zeros(1, counts.dtype), np.cumsum(counts, dtype=counts.dtype)])
    return starts, kept


def anisotropic_laplacian(mesh: Mesh, parameters: NormalParameters) -> RingOperator:
    """The operator of eq. (5) along the normals of the input."""
    return RingOperator(
        mesh.vertex_normals(parameters.normals, parameters.mollify),
        mesh.topology.ring_start,
        mesh.topology.ring,
        free_vertices(mesh, parameters.boundary),
        mesh.mean_edge_length,
    )


def run(
    mesh: Mesh, parameters: ScheduleTraits, operator: Callable[[], Operator], on_sweep: OnSweep
) -> Result:
    """Run sweeps of the operator that ``operator()`` makes, under the schedule of ``parameters``.

    Making it counts as the stage ``normals``.  If the schedule needs sigma and the operator does
    not compute it, sigma is that of eq. (4) along the mesh's vertex normals.  lambda is scaled by
    the mesh's trust.  The result's field ``fidelity`` is lambda of the first sweep, for the Wiener
    schedule that at the end.
    """
    timer = Timer()
    schedule = parameters.build_schedule()
    made = operator()
    laplacian = anisotropic_laplacian(mesh, parameters) if schedule.quantile is not None else None

    def scale(positions: Floats) -> Floats:
        assert laplacian is not None
        sigma = laplacian(positions).sigma
        assert sigma is not None
        return sigma

    timer.start_sweeps()
    result = run_sweeps(
        mesh.vertices, made, schedule, parameters.iterations, on_sweep, scale, mesh.trust
    )
    if isinstance(schedule, Wiener) and parameters.iterations:
        result = _restore(mesh, parameters, result.vertices, schedule)
    return timer.finish(result.vertices, {"fidelity": result.fidelity})


def resolve_noise_level(mesh: Mesh, noise: float) -> float:
    """The level of noise in file units by the parameter ``noise`` in mean edge lengths; if it is 0
    by the estimate, which counts as noise if it is unsure."""
    from msal_cli.analysis.noise_estimate import NOISE, estimate_noise

    if noise:
        return noise * mesh.mean_edge_length
    return estimate_noise(mesh).assume(NOISE, mesh.mean_edge_length).file_units


def _restore(
    mesh: Mesh, parameters: NormalParameters, smooth: Floats, schedule: Wiener
) -> SweepResult:
    """The result ``smooth`` (n, 3) of the sweeps with displacements along the mesh's normals
    restored as far as they exceed the noise."""
    from msal_cli.kernels.restoration import restoration

    noise = resolve_noise_level(mesh, schedule.noise or 0.0)
    normals = mesh.vertex_normals(parameters.normals, parameters.mollify)
    residual = np.einsum("ij,ij->i", smooth - mesh.vertices, normals)
    links = mesh.topology
    pull, share = restoration(residual, *links.one_ring, noise, schedule.caution)
    if mesh.trust is not None:
        pull, share = mesh.trust * pull, mesh.trust * share
    smooth -= pull[:, None] * normals
    return SweepResult(smooth, share)


@dataclass(frozen=True)
class HeightParameters(NormalParameters):
    """Parameters of the anisotropic Laplacian and its variants."""

    weights: str = fields.parameter(
        "gauss",
        "how the weight of a neighbour falls with its height: to nothing at a height (tukey), "
        "to almost nothing (gauss), slowly (lorentz, huber), or not at all (none)",
        choices=WEIGHTS,
    )
    deviation: str = fields.parameter(
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
