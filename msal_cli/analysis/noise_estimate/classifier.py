"""How probable each kind of noise is, and its level, by the numbers of ``evidence``.

Boosted trees, trained by ``python -m training.noise`` on scripted shapes with noise of every kind
and without, give a sum for each kind; the probabilities are its softmax, calibrated on shapes that
the trees had not seen.  Another forest tells over how many rings neighbours share it; the level is
the one measured for the kind.  Numbers are compared in single precision, so that every
processor takes the same branches.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Container
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate.level import KINDS
from msal_cli.arrays import Floats

WEIGHTS = Path(__file__).with_name("forests.npz")

NO_NOISE = "none"

KIND_NAMES = KINDS[:-1]
"""The outputs of the classifier: all kinds but ``unknown``."""

LEVELS = ("white", "rms", "colour", "axis", "axis_colour", "steps", "regions")
"""The measurements of the level that the numbers begin with, as logarithms."""

LEVEL_OF_KIND = {
    "white": "white",
    "isotropic": "white",
    "correlated": "colour",
    "view": "axis",
    "quantised": "steps",
    "uneven": "regions",
    "outliers": "white",
    "impulsive": "rms",
    "staircase": "steps",
}
"""Which of them is that of a kind."""

SIZE = len(LEVELS)
"""Which of the numbers is the logarithm of the number of vertices."""

MANY_VERTICES, FEWER = 1_500, 1.6
"""Vertices below which a mesh is a design rather than a scan, and the power of their number with
which the odds of noise fall."""

MISSING = -30.0
"""In place of a number that is not known; all others are greater."""

MAX_RINGS, MIN_SHARED = 4, 0.95
"""Most rings, and the estimated number of them below which neighbours share nothing."""


@dataclass(frozen=True, eq=False)
class Forest:
    """Binary trees whose leaves add up, one sum for each output; a leaf is its own child.

    Attributes
    ----------
    features : (k,) which number a node compares.
    thresholds : (k,) float32; numbers up to it go left.
    left, right : (k,) children.
    values : (k,) what a leaf adds; 0 at other nodes.
    roots, outputs : (t,) first node and output of each tree.
    start : (o,) each output without trees.
    depth : levels below the roots.
    """

    features: NDArray[np.int16]
    thresholds: NDArray[np.float32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    values: NDArray[np.float32]
    roots: NDArray[np.int32]
    outputs: NDArray[np.int16]
    start: Floats
    depth: int

    def evaluate(self, numbers: Floats) -> Floats:
        """The outputs (o,) for the numbers (f,) of one mesh."""
        compared = numbers.astype(np.float32)
        nodes = self.roots
        for _ in range(self.depth):
            goes_left = compared[self.features[nodes]] <= self.thresholds[nodes]
            nodes = np.where(goes_left, self.left[nodes], self.right[nodes])
        added = np.bincount(self.outputs, self.values[nodes], len(self.start))
        return np.asarray(self.start + added)


@dataclass(frozen=True, eq=False)
class Classifier:
    """The trained forests.

    Attributes
    ----------
    kinds, rings : of the sums by kind, and of the number of rings.
    sharpness : by what sums are multiplied so that probabilities hold.
    spreads : (kinds, 3) true level over the measured one: what it exceeds in nine of ten cases, in
        half of them, and in one.
    """

    kinds: Forest
    rings: Forest
    sharpness: float
    spreads: Floats


@dataclass(frozen=True)
class Verdict:
    """What the classifier says of one mesh.

    Attributes
    ----------
    noise : probability that there is noise, 0 to 1.
    kind : the most probable kind of noise, as if there was some.
    probability : of that kind.
    level, low, high : its level and an interval for it, mean edge lengths, as if there was some.
    rings : over how many rings neighbours share it, 0 to 4.
    """

    noise: float
    kind: str
    probability: float
    level: float
    low: float
    high: float
    rings: int


@functools.cache
def load_classifier() -> Classifier:
    """The forests of the package."""
    with np.load(WEIGHTS, allow_pickle=False) as arrays:
        forests = {
            name: Forest(
                features=arrays[f"{name}_features"],
                thresholds=arrays[f"{name}_thresholds"],
                left=arrays[f"{name}_left"],
                right=arrays[f"{name}_right"],
                values=arrays[f"{name}_values"],
                roots=arrays[f"{name}_roots"],
                outputs=arrays[f"{name}_outputs"],
                start=arrays[f"{name}_start"],
                depth=int(arrays[f"{name}_depth"]),
            )
            for name in ("kinds", "rings")
        }
        sharpness, spreads = float(arrays["sharpness"]), arrays["spreads"]
    return Classifier(**forests, sharpness=sharpness, spreads=spreads)


def measured_level(numbers: Floats, kind: str, rings: int) -> float:
    """Logarithm of the level that was measured for a kind; mean edges."""
    name = "axis_colour" if kind == "view" and rings else LEVEL_OF_KIND[kind]
    value = float(numbers[LEVELS.index(name)])
    return value if value > MISSING else float(numbers[LEVELS.index("white")])


def classify(numbers: Floats, possible: Container[str]) -> Verdict:
    """What the numbers (k,) of a mesh say, if its noise is of a ``possible`` kind."""
    trained = load_classifier()
    sums = trained.sharpness * trained.kinds.evaluate(numbers)
    sums[0] -= FEWER * min(float(numbers[SIZE]) - math.log(MANY_VERTICES), 0.0)
    chances = np.exp(sums - sums.max())
    chances /= chances.sum()
    by_kind = {
        name: float(chance)
        for name, chance in zip(KIND_NAMES, chances, strict=True)
        if name != NO_NOISE and name in possible
    }
    kind = max(by_kind, key=lambda name: by_kind[name])
    index = KIND_NAMES.index(kind)
    shared = float(trained.rings.evaluate(numbers)[0])
    rings = min(round(shared), MAX_RINGS) if shared > MIN_SHARED else 0
    level = math.exp(measured_level(numbers, kind, rings))
    return Verdict(
        noise=1.0 - float(chances[0]),
        kind=kind,
        probability=by_kind[kind],
        level=level,
        low=level * min(float(trained.spreads[index, 0]), 1.0),
        high=level * max(float(trained.spreads[index, 2]), 1.0),
        rings=rings,
    )
