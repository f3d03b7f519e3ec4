"""A network of two hidden layers, trained by Adam in numpy, that weighs candidate normals."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msal_cli.kernels.normal_regression import Network
from msal_cli.methods._cascade import FORMAT

Singles = NDArray[np.float32]

LEAK = np.float32(1.0 / 64.0)
BATCH = 2048
DECAY_1, DECAY_2 = 0.9, 0.999


@dataclass(frozen=True)
class Schedule:
    """How long to train, and how fast.

    Attributes
    ----------
    epochs : passes over the samples.
    rate : first learning rate; it falls to nothing by half a cosine.
    rounding : error, radians, below which the loss is a square instead of an angle.
    """

    epochs: int = 12
    rate: float = 2e-3
    rounding: float = 0.004


def train_network(
    inputs: Singles,
    targets: Singles,
    weights: Singles,
    n_vectors: int,
    n_hidden: int,
    base: int,
    seed: int,
    schedule: Schedule,
    report: Callable[[str], None],
) -> Network:
    """The network that gives ``targets`` best, by the weighted mean angle of the error.

    Parameters
    ----------
    inputs : (k, d), as ``collect_inputs`` gives them: ``n_vectors`` vectors come first.
    targets : (k, 3), the true unit normals along the axes of each face.
    weights : (k,), how much each sample counts.
    base : the vector that counts before anything is learned.
    """
    generator = np.random.default_rng(seed)
    mean = inputs.mean(axis=0, dtype=np.float64).astype(np.float32)
    deviation = np.maximum(inputs.std(axis=0, dtype=np.float64), 1e-3).astype(np.float32)
    sizes = (inputs.shape[1], n_hidden, n_hidden, n_vectors)
    matrices = [
        (generator.standard_normal((a, b)) * np.sqrt(2.0 / a)).astype(np.float32)
        for a, b in itertools.pairwise(sizes)
    ]
    matrices[-1] *= np.float32(0.05)
    biases = [np.zeros(size, dtype=np.float32) for size in sizes[1:]]
    biases[-1][base] = 1.0
    parameters = matrices + biases
    first = [np.zeros_like(one) for one in parameters]
    second = [np.zeros_like(one) for one in parameters]
    n_batches = len(inputs) // BATCH
    steps, step = schedule.epochs * n_batches, 0
    for epoch in range(schedule.epochs):
        order = generator.permutation(len(inputs))
        total = 0.0
        for batch in range(n_batches):
            chosen = order[batch * BATCH : (batch + 1) * BATCH]
            raw = inputs[chosen]
            vectors = raw[:, : 3 * n_vectors].reshape(BATCH, n_vectors, 3)
            values = _forward((raw - mean) / deviation, matrices, biases)
            loss, gradient = _loss(
                values[-1], vectors, targets[chosen], weights[chosen], schedule.rounding
            )
            total += loss
            gradients = _backward(values, matrices, gradient)
            step += 1
            rate = schedule.rate * 0.5 * (1.0 + np.cos(np.pi * step / steps)) + 1e-6
            corrected = rate * np.sqrt(1.0 - DECAY_2**step) / (1.0 - DECAY_1**step)
            for one, g, m, v in zip(parameters, gradients, first, second, strict=True):
                m += np.float32(1.0 - DECAY_1) * (g - m)
                v += np.float32(1.0 - DECAY_2) * (g * g - v)
                one -= np.float32(corrected) * m / (np.sqrt(v) + np.float32(1e-8))
        report(f"  epoch {epoch + 1}: loss {total / n_batches:.5f}")
    # The standardisation of the inputs goes into the first layer.
    matrix = matrices[0] / deviation[:, None]
    layers = [
        (biases[0] - mean @ matrix, np.ascontiguousarray(matrix.T)),
        *[
            (bias, np.ascontiguousarray(one.T))
            for bias, one in zip(biases[1:], matrices[1:], strict=True)
        ],
    ]
    return Network(tuple(layers))


def _forward(x: Singles, matrices: list[Singles], biases: list[Singles]) -> list[Singles]:
    values = [x]
    for at, (matrix, bias) in enumerate(zip(matrices, biases, strict=True)):
        x = values[-1] @ matrix
        x += bias
        if at < len(matrices) - 1:
            np.maximum(x, LEAK * x, out=x)
        values.append(x)
    return values


def _loss(
    shares: Singles, vectors: Singles, targets: Singles, weights: Singles, rounding: float
) -> tuple[float, Singles]:
    """The mean loss of a batch and its gradient by the shares (k, n)."""
    combined = np.einsum("km,kmc->kc", shares, vectors)
    length = np.maximum(np.sqrt((combined * combined).sum(axis=1)), np.float32(1e-3))[:, None]
    unit = combined / length
    away = unit - targets
    error = np.sqrt((away * away).sum(axis=1) + np.float32(rounding**2))
    count = weights / np.float32(len(weights))
    loss = float((error * count).sum(dtype=np.float64))
    by_unit = away * (count / error)[:, None]
    by_combined = (by_unit - unit * (unit * by_unit).sum(axis=1)[:, None]) / length
    return loss, np.einsum("kc,kmc->km", by_combined, vectors)


def _backward(values: list[Singles], matrices: list[Singles], gradient: Singles) -> list[Singles]:
    """Gradients of all matrices, then of all biases."""
    by_matrix, by_bias = [], []
    for at in range(len(matrices) - 1, -1, -1):
        by_matrix.append(values[at].T @ gradient)
        by_bias.append(gradient.sum(axis=0))
        if at:
            gradient = gradient @ matrices[at].T
            gradient *= np.where(values[at] > 0.0, np.float32(1.0), LEAK)
    return by_matrix[::-1] + by_bias[::-1]


def write_networks(header_path: Path, networks: tuple[Network, ...], about: dict[str, str]) -> None:
    """Write what ``read_networks`` reads; ``about`` says in the header how they were trained."""
    parts = [part for one in networks for layer in one.layers for part in layer]
    data = b"".join([part.astype("<f4").tobytes() for part in parts])
    stages = [
        [one.layers[0][1].shape[1], *[len(bias) for bias, _ in one.layers]] for one in networks
    ]
    header = {
        "format": FORMAT,
        **about,
        "stages": stages,
        "sha256": hashlib.sha256(data).hexdigest(),
    }
    header_path.with_suffix(".f32").write_bytes(data)
    header_path.write_text(json.dumps(header, indent=2) + "\n", encoding="utf-8")
