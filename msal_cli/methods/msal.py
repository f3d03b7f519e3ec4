"""Multiscale anisotropic Laplacian (MSAL): removes noise and keeps intrinsic texture.

Algorithm 1 of the paper: sweeps of ``al`` whose time step shrinks while each vertex is pulled back
to where it was scanned, the more so the rougher its surroundings:

    x_i <- x_i + tau d_i n_i + lambda_i (v_i - x_i)     eq. (2)
    tau = K^j at sweep j = 0, 1, ...                    eq. (6)
    lambda_i = sigma_i / max sigma                      eq. (7)

sigma (eq. 4) and lambda are updated at every sweep.  Flat regions are smoothed, texture is
recaptured, and the volume shrinks far less than under AL. It is at its best for fine texture with
noise up to about a tenth of the mean edge length; for strong noise choose a larger K, or ``al``.
Many sweeps lead back to the input: four are a stable default.

``schedule`` is not in the paper.  One spike or torn triangle has a sigma so large that every other
lambda is almost zero; ``robust`` takes in place of max sigma a ``quantile`` of the sigma above
zero: lambda_i = min(1, sigma_i / quantile).  It stays closer to the scan, and suits noise up to
0.1.  ``wiener`` sweeps with tau = 1 and no pull, as ``al``, and then restores the part of what it
removed that exceeds ``noise`` (docs/algorithm.md).  On organic and textured objects it comes closer
to the truth than the paper's schedule at its best.  A given ``noise`` helps most where texture is
as fine as the mesh.

``weights`` and ``deviation`` are those of ``al``, where ``schedule=multiscale`` with a ``scaling``
is the form for mixed triangle sizes.  On a mesh that is planar everywhere (max sigma = 0) lambda is
zero.

Source: H. Huang and U. Ascher, Inverse Problems 24 (2008), section 3 and Algorithm 1.
"""

from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._contract import OnSweep, Result
from msal_cli.methods._sweeps import HeightParameters, ScheduleTraits, height_operator, run


@dataclass(frozen=True)
class Parameters(ScheduleTraits, HeightParameters):
    K: float = fields.share(
        0.5,
        "factor by which the smoothing shrinks from sweep to sweep",
        "smoother; less keeps more texture, and more noise",
        symbol="K",
        above=0.0,
    )

    schedule: str = fields.parameter(
        "multiscale",
        "lambda: the paper's; with a quantile of sigma in place of its maximum (robust); or, after "
        "plain sweeps, by how far what they took is more than noise (wiener)",
        choices=("multiscale", "robust", "wiener"),
    )
    quantile: float = fields.quantile()
    noise: float = fields.noise()
    caution: float = fields.caution()


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    return run(mesh, parameters, lambda: height_operator(mesh, parameters), on_sweep)
