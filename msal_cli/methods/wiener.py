"""Wiener-filtered residual: smooths, restores what exceeds the noise; then the normals.

For organic and textured scans with noise up to about 0.4 mean edge lengths.  Three steps:

1. ``iterations`` plain sweeps of ``al``.  How far they moved each vertex along its normal is the
residual: the negative noise, and shape that was lost. 2. The residual is split into five bands from
fine to coarse.  Of each, a vertex gets back the share lambda, with Q the power of the lost shape
around it, c the share of white noise in the band, and s the ``noise`` (estimated, unless it is
given):

       lambda = Q / (Q + 0.4 caution c s^2)

   This is ``schedule=wiener`` of ``msal``; docs/algorithm.md has all of it.

3. The noisy normals of the scan are averaged over neighbouring faces that are alike in the result:
   a joint bilateral filter, with A areas, c centroids, g the normals of the result,

       w_ij = A_j exp(-|c_i - c_j|^2 / (2 sigma_c^2)) exp(-|g_i - g_j|^2 / (2 sigma_s^2))
       n'_i = normalised sum of w_ij n_j over i itself and the faces that share a vertex with it

   in ``normal_iterations`` passes, with sigma_s = ``similarity`` times s in mean edge lengths.
   ``scan_share`` mixes normals of the result in beforehand.  ``vertex_iterations`` passes then fit
   the vertices to these normals (see ``bilateral_normal``).

More sweeps hardly matter: what they take from the shape comes back.  The noise should be right to a
fifth or so; where texture is as fine as the mesh a given ``noise`` helps most.  On machined parts
with strong noise filters of normals do better.

The cost is that of about 30 sweeps of ``al``.

Source: own; local Wiener filters as in M. K. Mihcak, I. Kozintsev, K. Ramchandran and P. Moulin,
Low-complexity image denoising based on statistical modeling of wavelet coefficients, IEEE Signal
Processing Letters 6 (1999), 300-303; normals guided by another surface as in W. Zhang, B. Deng, J.
Zhang, S. Bouaziz and L. Liu, Guided mesh normal filtering, Computer Graphics Forum 34 (2015).
"""

from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._restoration import RestorationParameters, fit_to_normals, restore
from msal_cli.methods._sweeps import anisotropic_laplacian, resolve_noise_level

BYTES_PER_FACE = 250


@dataclass(frozen=True)
class Parameters(RestorationParameters):
    """Parameters of this method."""


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    if not parameters.iterations:
        return Result(mesh.vertices.copy(), seconds={"normals": 0.0, "sweeps": 0.0})
    timer = Timer()
    noise = resolve_noise_level(mesh, parameters.noise)
    laplacian = anisotropic_laplacian(mesh, parameters)
    timer.start_sweeps()
    restored = restore(mesh, laplacian, parameters, noise, on_sweep)
    positions = restored.positions
    if noise > 0.0 and parameters.normal_iterations:
        positions = fit_to_normals(mesh, parameters, positions, noise)
    return timer.finish(positions, {"fidelity": restored.share})
