"""How near the noise estimate comes to noise that was put in.

    MSAL_DATA=FOLDER python -m benchmarks.noise_levels [--quick]

Every clean shape of ``ground_truth`` with Gaussian noise along its normals at several levels, then
with noise of other kinds, and with two halves of different noise.  Levels are in mean edge lengths
of the clean shape, estimates in the same; where the true level lies outside the interval given it
has an asterisk.  The tables are in
benchmarks/results/noise_levels.txt.
"""

from __future__ import annotations

import argparse
import functools
import inspect
import resource
from collections.abc import Callable

import numpy as np

from benchmarks import ground_truth, machine
from benchmarks.ground_truth import add_plain_noise
from msal_cli.analysis.noise_estimate import NoiseLevel, characterize, estimate_noise
from msal_cli.mesh import Mesh

LEVELS = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7)
SEED = 7


def moved(true: Mesh, level: float, kind: str = "gaussian-normal", fraction: float = 0.5) -> Mesh:
    """The shape with noise of so many of its mean edge lengths."""
    return (
        true.with_vertices(add_plain_noise(true, kind, level, SEED, fraction=fraction))
        if level
        else true
    )


def halves(true: Mesh) -> Mesh:
    """The shape with noise of 0.05 on one half, and 0.2 on the other."""
    quiet = add_plain_noise(true, "gaussian-normal", 0.05, SEED)
    loud = add_plain_noise(true, "gaussian-normal", 0.2, SEED + 1)
    side = true.vertices[:, 0] < np.median(true.vertices[:, 0])
    return true.with_vertices(np.where(side[:, None], quiet, loud))


def cell(true: Mesh, mesh: Mesh, level: float) -> str:
    """The estimate in mean edge lengths of the true shape."""
    noise = estimate_noise(mesh)
    longer = mesh.mean_edge_length / true.mean_edge_length
    is_within = noise.low * longer <= level <= noise.high * longer
    return f"{noise.mean_edges * longer:.3f}{'' if is_within else '*'}"


def clean_cell(true: Mesh) -> str:
    """The estimate of a shape without added noise, and whether it is none to speak of."""
    noise = estimate_noise(true)
    return f"{noise.mean_edges:.3f}{' –' if noise.is_negligible else ''}"


def rms_cell(true: Mesh, mesh: Mesh) -> str:
    """Level, level with spikes, and tail in per cent."""
    noise: NoiseLevel = estimate_noise(mesh)
    longer = mesh.mean_edge_length / true.mean_edge_length
    return (
        f"{noise.mean_edges * longer:.3f} / {noise.rms_edges * longer:.3f}, "
        f"{100.0 * noise.tail:.1f} %"
    )


def halves_cell(mesh: Mesh, longer: float) -> str:
    """Least and most noisy region."""
    noise = estimate_noise(mesh)
    word = "" if noise.is_uneven else " (even)"
    return f"{noise.lowest * longer:.3f} to {noise.highest * longer:.3f}{word}"


def cpu_seconds(work: Callable[[], object]) -> float:
    """Least processor time of several runs."""

    def spent() -> float:
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return usage.ru_utime + usage.ru_stime

    times = []
    for _ in range(5):
        before = spent()
        work()
        times.append(spent() - before)
    return min(times)


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="leave out large shapes")
    arguments = parser.parse_args(words)
    print(f"{machine.line()}\n")
    heads = [f"{level:g}" if level else "clean" for level in LEVELS]
    print(f"| shape | vertices | {' | '.join(heads)} | ms |")
    print("|---|--:|" + "--:|" * (len(heads) + 1), flush=True)
    shapes = {name: make() for name, make in ground_truth.sources(arguments.quick).items()}
    for name, true in shapes.items():
        cells = [clean_cell(true)]
        cells += [cell(true, moved(true, level), level) for level in LEVELS[1:]]
        true.vertex_normals("uniform", 1)
        # What is kept with the mesh would be found at once.
        spent = cpu_seconds(functools.partial(inspect.unwrap(characterize), true))
        row = f"| {name} | {len(true.vertices):,} | {' | '.join(cells)} | {1000.0 * spent:.1f} |"
        print(row, flush=True)

    print(
        "\n| shape | 0.1 isotropic | 0.5 isotropic | 0.5 on half | 0.3 on a tenth | 0.05 and 0.2 |"
    )
    print("|---|--:|--:|--:|--:|--:|", flush=True)
    for name, true in shapes.items():
        cells = [cell(true, moved(true, level, "gaussian"), level) for level in (0.1, 0.5)]
        cells += [
            rms_cell(true, moved(true, level, "impulsive", fraction))
            for level, fraction in ((0.5, 0.5), (0.3, 0.1))
        ]
        both = halves(true)
        cells.append(halves_cell(both, both.mean_edge_length / true.mean_edge_length))
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
