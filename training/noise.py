"""Train the noise estimate: the classifier of kinds, and the regressions of rings and levels.

    python -m training.noise -o msal_cli/analysis/noise_estimate/forests.npy

Clean meshes come from ``training.designs``, noise from ``training.noise_samples``.  The same seed,
settings and versions give the same bytes.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli.analysis.noise_estimate import CORRECTED, KIND_NAMES, MAX_RINGS, measured_level
from training.designs import build_design, count_designs
from training.noise_samples import NoiseSample, draw_samples

Arrays = dict[str, Any]
Array = NDArray[Any]

MAX_RINGS_KINDS = ("white", "correlated", "view", "quantised", "uneven")
"""Kinds whose neighbours may share noise."""

WEIGHTS = [
    {"none": 1.5, "uneven": 0.6, "correlated": 0.5, "view": 0.57}.get(name, 1.0)
    for name in KIND_NAMES
]
"""How much samples of each kind count: what is clean must stay, and detail that is on a part of a
design only is more frequent than noise that is.  Of shared noise there are twice as many as of
others, for their levels."""

MAX_LOG_ERROR = 3.0
"""Samples whose level was measured still worse, by its logarithm, teach nothing about levels."""

NEAR = 0.15
"""Relative error of a level that is good enough, in what is reported."""

OF_SCANS = ("correlated", "view", "staircase")
"""Kinds whose levels scans teach, too.  Scans with white noise are off by more than that noise."""

LEVEL_FORESTS, PART = 3, 0.5
"""How many forests give a level, which is their mean, and the part of the samples that each sees:
on shapes like none of these they err less than one forest of all."""

FOLDS = 4
"""Parts of the shapes, each judged by trees that the others grew, for calibration."""


def build_parser() -> argparse.ArgumentParser:
    """The options."""
    parser = argparse.ArgumentParser(prog="python -m training.noise", description=__doc__)
    add = parser.add_argument
    add("-o", "--output", type=Path, required=True, metavar="FILE.npy")
    add("--seed", type=int, default=1)
    add("--designs", type=int, default=6000, help="clean meshes besides the sampled shapes")
    add("--jobs", type=int, default=1, help="processes that make and measure meshes")
    keep = "train the levels only, and keep the trees of kinds and rings that FILE.npy has"
    add("--levels-only", action="store_true", help=keep)
    return parser


def main(words: list[str] | None = None) -> int:
    """Make the meshes, measure them, train, and write the trees."""
    options = build_parser().parse_args(words)
    samples, shapes = collect_samples(options.seed, options.designs, options.jobs, print)
    arrays: Arrays = {}
    if options.levels_only:
        earlier = np.load(options.output)
        arrays |= {name: earlier[name] for name in earlier.dtype.names}
    else:
        arrays |= train_kinds(samples, np.array(shapes))
    arrays |= train_levels(samples, np.array(shapes))
    np.save(options.output, pack_arrays(arrays))
    return 0


def pack_arrays(arrays: Arrays) -> Array:
    """All arrays as one, with a field for each: it is read in a tenth of the time of an archive."""
    fields = [(name, array.dtype, array.shape) for name, array in arrays.items()]
    packed = np.zeros((), np.dtype(fields, align=True))
    for name, array in arrays.items():
        packed[name] = array
    return packed


def collect_samples(
    seed: int, designs: int, jobs: int, report: Callable[[str], object]
) -> tuple[list[NoiseSample], list[int]]:
    """Samples of all shapes and ``designs``, and the number of the shape each is of."""
    samples: list[NoiseSample] = []
    shapes: list[int] = []
    started = time.monotonic()
    tasks = [(seed, index, designs) for index in range(count_designs(designs))]
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        for index, made in enumerate(pool.imap(_sample_design, tasks)):
            samples += made
            shapes += [index] * len(made)
            if index % 50 == 0:
                report(f"{time.monotonic() - started:7.0f} s  {index}: {len(samples)} samples")
    return samples, shapes


def _sample_design(task: tuple[int, int, int]) -> list[NoiseSample]:
    seed, index, designs = task
    np.seterr(all="ignore")
    maker, points, faces = build_design(seed, index, designs)
    generator = np.random.default_rng([seed, 99, index])
    return list(draw_samples(maker, points, faces.astype(np.int32), generator))


def train_kinds(samples: Sequence[NoiseSample], shapes: Array, report: Any = print) -> Arrays:
    """The arrays of the forests of kinds and rings, of s samples and the numbers (s,) of the shapes
    that they are of."""
    numbers, kinds = _numbers_of(samples)
    rings = np.array([sample.rings for sample in samples])
    arrays: Arrays = {"sharpness": np.array(_calibrate(numbers, kinds, shapes, report))}
    classifier = _grow_classifier(numbers, kinds)
    arrays |= _export("kinds", classifier._predictors, classifier._baseline_prediction[0])
    shared = np.isin(kinds, [KIND_NAMES.index(kind) for kind in MAX_RINGS_KINDS])
    model = _grow_rings(numbers[shared], rings[shared].astype(np.float64))
    start = np.atleast_1d(np.squeeze(model._baseline_prediction))
    return arrays | _export("rings", model._predictors, start)


def train_levels(samples: Sequence[NoiseSample], shapes: Array, report: Any = print) -> Arrays:
    """The arrays of the forests of levels, and how far these are off (``spreads``), likewise."""
    numbers, kinds = _numbers_of(samples)
    levels = np.array([sample.level for sample in samples])
    is_added = np.array([not sample.is_scan for sample in samples])
    has_level = (kinds > 0) & (levels > 0.0)
    has_level &= is_added | np.isin(kinds, [KIND_NAMES.index(kind) for kind in OF_SCANS])
    target = np.log(np.maximum(levels, 1e-6)) - find_bases(numbers, kinds)
    has_level &= np.abs(target) < MAX_LOG_ERROR
    spreads = _spread_of_levels(numbers, target, kinds, has_level, shapes, report)
    grown = []
    for kind in map(KIND_NAMES.index, CORRECTED):
        some = has_level & (kinds == kind)
        grown.append(_grow_levels(numbers[some], target[some]))
    rounds = [
        [trees[0] for trees in of_round]
        for member in zip(*grown, strict=True)
        for of_round in zip(*(model._predictors for model in member), strict=True)
    ]
    starts = [np.mean([np.squeeze(m._baseline_prediction) for m in models]) for models in grown]
    return {"spreads": spreads, **_export("levels", rounds, np.array(starts), LEVEL_FORESTS)}


def _numbers_of(samples: Sequence[NoiseSample]) -> tuple[Array, Array]:
    """The numbers (s, k) of samples and the indices (s,) of their kinds."""
    numbers = np.stack([sample.numbers for sample in samples]).astype(np.float32)
    return numbers, np.array([KIND_NAMES.index(sample.kind) for sample in samples])


def find_bases(numbers: Array, kinds: Array) -> Array:
    """Logarithms of the levels (s,) by the measurement that is corrected for each kind."""
    result: Array = np.array(
        [
            measured_level(some, KIND_NAMES[kind], MAX_RINGS) if kind else 0.0
            for some, kind in zip(numbers, kinds, strict=True)
        ]
    )
    return result


def _grow_classifier(numbers: Array, kinds: Array) -> Any:
    from sklearn.ensemble import HistGradientBoostingClassifier

    model = HistGradientBoostingClassifier(
        learning_rate=0.08,
        max_iter=90,
        max_leaf_nodes=15,
        min_samples_leaf=12,
        l2_regularization=2.0,
        max_features=0.35,
        early_stopping=False,
        random_state=1,
    )
    return model.fit(numbers, kinds, sample_weight=np.array(WEIGHTS)[kinds])


def _grow_rings(numbers: Array, target: Array) -> Any:
    from sklearn.ensemble import HistGradientBoostingRegressor

    model = HistGradientBoostingRegressor(
        learning_rate=0.08,
        max_iter=100,
        max_leaf_nodes=20,
        min_samples_leaf=12,
        l2_regularization=1.0,
        max_features=0.4,
        early_stopping=False,
        random_state=2,
    )
    return model.fit(numbers, target)


def _calibrate(numbers: Array, kinds: Array, shapes: Array, report: Any) -> float:
    """By what the sums are multiplied so that probabilities hold on shapes that were not seen."""
    from scipy.optimize import minimize_scalar

    sums = np.zeros((len(kinds), len(KIND_NAMES)))
    for fold in range(FOLDS):
        held = shapes % FOLDS == fold
        model = _grow_classifier(numbers[~held], kinds[~held])
        sums[np.ix_(held, model.classes_)] = model._raw_predict(numbers[held])

    def loss(sharpness: float) -> float:
        scaled = sharpness * sums
        logs = scaled - scaled.max(axis=1, keepdims=True)
        logs -= np.log(np.exp(logs).sum(axis=1, keepdims=True))
        return float(-logs[np.arange(len(kinds)), kinds].mean())

    best = float(minimize_scalar(loss, bounds=(0.3, 1.5), method="bounded").x)
    report(f"held-out: right {np.mean(sums.argmax(axis=1) == kinds):.3f}, sharpness {best:.2f}")
    return best


def _spread_of_levels(
    numbers: Array, target: Array, kinds: Array, known: Array, shapes: Array, report: Any
) -> Array:
    """By kind the 10th and 90th percentile (kinds, 2) of the level over the estimated one, by trees
    that have not seen the shape."""
    spreads = np.ones((len(KIND_NAMES), 2))
    for kind, name in enumerate(KIND_NAMES):
        some = known & (kinds == kind)
        off = target[some]
        if name in CORRECTED:
            for fold in range(FOLDS):
                held = shapes[some] % FOLDS == fold
                models = _grow_levels(numbers[some][~held], target[some][~held])
                off[held] -= np.mean([m.predict(numbers[some][held]) for m in models], axis=0)
        if len(off):
            spreads[kind] = np.exp(np.quantile(off, [0.1, 0.9]))
            near = np.mean(np.abs(np.expm1(-off)) < NEAR)
            report(f"  {name}: level near {near:.3f}, spread {spreads[kind].round(2)}")
    return spreads


def _grow_levels(numbers: Array, target: Array) -> list[Any]:
    from sklearn.ensemble import HistGradientBoostingRegressor

    models = []
    for seed in range(LEVEL_FORESTS):
        model = HistGradientBoostingRegressor(
            loss="absolute_error",
            learning_rate=0.12,
            max_iter=80,
            max_leaf_nodes=15,
            min_samples_leaf=20,
            l2_regularization=2.0,
            max_features=0.1,
            early_stopping=False,
            random_state=seed,
        )
        some = np.random.default_rng(seed).random(len(target)) < PART
        models.append(model.fit(numbers[some], target[some]))
    return models


def _export(name: str, rounds: Any, start: Array, n_forests: int = 1) -> Arrays:
    """The arrays of a forest, or of the mean of some, out of the trees of each round and output."""
    features: list[Array] = []
    thresholds: list[Array] = []
    left: list[Array] = []
    right: list[Array] = []
    values: list[Array] = []
    roots: list[int] = []
    outputs: list[int] = []
    depth = first = 0
    for trees in rounds:
        for output, tree in enumerate(trees):
            nodes = tree.nodes
            own = np.arange(len(nodes))
            leaf = nodes["is_leaf"].astype(bool)
            features.append(np.where(leaf, 0, nodes["feature_idx"]).astype(np.int16))
            thresholds.append(np.where(leaf, 0.0, nodes["num_threshold"]).astype(np.float32))
            left.append(first + np.where(leaf, own, nodes["left"]))
            right.append(first + np.where(leaf, own, nodes["right"]))
            values.append(np.where(leaf, nodes["value"] / n_forests, 0.0).astype(np.float32))
            roots.append(first)
            outputs.append(output)
            depth = max(depth, int(nodes["depth"].max()))
            first += len(nodes)
    return {
        f"{name}_features": np.concatenate(features),
        f"{name}_thresholds": np.concatenate(thresholds),
        f"{name}_left": np.concatenate(left).astype(np.int32),
        f"{name}_right": np.concatenate(right).astype(np.int32),
        f"{name}_values": np.concatenate(values),
        f"{name}_roots": np.array(roots, dtype=np.int32),
        f"{name}_outputs": np.array(outputs, dtype=np.int16),
        f"{name}_start": np.asarray(start, dtype=np.float64),
        f"{name}_depth": np.array(depth),
    }


if __name__ == "__main__":
    sys.exit(main())
