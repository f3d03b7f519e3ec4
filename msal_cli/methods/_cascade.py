"""The stages of the learned filter, and the weights of its networks.

The weights are two files of ``methods/weights``: ``learned.json``, which describes the layers, and
``learned.f32``, little-endian 32-bit floats.  Each stage has three layers, and each layer its
biases (out,), then its matrix (out, in), row by row.

As evidence, fast filters, each of which is good on some surfaces, give a normal for each face:
``wiener``, for relief; its sweeps alone, which smooth most; and two windowed sincs with pass bands
of 0.1 and 0.03, which reach farther than the neighbours that a face is described by.  In addition
each face gets features of its surroundings, a dozen edges wide: the power of the ripples of the
scan over that of white noise of the same level, the share of shape in what the sweeps removed, and
its power.
"""

import functools
import hashlib
import itertools
import json
from pathlib import Path

import numpy as np

from msal_cli.arrays import Floats, Floats32
from msal_cli.errors import InternalError
from msal_cli.kernels.faces import corner_means, face_rings
from msal_cli.kernels.geometry import average_around, face_normals, ring_means
from msal_cli.kernels.normal_descriptors import NUMBERS
from msal_cli.kernels.normal_regression import (
    GLOBALS,
    STATISTICS,
    Descriptors,
    Evidence,
    Network,
    NormalDescriber,
    count_vectors,
    measure_ripples,
)
from msal_cli.kernels.quantiles import quantile_above_zero
from msal_cli.kernels.restoration import restoration
from msal_cli.kernels.umbrellas import sinc_coefficients, smooth_by_windowed_sinc
from msal_cli.kernels.vertex_update import update_vertices
from msal_cli.mesh import Mesh
from msal_cli.methods._restoration import RestorationParameters, Restored, fit_to_normals, restore
from msal_cli.methods._sliding import measure_second_umbrella
from msal_cli.methods._sweeps import anisotropic_laplacian, free_vertices, ring_of

WEIGHTS = Path(__file__).parent / "weights"

FORMAT = 1

MIN_WHITE, MAX_WHITE = 0.65, 1.5
"""Smallest lower quartile and largest mean of the power of the finest ripples, over that of white
noise of the given level.  Correlated noise has less, and noise stronger than its given level more;
neither can be distinguished from shape."""

UNEVEN = 0.8  # share of the power of the finest ripples around a vertex that counts as noise
CAUTION = 1.0  # see ``restoration``

DOUBT = 0.01
"""Power over that of the noise of which half is restored; noise alone leaves hardly any."""


class Cascade:
    """The stages for one mesh: descriptors at current positions, and vertices fitted to normals.

    Parameters
    ----------
    noise : level of noise, mean edge lengths; None if unknown.
    is_white : whether it is white noise along the normals.
    is_uneven : whether parts of the mesh have hardly any noise.
    """

    def __init__(
        self,
        mesh: Mesh,
        boundary: str,
        noise: float | None,
        is_white: bool = False,
        is_uneven: bool = False,
    ) -> None:
        self.mesh = mesh
        self.free = free_vertices(mesh, boundary)
        self._ripples: Floats | None = measure_ripples(
            mesh.vertices, mesh.vertex_normals(), mesh.topology
        )
        self.evidence = gather_evidence(mesh, noise, is_white, is_uneven, self._ripples)
        mesh.release_normals()
        self._describer: NormalDescriber | None = None

    def describe(self, positions: Floats, earlier: Floats | None) -> Descriptors:
        """The descriptors of all faces at ``positions`` (n, 3), first those of the scan.

        ``earlier`` are the normals (m, 3) of the stage before; None for the first one.  The next
        call overwrites the result.
        """
        mesh = self.mesh
        if self._describer is None:
            rings = face_rings(mesh.faces, mesh.topology, "edge")
            self._describer = NormalDescriber(mesh.faces, mesh.vertices, *rings, self.evidence)
            del rings
        ripples, self._ripples = self._ripples, None
        if ripples is None:
            at_vertices = mesh.with_vertices(positions).vertex_normals()
            ripples = measure_ripples(positions, at_vertices, mesh.topology)
            del at_vertices
        return self._describer.describe(positions, ripples, earlier)

    def release(self) -> None:
        """Free the memory of the descriptors; the next call of ``describe`` allocates it again."""
        self._describer = None

    def fit(self, positions: Floats, normals: Floats, passes: int) -> Floats:
        """Positions (n, 3) fitted to the normals (m, 3) in a number of passes."""
        mesh = self.mesh
        return update_vertices(positions, normals, mesh.faces, mesh.topology, self.free, passes)


def return_texture(mesh: Mesh, positions: Floats, noise: float) -> Floats:
    """Positions (n, 3) with shape restored that a filter removed from ``mesh`` with noise.

    The residual of ``restoration`` is the normal displacement by the filter.  ``noise``, in mean
    edge lengths, is increased where the finest ripples of the residual are stronger than the mean:
    there the noise is uneven.  Fine texture all over the mesh does not increase it.  Nothing is
    restored if the power of the ripples is beyond ``MIN_WHITE`` or ``MAX_WHITE``.
    """
    links = mesh.topology
    count = np.diff(links.ring_start)
    normals = mesh.with_vertices(positions).vertex_normals()
    taken = np.einsum("ij,ij->i", positions - mesh.vertices, normals)
    taken /= noise * mesh.mean_edge_length
    ripples = np.where(count > 0, ring_means(taken, *links.one_ring) - taken, 0.0)
    power = average_around(ripples * ripples * (count / (count + 1.0)), *links.one_ring, AROUND)
    mean = float(power.mean())
    if mean > MAX_WHITE or quantile_above_zero(power, 0.25) < MIN_WHITE:
        return positions
    level = np.sqrt(np.maximum(UNEVEN * power / max(mean, 1.0) ** 2, 1.0))
    back, _ = restoration(taken / level, *links.one_ring, 1.0, CAUTION)
    shape = average_around(back * back, *links.one_ring, AROUND)
    back *= level * shape / (shape + DOUBT) * (noise * mesh.mean_edge_length)
    return positions - back[:, None] * normals


@functools.cache
def load_networks() -> tuple[Network, ...]:
    """The trained networks, one for each stage; InternalError if the files are damaged."""
    return read_networks(WEIGHTS / "learned.json")


def read_networks(header_path: Path) -> tuple[Network, ...]:
    """Read the networks of a header, a JSON file, and the ``.f32`` file beside it."""
    try:
        header = json.loads(header_path.read_text(encoding="utf-8"))
        data = header_path.with_suffix(".f32").read_bytes()
    except (OSError, ValueError) as error:
        raise InternalError(
            f"the weights of the learned filter cannot be read: {error}", hint="install msal again"
        ) from None
    if header["format"] != FORMAT or hashlib.sha256(data).hexdigest() != header["sha256"]:
        raise InternalError(
            "the weights of the learned filter are damaged", hint="install msal again"
        )
    _check_sizes(header["stages"], len(data) // 4)
    numbers = np.frombuffer(data, dtype="<f4").astype(np.float32)
    networks, at = [], 0
    for sizes in header["stages"]:
        layers = []
        for n_in, n_out in itertools.pairwise(sizes):
            bias = numbers[at : at + n_out]
            matrix = numbers[at + n_out : at + n_out * (1 + n_in)].reshape(n_out, n_in)
            at += n_out * (1 + n_in)
            layers.append((bias, matrix))
        networks.append(Network(tuple(layers)))
    return tuple(networks)


def _check_sizes(stages: list[list[int]], count: int) -> None:
    """Raise InternalError for layers of other sizes than the descriptors; kernels do not check."""
    expected = 0
    for stage, sizes in enumerate(stages):
        vectors = count_vectors(stage)
        inputs = 3 * vectors + NUMBERS + STATISTICS + GLOBALS
        is_fit = len(sizes) == 4 and sizes[0] == inputs and sizes[3] == vectors
        if not is_fit or sizes[1] != sizes[2]:
            raise InternalError(
                f"the weights of the learned filter have layers of {sizes} in stage {stage + 1}, "
                f"and {inputs} inputs and {vectors} outputs are needed",
                hint="train them again, or install msal again",
            )
        expected += sum(n_out * (1 + n_in) for n_in, n_out in itertools.pairwise(sizes))
    if expected != count:
        raise InternalError(
            f"the weights of the learned filter are {count:,} numbers instead of {expected:,}",
            hint="train them again, or install msal again",
        )


# Evidence


SINCS = ((20, 0.1), (30, 0.03))  # iterations and pass bands of the windowed sincs
MIN_LEVEL = 1e-3  # smallest level of noise, mean edge lengths, that powers are compared with

WHITE_POWERS = (1.17, 1.85, 3.2)
"""Mean squares of ``measure_ripples`` for white noise of level 1 on the lattice of valence 6."""

AROUND, NEAR = 6, 2  # averages over one-rings of powers, and of shares


def gather_evidence(
    mesh: Mesh, noise: float | None, is_white: bool, is_uneven: bool, ripples: Floats
) -> Evidence:
    """The evidence for ``mesh`` and its ``ripples`` (n, 4); see ``Cascade``."""
    level = max(_guess_level(mesh) if noise is None else noise, MIN_LEVEL)
    unit = level * mesh.mean_edge_length
    parameters = RestorationParameters()
    laplacian = anisotropic_laplacian(mesh, parameters)
    restored = restore(mesh, laplacian, parameters, unit, lambda done, total: None)
    results = [fit_to_normals(mesh, parameters, restored.positions, unit), restored.smooth]
    rings = ring_of(mesh, "curve")
    terms = [sinc_coefficients(pass_band, iterations) for iterations, pass_band in SINCS]
    results += smooth_by_windowed_sinc(mesh.vertices, *rings, terms)
    normals = np.empty((len(mesh.faces), 3 * len(results)), dtype=np.float32)
    for k, result in enumerate(results):
        normals[:, 3 * k : 3 * k + 3] = face_normals(result, mesh.faces)
    statistics = _measure_surroundings(mesh, ripples, restored, unit)
    return Evidence(noise, is_white, is_uneven, normals, statistics)


def _guess_level(mesh: Mesh) -> float:
    """The level of white noise by the umbrella operator applied twice, mean edge lengths."""
    heights, _ = measure_second_umbrella(mesh)
    return heights / (float(np.sqrt(WHITE_POWERS[1])) * (mesh.mean_edge_length or 1.0))


def _measure_surroundings(mesh: Mesh, ripples: Floats, restored: Restored, unit: float) -> Floats32:
    """Features from 0 to 1 of the surroundings of faces (m, STATISTICS), for noise ``unit``."""
    rows = mesh.topology.one_ring
    powers = np.column_stack([ripples[:, :3], restored.returned])
    powers = average_around(powers * powers, *rows, AROUND)
    powers /= powers + np.array([*WHITE_POWERS, 1.0]) * unit**2
    share = average_around(restored.share, *rows, NEAR)
    columns = np.column_stack([powers[:, :3], share, powers[:, 3]])
    return corner_means(columns, mesh.faces)
