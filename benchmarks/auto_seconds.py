"""Seconds of the plain command and of --auto beside --method msal, by stage, and what was chosen.

    python -m benchmarks.auto_seconds [--across 45 108 577] [--repeats 3] [--cores one all]
        [--folder FOLDER]

Tori with relief, their cells nearly square, with noise of 0.15 mean edge lengths along the
normals, as binary PLY of about 3 * ACROSS * ACROSS vertices: 6 thousand, 35 thousand, a million.
The commands run in turn, after one run of each for the kernels.  Printed are the seconds by stage
of the fastest run of each, those of the whole process from fork to exit, their ratio to MSAL's and
that of the processor times, and what was chosen.  The ratio should not be above 1.5 for the plain
command from 20,000 vertices on, and not above ten for --auto at a million.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks import machine, measured, scans

STAGES = ("read", "connectivity", "choose", "normals", "sweeps", "measure", "write")

PLAIN = "plain"
COMMANDS = ("--method msal", PLAIN, "--auto")
"""By their options; the first is what the others are compared with."""

NOISE = 0.15
"""Standard deviation along the normals, in mean edge lengths."""

# Vertices per wave of the relief along either way round: coarse and fine.
_COARSE, _FINE = 43, 17

# Heights of the waves in mean edge lengths.
_COARSE_HEIGHT, _FINE_HEIGHT = 2.0, 0.7


@dataclass(frozen=True)
class Timed:
    """One run: seconds by stage, of the whole process, of all its threads, and the choice."""

    stages: dict[str, float]
    seconds: float
    cpu_seconds: float
    reason: str


def rippled_torus(across: int) -> scans.Scan:
    """``3 * across`` times ``across`` vertices, whose relief looks alike at any resolution."""
    around = 3 * across
    turns = [2 * np.pi * np.arange(n) / n for n in (around, across)]
    u, v = np.meshgrid(*turns, indexing="ij")
    waves = [max(1, round(n / each)) for each in (_COARSE, _FINE) for n in (around, across)]
    edge = 2 * np.pi / across
    coarse = np.sin(waves[0] * u) * np.sin(waves[1] * v)
    fine = np.sin(waves[2] * u + waves[3] * v)
    relief = 1.0 + edge * (_COARSE_HEIGHT * coarse + _FINE_HEIGHT * fine)
    ring = 3.0 + relief * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), relief * np.sin(v)], axis=-1)
    along = [np.roll(points, -1, axis) - np.roll(points, 1, axis) for axis in (0, 1)]
    normals = np.cross(*along)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    steps = ((1, 0), (0, 1), (1, 1))
    edges = [np.roll(points, (-di, -dj), (0, 1)) - points for di, dj in steps]
    length = np.mean([np.linalg.norm(one, axis=-1) for one in edges])
    heights = np.random.default_rng(1).normal(0.0, NOISE * length, (around, across, 1))
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b, c, d = (
        (i + di) % around * across + (j + dj) % across
        for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1))
    )
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).astype(np.int32)
    return scans.Scan((points + heights * normals).reshape(-1, 3).astype(np.float32), faces)


def timed(source: Path, target: Path, options: Sequence[str], is_pinned: bool) -> Timed:
    """One run of ``msal denoise``."""
    report = target.with_suffix(".jsonl")
    words = ["denoise", str(source), "-o", str(target), "--report", str(report), *options]
    source.read_bytes()
    ran = measured.run([sys.executable, "-m", "msal_cli", *words], is_pinned)
    if ran.fault:
        sys.exit(f"msal: {ran.fault}")
    record = json.loads(report.read_text(encoding="utf-8"))
    choice = record.get("choice") or {}
    return Timed(
        {stage: record["seconds"].get(stage) or 0.0 for stage in STAGES},
        ran.seconds,
        ran.cpu_seconds,
        choice.get("reason", ""),
    )


def row(title: str, one: Timed, msal: Timed) -> str:
    """One line of the table."""
    cells = [f"{one.stages[stage]:.2f}" for stage in STAGES]
    cells += [f"{one.seconds:.2f}", f"{one.cpu_seconds:.2f}"]
    cells += [f"{one.seconds / msal.seconds:.1f}", f"{one.cpu_seconds / msal.cpu_seconds:.1f}"]
    return f"| {title} | {' | '.join(cells)} |"


def main(words: list[str] | None = None) -> None:
    """Print the table, and what was chosen."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--across", type=int, nargs="*", default=[45, 108, 577])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--cores", nargs="*", choices=["one", "all"], default=["one", "all"])
    parser.add_argument("--folder", type=Path, help="where meshes are kept for the next run")
    arguments = parser.parse_args(words)
    print(f"{machine.line()}\n")
    titles = ["vertices", "cores", "run", *STAGES, "whole", "CPU", "ratio", "CPU ratio"]
    print(f"| {' | '.join(titles)} |\n|--:|---|---|" + "--:|" * (len(titles) - 3), flush=True)
    reasons = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        for across in arguments.across:
            n = 3 * across * across

            def made(across: int = across) -> scans.Scan:
                return rippled_torus(across)

            source = scans.file_of(folder, f"rippled-{n}", "ply", made)
            for cores in arguments.cores:
                best = _best(source, Path(scratch) / "out.ply", arguments.repeats, cores == "one")
                for name, one in best.items():
                    print(row(f"{n:,} | {cores} | {name}", one, best["--method msal"]), flush=True)
            reasons += [f"{n:,} vertices, {one}: {best[one].reason}" for one in COMMANDS[1:]]
    print("\n" + "\n".join(reasons))


def _best(source: Path, target: Path, repeats: int, is_pinned: bool) -> dict[str, Timed]:
    """The fastest of ``repeats`` runs of each command, which take turns."""
    runs: dict[str, list[Timed]] = {name: [] for name in COMMANDS}
    for _ in range(repeats + 1):
        for name, found in runs.items():
            options = () if name == PLAIN else tuple(name.split())
            found.append(timed(source, target, options, is_pinned))
    # The first may have compiled kernels.
    return {name: min(found[1:], key=lambda one: one.seconds) for name, found in runs.items()}


if __name__ == "__main__":
    main()
