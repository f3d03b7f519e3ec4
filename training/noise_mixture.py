"""Noise of every kind for training: which kinds, how often and how strong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Kind:
    """One entry of the mixture.

    Attributes
    ----------
    name : of ``msal_cli.analysis.added_noise.KINDS``, or "none".
    share : how often, relative to the others.
    low, high : levels, mean edge lengths; the logarithm is drawn evenly.
    rings : the most averages over one-rings.
    least_rings : the fewest.
    """

    name: str
    share: float
    low: float = 0.04
    high: float = 0.35
    rings: int = 0
    least_rings: int = 0


WHITE = "gaussian-normal"
"""White noise along the normals."""

MIXTURE = (
    Kind("none", 8.0),
    Kind(WHITE, 3.0, 0.003, 0.04),
    Kind(WHITE, 20.0, 0.08, 0.75),
    Kind(WHITE, 9.0, 0.05, 0.2),
    Kind("gaussian", 7.0, 0.03, 0.35),
    Kind("correlated", 13.0, 0.05, 0.35, rings=4, least_rings=1),
    Kind("view", 8.0, 0.05, 0.4, rings=2),
    Kind("quantised", 5.0, 0.02, 0.3, rings=2),
    Kind("grazing", 4.0, 0.03, 0.2, rings=2),
    Kind("half", 5.0, 0.1, 0.4, rings=1),
    Kind("ramp", 4.0, 0.15, 0.6, rings=1),
    Kind("impulsive", 6.0, 0.15, 0.7),
    Kind("outliers", 4.0, 0.01, 0.2),
)


def draw_noise(mesh: Mesh, generator: Generator) -> tuple[Floats, bool]:
    """Positions (n, 3) with noise of a drawn kind and level, and whether that is white."""
    shares = np.array([kind.share for kind in MIXTURE])
    kind = MIXTURE[int(generator.choice(len(MIXTURE), p=shares / shares.sum()))]
    if kind.name == "none":
        return mesh.vertices, True
    direction = generator.standard_normal(3)
    noise = AddedNoise(
        kind.name,
        level=float(np.exp(generator.uniform(np.log(kind.low), np.log(kind.high)))),
        seed=int(generator.integers(2**31)),
        fraction=_draw_fraction(kind.name, generator),
        rings=int(generator.integers(kind.least_rings, kind.rings + 1)),
        direction=(float(direction[0]), float(direction[1]), float(direction[2])),
        step=float(generator.uniform(0.1, 0.8)),
        border=float(generator.choice([0.0, 0.2])),
    )
    return add_noise(mesh, noise), kind.name == WHITE


def _draw_fraction(name: str, generator: Generator) -> float:
    if name == "outliers":
        return float(generator.uniform(0.005, 0.08))
    return float(generator.choice([generator.uniform(0.05, 0.3), 0.5]))
