"""How often the noise estimate says the right kind, and how near its level comes.

    MSAL_DATA=FOLDER python -m benchmarks.noise_kinds [--quick] [--kind KIND] [--shape SHAPE]

Clean shapes of ``ground_truth`` with noise of every kind that ``msal noise`` adds, and surfaces of
binary voxels.  The true level is the root mean square of what was added, along the direction that
it was added in; estimate and truth are in mean edge lengths of the noisy mesh.  The tables are
in benchmarks/results/noise_kinds.txt.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks import ground_truth, machine
from benchmarks.scan_simulation import ScannerSettings, find_truth, simulate_scan
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.noise_estimate import NoiseLevel, estimate_noise
from msal_cli.mesh import Mesh, prepare_mesh

SHAPES = (
    "Fandisk",
    "SharpSphere",
    "Bunny",
    "Julius",
    "igea",
    "bear",
    "bracket",
    "toadstool",
    "vase",
    "star_prism",
    "stepped_cylinder",
    "chipped_cube",
    "dragon_egg",
    "rock",
    "beast",
    "falconstatue",
    "ogre",
    "scorpion",
    "springer",
)
"""Clean shapes: scans, machined and organic ones, and sculptures.  The trees of the estimate were
grown on none of them."""

SEED = 11
SLANTED = (1.0, 2.0, -3.0)


@dataclass(frozen=True)
class Kind:
    """Noise to add.

    Attributes
    ----------
    noise : what is added, or which scanner makes the mesh; None for nothing.
    right : kinds that the estimate may give.
    """

    noise: AddedNoise | ScannerSettings | None
    right: tuple[str, ...]


KINDS = {
    "clean": Kind(None, ("none",)),
    "white 0.1": Kind(AddedNoise("gaussian-normal", 0.1, SEED), ("white",)),
    "white 0.2": Kind(AddedNoise("gaussian-normal", 0.2, SEED), ("white",)),
    "white 0.4": Kind(AddedNoise("gaussian-normal", 0.4, SEED), ("white",)),
    "isotropic 0.2": Kind(AddedNoise("gaussian", 0.2, SEED), ("isotropic",)),
    "shared, 1 ring": Kind(AddedNoise("correlated", 0.2, SEED, rings=1), ("correlated",)),
    "shared, 2 rings": Kind(AddedNoise("correlated", 0.2, SEED, rings=2), ("correlated",)),
    "shared, 3 rings": Kind(AddedNoise("correlated", 0.2, SEED, rings=3), ("correlated",)),
    "view": Kind(AddedNoise("view", 0.2, SEED), ("view",)),
    "view, 2 rings": Kind(AddedNoise("view", 0.2, SEED, rings=2), ("view",)),
    "view, slanted": Kind(AddedNoise("view", 0.2, SEED, direction=SLANTED), ("view",)),
    "quantised": Kind(AddedNoise("quantised", 0.05, SEED, step=0.5), ("quantised",)),
    "half": Kind(AddedNoise("half", 0.25, SEED), ("uneven",)),
    "ramp": Kind(AddedNoise("ramp", 0.4, SEED), ("uneven",)),
    "2 % on white 0.1": Kind(AddedNoise("outliers", 0.1, SEED, fraction=0.02), ("outliers",)),
    "outliers 5 %": Kind(AddedNoise("outliers", 0.0, SEED, fraction=0.05), ("outliers",)),
    "binary voxels": Kind(ScannerSettings("voxels", SEED), ("staircase",)),
    "slices, 3 apart": Kind(ScannerSettings("slices", SEED), ("staircase",)),
    "impulses, half": Kind(AddedNoise("impulsive", 0.5, SEED, fraction=0.5), ("impulsive",)),
}


@dataclass(frozen=True)
class Outcome:
    """What was estimated for one mesh.

    Attributes
    ----------
    kind, shape : what was added to what.
    level : true level, mean edge lengths of the noisy mesh.
    noise : the estimate.
    """

    kind: str
    shape: str
    level: float
    noise: NoiseLevel

    @property
    def is_right(self) -> bool:
        """Whether the kind is right; no noise to speak of is right for a clean shape."""
        if self.kind == "clean":
            return self.noise.is_negligible or self.noise.character.kind in ("none", "unknown")
        return self.noise.character.kind in KINDS[self.kind].right

    @property
    def error(self) -> float:
        """Relative error of the level; NaN where there is none to compare."""
        level = self.noise.rms_edges if "impulses" in self.kind else self.noise.mean_edges
        return level / self.level - 1.0 if self.level > 0.0 else math.nan


def corrupt(true: Mesh, noise: AddedNoise | ScannerSettings | None) -> tuple[Mesh, float]:
    """The shape with noise, and the level in mean edge lengths of the result."""
    if noise is None:
        return true, 0.0
    if isinstance(noise, ScannerSettings):
        scan = simulate_scan(true, noise)
        ready = prepare_mesh(scan.vertices, scan.faces)
        distances = scan.vertices - find_truth(true, scan)
        rms = math.sqrt(float((distances * distances).sum(axis=1).mean()))
        return ready.mesh, rms / ready.mesh.mean_edge_length
    mesh = true.with_vertices(add_noise(true, noise))
    if noise.kind == "outliers":
        return mesh, noise.level * true.mean_edge_length / mesh.mean_edge_length
    displacements = mesh.vertices - true.vertices
    squares = float((displacements * displacements).sum(axis=1).mean())
    coordinates = 3.0 if noise.kind == "gaussian" else 1.0
    return mesh, math.sqrt(squares / coordinates) / mesh.mean_edge_length


def outcomes(shapes: list[str], kinds: list[str]) -> Iterator[Outcome]:
    """Estimate every kind on every shape whose file is there."""
    sources = ground_truth.sources()
    for shape in shapes:
        if shape not in sources:
            continue
        true = sources[shape]()
        is_open = bool(true.topology.boundary.any())
        for kind in kinds:
            noise = KINDS[kind].noise
            if is_open and isinstance(noise, ScannerSettings):
                # A volume closes an open shape by a surface that has no true one.
                continue
            mesh, level = corrupt(true, noise)
            yield Outcome(kind, shape, level, estimate_noise(mesh))


def write_tables(found: list[Outcome]) -> str:
    """Kind called and error of the level, by kind and shape; then how often which kind is said."""
    kinds = list(dict.fromkeys(one.kind for one in found))
    shapes = list(dict.fromkeys(one.shape for one in found))
    by_case = {(one.kind, one.shape): one for one in found}
    lines = [f"| noise | {' | '.join(shapes)} | right | level within 15 % |"]
    lines.append("|---|" + "---|" * (len(shapes) + 2))
    for kind in kinds:
        cases = [by_case.get((kind, shape)) for shape in shapes]
        row = [case for case in cases if case is not None]
        errors = [one.error for one in row if not math.isnan(one.error)]
        near = sum(abs(error) <= 0.15 for error in errors)
        lines.append(
            f"| {kind} | {' | '.join('–' if case is None else _cell(case) for case in cases)} "
            f"| {sum(one.is_right for one in row)} of {len(row)} "
            f"| {f'{near} of {len(errors)}' if errors else '–'} |"
        )
    called = sorted({one.noise.character.kind for one in found})
    lines += ["", f"| noise | {' | '.join(called)} |", "|---|" + "--:|" * len(called)]
    for kind in kinds:
        counts = Counter(one.noise.character.kind for one in found if one.kind == kind)
        lines.append(f"| {kind} | {' | '.join(str(counts[name] or '') for name in called)} |")
    return "\n".join(lines)


BINS = (0.0, 0.5, 0.7, 0.9, 0.97, 1.01)
"""Bounds of the confidences that are counted together."""


def write_calibration(found: list[Outcome]) -> str:
    """How often the kind is right, by the confidence of the estimate."""
    lines = ["| confidence | cases | right |", "|---|--:|--:|"]
    for low, high in itertools.pairwise(BINS):
        among = [one.is_right for one in found if low <= one.noise.character.confidence < high]
        share = f"{np.mean(among):.0%}" if among else "–"
        lines.append(f"| {low:g} to {min(high, 1.0):g} | {len(among)} | {share} |")
    return "\n".join(lines)


def _cell(one: Outcome) -> str:
    character = one.noise.character
    rings = f" {character.rings}" if character.rings else ""
    kind = "" if one.is_right and one.kind != "clean" else f"{character.kind}"
    if math.isnan(one.error):
        return f"{one.noise.mean_edges:.3f} {kind}".strip()
    return f"{100.0 * one.error:+.0f} %{rings}{' ' + kind if kind else ''}"


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="leave out large shapes")
    parser.add_argument("--kind", action="append", choices=list(KINDS))
    parser.add_argument("--shape", action="append")
    arguments = parser.parse_args(words)
    shapes = arguments.shape or [
        shape for shape in SHAPES if not (arguments.quick and shape in ("igea", "Bunny", "Julius"))
    ]
    found = list(outcomes(shapes, arguments.kind or list(KINDS)))
    print(f"{machine.line()}\n\n{write_tables(found)}\n\n{write_calibration(found)}")
    named = [one for one in found if one.kind != "clean"]
    right = sum(one.is_right for one in named) / max(len(named), 1)
    levels = [abs(one.error) for one in named if not math.isnan(one.error)]
    print(
        f"\nkind right in {right:.0%}; level within 15 % in {np.mean(np.array(levels) <= 0.15):.0%}"
    )


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
