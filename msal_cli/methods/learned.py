"""Learned filter of face normals: small networks weigh filtered normals of many widths.

For scans of machined parts and of organic shapes under noise of any kind.  The networks were
trained on meshes made by script.  Each of the ``iterations`` stages describes every face by

- vectors: its normal; means of the normals near, over two reaches and three ranges of difference
  (biweights (1 - |n_i - n_j|^2 / s^2)^2), some of them guided by others; planes fitted to the
  centroids; the normals after ``wiener``, after its sweeps alone, and after ``windowed_sinc`` with
  two pass bands; its normal filtered with those of ``wiener`` as a guide; from the second stage on
  also the scanned normal, that of the stage before, and the former guided by the latter;
- numbers: the share of the weight within each range; how normals and positions scatter here and
  around; the roughness after one, two and three umbrellas, also against white noise of the local
  level; how much of what the sweeps took is shape; the same over the whole mesh, or over its noisy
  part if much has hardly any noise; the ``noise``, and whether it is white.

A network of two hidden layers gives every vector a coefficient; the normalised sum is the new
normal, so that what is flat stays flat.  The vertices are then fitted as in ``guided_normal``, and
the next stage starts from them.  At the end the scanned vertices are fitted to the normals of the
last stage; those with a face still more than 20 degrees off are evened out along the surface and
fitted again.

Vectors are expressed along the axes of the tensor of the normals near, and lengths are local:
turning, moving or scaling a mesh changes nothing.

The level of the noise decides what is texture: give ``noise`` where texture is as fine as the mesh;
a greater one smooths more, 10 to 20 % too little returns noise.  Given noise counts as white.
A mesh without noise comes back as it is.  Under white noise, what the stages took beyond it comes
back as in ``wiener`` (``texture``).  Under noise along the normals, moves along the surface are
undone (``sliding``; see ``guided_normal``).

The cost is 10 s per million faces on one core, 6.5 s on two (2 million faces, AMD EPYC).
docs/training.md says how to train the weights, with clean meshes of your own too.

Source: P.-S. Wang, Y. Liu and X. Tong, Mesh denoising via cascaded normal regression, ACM TOG 35
(6), 2016, 232; combinations whose weights are predicted after S. Bako et al., Kernel-predicting
convolutional networks for denoising Monte Carlo renderings, ACM TOG 36 (4), 2017, 97; descriptors,
networks and training are own.
"""

from msal_cli.arrays import Floats
from msal_cli.kernels.vertex_update import untangle
from msal_cli.light_dataclass import dataclass
from msal_cli.mesh import Mesh
from msal_cli.methods import _fields as fields
from msal_cli.methods._cascade import Cascade, load_networks, return_texture
from msal_cli.methods._contract import OnSweep, Result, Timer
from msal_cli.methods._sliding import undo_sliding

BYTES_PER_FACE = 730
"""Memory beyond what each method needs, measured at the defaults; see ``Method``."""

MIN_KNOWN = 0.03
"""Level, mean edge lengths, below which the level of noise of an unknown kind counts as unknown."""

STAGE_PASSES = 10  # passes over the vertices between two stages, as in training


@dataclass(frozen=True)
class Parameters:
    iterations: int = fields.passes(
        3,
        "stages, each with its own network; beyond the third the last one again; 0 returns the "
        "mesh as it is",
        "smoother flat and round parts, sharper edges",
        symbol="n",
        high=100,
    )
    vertex_iterations: int = fields.vertex_passes(
        30, "passes that fit the scanned vertices to the normals of the last stage"
    )
    noise: float = fields.noise(of="")
    boundary: str = fields.boundary("free")
    sliding: str = fields.sliding("auto")
    texture: str = fields.parameter(
        "auto",
        "what the stages took beyond white noise: returned, lost, or by the noise (auto)",
        choices=("auto", "returned", "lost"),
    )


def denoise(mesh: Mesh, parameters: Parameters, on_sweep: OnSweep) -> Result:
    timer = Timer()
    positions = mesh.vertices.copy()
    stages = parameters.iterations
    if not stages:
        return Result(positions, seconds={"normals": 0.0, "sweeps": 0.0})
    noise, is_white, is_uneven = resolve_noise(mesh, parameters.noise)
    if noise == 0.0:
        return Result(positions, seconds={"normals": 0.0, "sweeps": 0.0})
    is_returned = is_white if parameters.texture == "auto" else parameters.texture == "returned"
    cascade = Cascade(mesh, parameters.boundary, noise, is_returned, is_uneven)
    normals: Floats | None = None
    timer.start_sweeps()
    networks = load_networks()
    for done in range(1, stages + 1):
        network = networks[min(done, len(networks)) - 1]
        descriptors = cascade.describe(positions, normals)
        # The previous normals are in the descriptors, and their array is overwritten.
        normals = descriptors.predict(network, normals)
        del descriptors
        if done < stages:
            positions = cascade.fit(positions, normals, STAGE_PASSES)
        else:
            cascade.release()
            positions = cascade.fit(mesh.vertices, normals, parameters.vertex_iterations)
        on_sweep(done, stages)
    assert normals is not None
    positions = undo_sliding(mesh, positions, parameters.sliding, parameters.boundary)
    positions = untangle(positions, normals, mesh.faces, mesh.topology, cascade.free)
    if noise and is_returned:
        positions = return_texture(mesh, positions, noise)
    return timer.finish(positions)


def resolve_noise(mesh: Mesh, given: float) -> tuple[float | None, bool, bool]:
    """The level in mean edge lengths, ``given`` or estimated; whether the noise is white; and
    whether much of the mesh has hardly any.

    The level is 0 if the noise is negligible, and None if it is unknown: for terraces, and for weak
    noise of an unknown kind.  An unsure estimate counts as noise, because the user chose this
    method.  Noise of a given level, and a trace of noise on a clean mesh, count as white; given
    noise does not if it is uneven.
    """
    from msal_cli.analysis.noise_estimate import NOISE, estimate_noise
    from msal_cli.analysis.noise_estimate.fits import NEGLIGIBLE

    estimate = estimate_noise(mesh)
    level = estimate.assume(NOISE, mesh.mean_edge_length)
    kind, is_uneven = level.character.kind, level.is_uneven
    if given:
        return given, not is_uneven, is_uneven
    if kind == "staircase":
        return None, False, False
    if estimate.is_negligible:
        return (0.0 if level.mean_edges < NEGLIGIBLE else level.mean_edges), True, False
    is_open = kind == "unknown" and level.mean_edges < MIN_KNOWN
    return None if is_open else level.of_noisy_part, kind == "white", is_uneven
