"""Noisy meshes with their true normals, and what a stage of the cascade learns from them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from msal_cli.core.geometry import face_normals
from msal_cli.core.normal_regression import Network
from msal_cli.mesh import Mesh, prepared
from msal_cli.methods._cascade import Cascade
from msal_cli.methods.learned import STAGE_PASSES
from training.noise_mixture import draw_noise

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]

PATCH_FACES = 12_000
"""Faces that are taken of one mesh at most: more meshes teach more than larger ones."""

CLEAN_ANGLE = 0.05
"""Radians added to the mean angle of a mesh's noise, over which its errors count."""

BALANCE = 0.6
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
        cosine = np.einsum("ij,ij->i", self.cascade.scanned[0], self.truth)
        angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)).mean())
        self.weight = (angle + CLEAN_ANGLE) ** -BALANCE

    def advance(self, network: Network) -> None:
        """Take the stage of ``network``."""
        self.earlier = self.cascade.describe(self.positions, self.earlier).predict(network)
        self.positions = self.cascade.fit(self.positions, self.earlier, STAGE_PASSES)


def cut_patch(vertices: Floats, faces: Ints, generator: Generator) -> Mesh:
    """A mesh of at most ``PATCH_FACES`` of the faces, those nearest to a random one."""
    if len(faces) > PATCH_FACES:
        centroids = vertices[faces].mean(axis=1)
        away = centroids - centroids[int(generator.integers(len(faces)))]
        nearest = np.argsort((away * away).sum(axis=1), kind="stable")[:PATCH_FACES]
        faces = faces[np.sort(nearest)]
    return prepared(vertices, faces).mesh


def draw_meshes(
    shapes: Iterable[tuple[str, Floats, Ints]], copies: int, generator: Generator
) -> list[NoisyMesh]:
    """``copies`` noisy meshes of every shape, each of another part and with other noise."""
    made = []
    for _, vertices, faces in shapes:
        for _ in range(copies):
            clean = cut_patch(vertices, faces, generator)
            noisy = clean.moved(draw_noise(clean, generator))
            truth = face_normals(clean.vertices, clean.faces)
            made.append(NoisyMesh(Cascade(noisy, "free"), truth, noisy.vertices))
    return made


def collect_samples(
    meshes: list[NoisyMesh], per_mesh: int, generator: Generator
) -> tuple[Singles, Singles, Singles, int]:
    """Inputs, targets and weights of the next stage, and how many vectors the inputs have."""
    inputs, targets, weights = [], [], []
    n_vectors = 0
    for one in meshes:
        known = np.flatnonzero(one.truth.any(axis=1) & one.cascade.scanned[0].any(axis=1))
        chosen = np.sort(generator.permutation(known)[:per_mesh])
        descriptors = one.cascade.describe(one.positions, one.earlier)
        n_vectors = descriptors.vectors.shape[1]
        inputs.append(descriptors.inputs()[chosen])
        axes = descriptors.axes[chosen]
        targets.append(np.einsum("kij,kj->ki", axes, one.truth[chosen].astype(np.float32)))
        weights.append(np.full(len(chosen), one.weight, dtype=np.float32))
    all_weights = np.concatenate(weights)
    all_weights /= all_weights.mean(dtype=np.float64)
    return np.concatenate(inputs), np.concatenate(targets), all_weights, n_vectors
