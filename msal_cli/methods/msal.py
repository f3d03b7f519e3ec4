"""Multiscale anisotropic Laplacian (MSAL): removes noise and keeps intrinsic texture.

Algorithm 1 of the paper: sweeps of the anisotropic Laplacian (see ``al``) whose time step shrinks
while each vertex is pulled back to where it was scanned, the more so the rougher its surroundings:

    x_i <- x_i + tau d_i n_i + lambda_i (v_i - x_i)     eq. (2)
    tau = K^j at sweep j = 0, 1, ...                    eq. (6)
    lambda_i = sigma_i / max sigma                      eq. (7)

sigma (eq. 4) and lambda are computed anew from the current mesh at every sweep, and all vertices
move at once from the same positions.  Flat regions are smoothed, texture is recaptured, and the
volume shrinks far less than under AL.  It is at its best for fine texture with noise up to about a
tenth of the mean edge length; for strong noise choose a larger K, or ``al``.  Many sweeps lead
back to the input: four are a stable default.  A sweep costs about as much as one of AL.

``weights`` and ``deviation`` are choices of the weights and of sigma, as in ``al``, and with them
of lambda.  The multiscale schedule over the operators that are scaled for mixed triangle sizes is
``al`` with ``schedule=multiscale`` and a ``scaling``; section 4.3 finds that it is rarely needed.

On a mesh that is planar everywhere (max sigma = 0) lambda is zero.

Source: H. Huang and U. Ascher, Fast denoising of surface meshes with intrinsic texture, Inverse
Problems 24 (2008), section 3 and Algorithm 1.
"""

from __future__ import annotations

from msal_cli.core.schedules import Multiscale
from msal_cli.dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result, parameter
from msal_cli.methods._heights import HeightParameters, height_operator
from msal_cli.methods._sweeps import run


@dataclass(frozen=True)
class Parameters(HeightParameters):
    """Parameters of the multiscale anisotropic Laplacian."""

    K: float = parameter(
        0.5,
        "factor by which the smoothing shrinks from sweep to sweep",
        symbol="K",
        low=0.0,
        high=1.0,
        low_open=True,
        more="smoother; less keeps more texture, and more noise",
    )

    @property
    def has_data_term(self) -> bool:
        """lambda is that of eq. (7)."""
        return True


def denoised(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep | None = None) -> Result:
    """MSAL of ``mesh``; see the module's description."""
    return run(
        mesh,
        parameters,
        lambda: height_operator(mesh, parameters),
        Multiscale(parameters.K),
        on_sweep,
    )
