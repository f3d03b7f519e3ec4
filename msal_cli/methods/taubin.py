"""Taubin's lambda | mu filter: Laplacian smoothing without shrinkage, by steps in and out.

Each iteration is a pair of steps of the ``umbrella``: one inwards that smooths and shrinks, then a
slightly larger one outwards that inflates:

    x_i <- x_i + lambda dx_i,   lambda > 0
    x_i <- x_i + mu dx_i,       mu < -lambda

A wave of frequency k, 0 <= k <= 2, is multiplied by (1 - lambda k)(1 - mu k) at each pair.  That is
1 at k = 0 and again at the pass band k_PB = 1 / lambda + 1 / mu, a little more in between, and
falls off beyond: the shape below the pass band stays, the noise above it goes.  lambda = 0.5 and
k_PB = 0.1132 give mu = -0.53, a pair of values that several programs share; some count passes
rather than pairs: their 20 is 10 here.

The volume is kept, or grows a little, but edges are smeared and vertices slide along the surface.
Very many iterations let the waves below the pass band grow.  Steps that would amplify most of the
noise are refused.

An iteration costs two passes over the edges.

Source: G. Taubin, A signal processing approach to fair surface design, SIGGRAPH 1995, 351-358.
"""

from msal_cli.errors import UsageError
from msal_cli.kernels.sweeps import Schedule, run_sweeps
from msal_cli.kernels.umbrellas import Umbrella
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._sliding import undo_sliding
from msal_cli.methods._sweeps import ring_of

LARGEST_PASS_BAND = 1.0
"""The middle frequency of white noise; with a pass band beyond it most noise would grow."""


@dataclass(frozen=True)
class Parameters:
    iterations: int = fields.iterations(
        10, "pairs of a step inwards and a step outwards", "smoother"
    )
    shrink: float = fields.parameter(
        0.5,
        "the step inwards, as a share of the way to the mean of the neighbours",
        symbol="lambda",
        above=0.0,
        high=2.0 / 3.0,
        more="smoother",
    )
    pass_band: float = fields.parameter(
        0.1132,
        "frequency up to which the shape is kept; it sets mu = 1 / (pass_band - 1 / lambda)",
        symbol="k_PB",
        low=0.0,
        high=0.5,
        more="more of the shape, and of the noise, is kept",
    )
    inflate: float = fields.parameter(
        0.0,
        "the step outwards, negative, in size a little above lambda; 0 takes it from pass_band",
        symbol="mu",
        low=-1.0,
        high=0.0,
        more="(nearer to zero, but not 0) smoother, with more shrinkage",
    )
    boundary: str = fields.rim()
    sliding: str = fields.sliding()

    def __post_init__(self) -> None:
        if self.inflate and 1.0 / self.shrink + 1.0 / self.inflate > LARGEST_PASS_BAND:
            raise UsageError(
                f"lambda = {self.shrink:g} and mu = {self.inflate:g} amplify noise",
                hint="mu should be a little greater in size than lambda, for example "
                f"{-1.06 * self.shrink:.4g}",
            )

    @property
    def outward_step(self) -> float:
        """mu, as given or by the pass band; at least -1 in the ranges allowed."""
        return self.inflate or 1.0 / (self.pass_band - 1.0 / self.shrink)


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    def on_pass(done: int, total: int) -> None:
        if done % 2 == 0:
            on_sweep(done // 2, total // 2)

    timer = Timer()
    operator = Umbrella(*ring_of(mesh, parameters.boundary))
    timer.start_sweeps()
    result = run_sweeps(
        mesh.vertices,
        operator,
        Schedule(parameters.shrink, outward_step=parameters.outward_step),
        2 * parameters.iterations,
        on_pass,
    )
    return timer.finish(undo_sliding(mesh, result.vertices, parameters.sliding))
