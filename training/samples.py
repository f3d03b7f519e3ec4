"""Noisy meshes with their true normals, and what a stage of the cascade learns from them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from msal_cli.core.geometry import face_normals
from msal_cli.core.normal_regression import Descriptors, Network
from msal_cli.mesh import prepared
from msal_cli.methods._cascade import Cascade
from msal_cli.methods.learned import STAGE_PASSES
from training.noise_mixture import draw_noise
from training.scans import draw_scan

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]
Shape = tuple[str, Floats, Ints]
"""A clean mesh: its name, vertices (n, 3) and faces (m, 3)."""

SCAN_SHARE = 0.2
"""Meshes out of simulated scanners; the others have noise added."""

LEAST_FACES = 300
"""Scans of fewer faces teach nothing."""

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
    descriptors : for the next stage, once they are made.
    weight : how much its errors count.
    """

    cascade: Cascade
    truth: Floats
    positions: Floats
    earlier: Floats | None = None
    descriptors: Descriptors | None = None
    weight: float = field(init=False)

    def __post_init__(self) -> None:
        self.weight = (self.mean_angle(self.cascade.scanned[0]) + CLEAN_ANGLE) ** -BALANCE

    def mean_angle(self, normals: Floats) -> float:
        """Mean angle, radians, between normals (m, 3) and the true ones where these are known."""
        cosine = np.einsum("ij,ij->i", normals, self.truth)[self.truth.any(axis=1)]
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)).mean())

    def describe(self) -> Descriptors:
        """The descriptors for the next stage, which ``advance`` uses again."""
        self.descriptors = self.cascade.describe(self.positions, self.earlier)
        return self.descriptors

    def advance(self, network: Network) -> None:
        """Take the stage of ``network``."""
        assert self.descriptors is not None
        self.earlier = self.descriptors.predict(network)
        self.descriptors = None
        self.positions = self.cascade.fit(self.positions, self.earlier, STAGE_PASSES)


def choose_patch(vertices: Floats, faces: Ints, generator: Generator) -> Ints:
    """Indices of at most ``PATCH_FACES`` of the faces, those nearest to a random one."""
    if len(faces) <= PATCH_FACES:
        return np.arange(len(faces), dtype=np.int32)
    centroids = vertices[faces].mean(axis=1)
    away = centroids - centroids[int(generator.integers(len(faces)))]
    nearest = np.argsort((away * away).sum(axis=1), kind="stable")[:PATCH_FACES]
    return np.sort(nearest).astype(np.int32)


def draw_meshes(
    shapes: Iterable[Shape], copies: int, generator: Generator
) -> list[NoisyMesh]:
    """``copies`` noisy meshes of every shape, each of another part and with other noise."""
    made = []
    for _, vertices, faces in shapes:
        for _ in range(copies):
            one = None
            if generator.random() < SCAN_SHARE:
                one = _scan(vertices, faces, generator)
            made.append(one or _add_noise(vertices, faces, generator))
    return made


def _add_noise(vertices: Floats, faces: Ints, generator: Generator) -> NoisyMesh:
    clean = prepared(vertices, faces[choose_patch(vertices, faces, generator)]).mesh
    noisy = clean.moved(draw_noise(clean, generator))
    truth = face_normals(clean.vertices, clean.faces)
    return NoisyMesh(Cascade(noisy, "free"), truth, noisy.vertices)


def _scan(vertices: Floats, faces: Ints, generator: Generator) -> NoisyMesh | None:
    """A part of a simulated scan; None where its faces cannot be taken as they are."""
    points, triangles, truth = draw_scan(prepared(vertices, faces).mesh, generator)
    if len(triangles) < LEAST_FACES:
        return None
    chosen = choose_patch(points, triangles, generator)
    noisy = prepared(points, triangles[chosen])
    if noisy.defects.turned_faces or len(noisy.mesh.faces) != len(chosen):
        return None
    mesh = noisy.mesh
    return NoisyMesh(Cascade(mesh, "free"), truth[chosen], mesh.vertices)


def collect_samples(
    meshes: list[NoisyMesh], per_mesh: int, generator: Generator
) -> tuple[Singles, Singles, Singles, int]:
    """Inputs, targets and weights of the next stage, and how many vectors the inputs have."""
    inputs, targets, weights = [], [], []
    n_vectors = 0
    for one in meshes:
        known = np.flatnonzero(one.truth.any(axis=1) & one.cascade.scanned[0].any(axis=1))
        chosen = np.sort(generator.permutation(known)[:per_mesh])
        descriptors = one.describe()
        n_vectors = descriptors.vectors.shape[1]
        inputs.append(descriptors.inputs()[chosen])
        axes = descriptors.axes[chosen]
        targets.append(np.einsum("kij,kj->ki", axes, one.truth[chosen].astype(np.float32)))
        weights.append(np.full(len(chosen), one.weight, dtype=np.float32))
    all_weights = np.concatenate(weights)
    all_weights /= all_weights.mean(dtype=np.float64)
    return np.concatenate(inputs), np.concatenate(targets), all_weights, n_vectors
