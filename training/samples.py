"""Noisy meshes with their true normals, and what a stage of the cascade learns from them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from msal_cli.errors import ContentError
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.normal_regression import Descriptors, Network
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.methods._cascade import Cascade
from msal_cli.methods.learned import STAGE_PASSES, resolve_noise
from training import relief
from training.inputs import collect_inputs
from training.noise_mixture import draw_noise
from training.scans import draw_scan
from training.surface import LabelledMesh

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Shape = tuple[str, Floats, Ints]
"""A clean mesh: its name, vertices (n, 3) and faces (m, 3)."""

ROUGH_SHARE = 0.25
"""Copies of a shape that get steep relief a few edges wide, as carved and cast surfaces have."""

N_WAVES = 16
"""Plane waves of which that relief is the sum."""

RELIEF_SHARE = 0.15
"""Copies that get relief of ``training.relief`` instead."""

RELIEFS = ("scales", "scales", "cobbles", "hair", "weave", "dents", "rough")

STRETCH_SHARE = 0.2
"""Copies that are flattened along one or two ways: their triangles become narrow."""

COARSE_SHARE = 0.25
"""Copies of a shape at which it is decimated: its detail comes closer to the edges' length."""

SCAN_SHARE = 0.2
"""Meshes out of simulated scanners; the others have noise added."""

LEAST_COARSE = 1_200
"""Faces below which no mesh is decimated."""

LEAST_FACES = 300
"""Scans of fewer faces teach nothing."""

UNKNOWN_SHARE = 0.35
"""Meshes whose noise is not given."""

LEAST_ERROR = 0.015
"""Deviation of the levels that clean meshes are estimated at, mean edge lengths."""

ESTIMATED_SHARE = 0.6
"""Meshes whose noise is what the estimate says of them, with the errors that it has; for the
others it is drawn."""

NAMED_SHARE, MISNAMED_SHARE = 0.85, 0.1
"""Meshes of white noise that it is named for, and meshes of other noise that is named white."""

LOW_SHARE = 0.1
"""Meshes whose noise is given as less than it is."""

PATCH_FACES = 7_000
"""Faces that are taken of one mesh at most: more meshes teach more than larger ones."""

CLEAN_ANGLE = 0.04
"""Radians added to the mean angle of a mesh's noise, over which its errors count."""

BALANCE = 0.7
"""Power of that angle: 0 counts all errors alike, 1 all relative to the noise."""


@dataclass(eq=False)
class NoisyMesh:
    """A noisy mesh on its way through the stages.

    Attributes
    ----------
    cascade : of the noisy mesh.
    truth : (m, 3) true unit normals; zeros where they are not known.
    positions : (n, 3) after the stages so far.
    earlier : (m, 3) normals of the last stage; None before the first.
    weight : how much its errors count.
    """

    cascade: Cascade
    truth: Floats
    positions: Floats
    earlier: Floats | None = None
    weight: float = field(init=False)

    def __post_init__(self) -> None:
        self.weight = (self.mean_angle(self.scanned) + CLEAN_ANGLE) ** -BALANCE

    @property
    def scanned(self) -> Floats:
        """The normals (m, 3) of the scan."""
        return face_normals(self.cascade.mesh.vertices, self.cascade.mesh.faces)

    def mean_angle(self, normals: Floats) -> float:
        """Mean angle, radians, between normals (m, 3) and the true ones where these are known."""
        cosine = np.einsum("ij,ij->i", normals, self.truth)[self.truth.any(axis=1)]
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)).mean())

    def describe(self) -> Descriptors:
        """The descriptors for the next stage; ``cascade.release`` gives their memory back."""
        return self.cascade.describe(self.positions, self.earlier)

    def advance(self, network: Network) -> None:
        """Take the stage of ``network``."""
        self.earlier = self.describe().predict(network)
        self.cascade.release()
        self.positions = self.cascade.fit(self.positions, self.earlier, STAGE_PASSES)


def coarsen(vertices: Floats, faces: Ints, generator: Generator) -> tuple[Floats, Ints]:
    """A mesh with a tenth to six tenths of the faces, or as it is where few would be left."""
    import fast_simplification

    count = int(len(faces) * generator.uniform(0.1, 0.6))
    if count < LEAST_COARSE:
        return vertices, faces
    points, triangles = fast_simplification.simplify(
        vertices.astype(np.float32), faces, target_count=count
    )
    return points.astype(np.float64), triangles.astype(np.int32)


def roughen(vertices: Floats, faces: Ints, generator: Generator) -> tuple[Floats, Ints]:
    """The mesh with relief along its normals: waves 3 to 10 edges long, or ridges of them."""
    mesh = prepare_mesh(vertices, faces).mesh
    edge = mesh.mean_edge_length
    wavelength = edge * float(np.exp(generator.uniform(np.log(3.0), np.log(10.0))))
    ways = generator.standard_normal((N_WAVES, 3))
    ways /= np.sqrt((ways * ways).sum(axis=1))[:, None]
    phases = generator.uniform(0.0, 2.0 * np.pi, N_WAVES)
    waves = np.sin(mesh.vertices @ ways.T * (2.0 * np.pi / wavelength) + phases)
    heights = waves.sum(axis=1) * np.sqrt(2.0 / N_WAVES)
    form = generator.random()
    if form < 0.3:
        heights = np.abs(heights)
    elif form < 0.5:
        heights = np.clip(heights, -0.3, 0.3) * 2.0
    amount = wavelength * float(generator.uniform(0.01, 0.12))
    return mesh.vertices + amount * heights[:, None] * mesh.vertex_normals(), mesh.faces


def carve(vertices: Floats, faces: Ints, generator: Generator) -> tuple[Floats, Ints]:
    """The mesh with relief of ``training.relief``, 3.5 to 14 edges long and rather steep."""
    mesh = prepare_mesh(vertices, faces).mesh
    unit = mesh.mean_edge_length
    wavelength = float(np.exp(generator.uniform(np.log(3.5), np.log(14.0))))
    maker = getattr(relief, f"make_{generator.choice(RELIEFS)}")
    labelled = LabelledMesh(
        mesh.vertices / unit, mesh.faces.astype(np.int64), np.zeros(len(mesh.faces), np.int64)
    )
    amount = wavelength * float(generator.uniform(0.03, 0.15))
    try:
        carved = relief.apply_relief(labelled, maker, wavelength, amount, generator)
    except ValueError:
        # Decimating may leave an edge with more than two faces.
        return vertices, faces
    return carved.vertices * unit, mesh.faces


def stretch(vertices: Floats, generator: Generator) -> Floats:
    """The vertices flattened to 0.4 of their extent or more along three drawn axes."""
    axes = np.linalg.qr(generator.standard_normal((3, 3)))[0]
    factors = np.exp(generator.uniform(np.log(0.4), 0.0, 3))
    stretched: Floats = (vertices @ axes * factors) @ axes.T
    return stretched


def choose_patch(vertices: Floats, faces: Ints, generator: Generator) -> Ints:
    """Indices of at most ``PATCH_FACES`` of the faces, those nearest to a random one."""
    if len(faces) <= PATCH_FACES:
        return np.arange(len(faces), dtype=np.int32)
    centroids = vertices[faces].mean(axis=1)
    away = centroids - centroids[int(generator.integers(len(faces)))]
    nearest = np.argsort((away * away).sum(axis=1), kind="stable")[:PATCH_FACES]
    return np.sort(nearest).astype(np.int32)


def draw_meshes(shapes: Iterable[Shape], copies: int, generator: Generator) -> list[NoisyMesh]:
    """``copies`` noisy meshes of every shape, each of another part and with other noise."""
    made = []
    for _, vertices, faces in shapes:
        for _ in range(copies):
            shape = vertices, faces
            if generator.random() < STRETCH_SHARE:
                shape = stretch(vertices, generator), faces
            if generator.random() < COARSE_SHARE:
                shape = coarsen(vertices, faces, generator)
            if generator.random() < ROUGH_SHARE:
                shape = roughen(*shape, generator)
            elif generator.random() < RELIEF_SHARE / (1.0 - ROUGH_SHARE):
                shape = carve(*shape, generator)
            one = _scan(*shape, generator) if generator.random() < SCAN_SHARE else None
            made.append(one or _add_noise(*shape, generator))
    return made


def _add_noise(vertices: Floats, faces: Ints, generator: Generator) -> NoisyMesh:
    clean = prepare_mesh(vertices, faces[choose_patch(vertices, faces, generator)]).mesh
    positions, is_white = draw_noise(clean, generator)
    noisy = clean.with_vertices(positions)
    truth = face_normals(clean.vertices, clean.faces)
    return _start(noisy, clean.vertices, truth, is_white, generator)


def _scan(vertices: Floats, faces: Ints, generator: Generator) -> NoisyMesh | None:
    """A part of a simulated scan; None where its faces cannot be taken as they are."""
    try:
        scan = draw_scan(prepare_mesh(vertices, faces).mesh, generator)
    except ContentError:
        return None
    points, triangles, true_points, truth = scan
    if len(triangles) < LEAST_FACES:
        return None
    chosen = choose_patch(points, triangles, generator)
    used = np.unique(triangles[chosen])
    number = np.zeros(len(points), dtype=np.int32)
    number[used] = np.arange(len(used))
    noisy = prepare_mesh(points[used], number[triangles[chosen]])
    if (
        noisy.vertex_map is not None
        or noisy.defects.turned_faces
        or len(noisy.mesh.faces) < len(chosen)
    ):
        return None
    true_vertices = true_points[used] - noisy.origin
    return _start(noisy.mesh, true_vertices, truth[chosen], False, generator)


def _start(
    mesh: Mesh, true_vertices: Floats, truth: Floats, is_white: bool, generator: Generator
) -> NoisyMesh:
    noise = draw_estimate(mesh, true_vertices, generator)
    is_named = bool(generator.random() < (NAMED_SHARE if is_white else MISNAMED_SHARE))
    is_uneven = False
    if generator.random() < ESTIMATED_SHARE:
        noise, is_named, is_uneven = resolve_noise(mesh, 0.0)
    cascade = Cascade(mesh, "free", noise, is_named, is_uneven)
    return NoisyMesh(cascade, truth, mesh.vertices)


def draw_estimate(mesh: Mesh, true_vertices: Floats, generator: Generator) -> float | None:
    """What the estimate may say of the noise of a mesh: nearly right, too low, or nothing."""
    heights = np.einsum("ij,ij->i", mesh.vertices - true_vertices, mesh.vertex_normals())
    among = mesh.topology.has_ring
    typical = float(np.median(np.abs(heights[among]))) / 0.6745
    square = float(np.sqrt((heights[among] ** 2).mean()))
    share = generator.random()
    level = (share * typical + (1.0 - share) * square) / mesh.mean_edge_length
    level *= float(np.exp(0.15 * generator.standard_normal()))
    # What has no noise is hardly ever estimated as zero.
    level += LEAST_ERROR * abs(float(generator.standard_normal()))
    kind = generator.random()
    if kind < UNKNOWN_SHARE:
        return None
    if kind < UNKNOWN_SHARE + LOW_SHARE:
        return level * float(generator.random())
    return level


def collect_samples(
    meshes: list[NoisyMesh], per_mesh: int, generator: Generator
) -> tuple[Singles, Singles, Singles, int]:
    """Inputs, targets and weights of the next stage, and how many vectors the inputs have."""
    inputs, targets, weights = [], [], []
    n_vectors = 0
    for one in meshes:
        known = np.flatnonzero(one.truth.any(axis=1) & one.scanned.any(axis=1))
        chosen = np.sort(generator.permutation(known)[:per_mesh])
        descriptors = one.describe()
        n_vectors = descriptors.n_vectors
        inputs.append(collect_inputs(descriptors)[0][chosen])
        axes = descriptors.axes[chosen]
        targets.append(np.einsum("kij,kj->ki", axes, one.truth[chosen].astype(np.float32)))
        weights.append(np.full(len(chosen), one.weight, dtype=np.float32))
        one.cascade.release()
    all_weights = np.concatenate(weights)
    all_weights /= all_weights.mean(dtype=np.float64)
    return np.concatenate(inputs), np.concatenate(targets), all_weights, n_vectors
