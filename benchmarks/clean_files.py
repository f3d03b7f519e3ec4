"""What msal changes on clean files of others, and what it sees once noise is added to them.

    python -m benchmarks.clean_files FOLDER [--most N] [--parts N]

FOLDER holds models that have no noise, in any of the formats.  A file passes if ``msal denoise``
moves it by less than 0.01 mean edge lengths in the mean and 0.1 at most, and turns its normals by
less than 0.5 degrees in the mean.  Then noise is added to up to N files, at most ``PER_FOLDER`` of
a folder, for many are variants of one design.  With ``--parts`` only N parts of each file are
denoised, cut out around random faces: sculptures are closed, their parts are open and face one way.
docs/noise.md has the figures.
"""

from __future__ import annotations

import argparse
import itertools
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from benchmarks import ground_truth, machine
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.noise_estimate import NOISE, NoiseLevel, estimate_noise
from msal_cli.arrays import Floats, Ints
from msal_cli.errors import MsalError
from msal_cli.mesh import Mesh

MAX_MEAN, MAX_MOVE, MAX_TURN = 0.01, 0.1, 0.5
"""Mean and largest move, mean edge lengths, and mean angle of the normals, degrees, of a pass."""

MIN_VERTICES, MAX_VERTICES, LARGE = 400, 40_000, 1_500
"""Vertices of the meshes that get noise, and from which one counts as large."""

PER_FOLDER = 24

PART_VERTICES = 1_000, 40_000
"""Vertices of a part, if that is no more than half of the mesh."""

COMMANDS = {"plain command": [], "--auto": ["--auto"]}

SEED = 1
KINDS = {
    "clean": None,
    "white 0.05": AddedNoise("gaussian-normal", 0.05, SEED),
    "white 0.1": AddedNoise("gaussian-normal", 0.1, SEED),
    "white 0.25": AddedNoise("gaussian-normal", 0.25, SEED),
    "shared over 2 rings 0.15": AddedNoise("correlated", 0.15, SEED, rings=2),
    "view, 1 ring, 0.15": AddedNoise("view", 0.15, SEED, rings=1),
    "quantised 0.3": AddedNoise("quantised", 0.1, SEED, step=0.3),
}


def read_records(folder: Path, options: list[str]) -> list[dict[str, Any]]:
    """The records of the files in ``folder`` after ``msal denoise`` with ``options``."""
    with tempfile.TemporaryDirectory() as target:
        report = Path(target) / "report.json"
        command = [sys.executable, "-m", "msal_cli", "denoise", str(folder), "--quiet", *options]
        command += ["-o", f"{target}/denoised", "--report", str(report)]
        subprocess.run(command, stderr=subprocess.DEVNULL, check=False)
        records: list[dict[str, Any]] = json.loads(report.read_text())["records"]
    return [record for record in records if record["status"] != "failed"]


def passes(record: dict[str, Any]) -> bool:
    """Whether a file is as it was, or nearly so."""
    if record["status"] == "unchanged":
        return True
    moves, turn = record["displacement"], record["normal_change"]["mean_deg"]
    is_still = moves["mean_edges"] < MAX_MEAN and moves["max_edges"] < MAX_MOVE
    return is_still and turn < MAX_TURN


def write_changes(label: str, records: list[dict[str, Any]]) -> str:
    """How many files passed, and what happened to the others."""
    failed = [record for record in records if not passes(record)]
    lines = [f"{label}: {len(records) - len(failed):,} of {len(records):,} files pass"]
    for record in failed:
        moves, noise = record["displacement"], record["noise_estimate"]
        lines.append(
            f"    {Path(record['input']).name}: moves {moves['mean_edges']:.3f} e, at most "
            f"{moves['max_edges']:.2g} e, normals {record['normal_change']['mean_deg']:.1f} "
            f"degrees; {record['choice']['reason']} ({noise['kind']})"
        )
    return "\n".join(lines)


def cut_parts(mesh: Mesh, count: int) -> Iterator[tuple[Floats, Ints]]:
    """Parts of the mesh, of up to half of its vertices: positions (n, 3) and faces (m, 3)."""
    generator = np.random.default_rng(SEED)
    for _ in range(count):
        middle = mesh.vertices[mesh.faces[generator.integers(len(mesh.faces))]].mean(axis=0)
        away = np.sqrt(((mesh.vertices - middle) ** 2).sum(axis=1))
        size = int(np.exp(generator.uniform(*np.log(PART_VERTICES))))
        inside = away <= np.sort(away)[min(size, len(away) // 2)]
        used, faces = np.unique(mesh.faces[inside[mesh.faces].all(axis=1)], return_inverse=True)
        yield mesh.vertices[used], faces.reshape(-1, 3)


def write_parts(folder: Path, count: int) -> str:
    """What both commands change on ``count`` parts of each mesh in ``folder``."""
    with tempfile.TemporaryDirectory() as target:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            try:
                parts = list(cut_parts(ground_truth.opened(path), count))
            except (MsalError, ValueError):
                continue
            for number, (points, faces) in enumerate(parts):
                trimesh.Trimesh(points, faces, process=False).export(
                    f"{target}/{path.stem}_{number}.ply"
                )
        return "\n\n".join(
            write_changes(f"parts, {label}", read_records(Path(target), options))
            for label, options in COMMANDS.items()
        )


def meshes(folder: Path, most: int) -> Iterator[Mesh]:
    """Up to ``most`` meshes in ``folder`` that are neither small nor large."""
    counts: Counter[Path] = Counter()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if counts[path.parent] >= PER_FOLDER or counts.total() >= most:
            continue
        try:
            mesh = ground_truth.opened(path)
        except (MsalError, ValueError):
            continue
        if MIN_VERTICES <= np.count_nonzero(mesh.topology.has_ring) <= MAX_VERTICES:
            counts[path.parent] += 1
            yield mesh


def write_estimates(found: list[tuple[str, bool, NoiseLevel]]) -> str:
    """How many meshes are said to have noise, by what was added and by size."""
    lines = ["| added, e | small | large | unsure | kinds |", "|---|--:|--:|--:|---|"]
    for kind in KINDS:
        among = [(is_large, noise) for name, is_large, noise in found if name == kind]
        cells = []
        for size in (False, True):
            noisy = [not noise.is_negligible for is_large, noise in among if is_large == size]
            cells.append(f"{np.mean(noisy):.1%} of {len(noisy)}" if noisy else "-")
        unsure = np.mean([noise.is_unsure for _, noise in among])
        kinds = Counter(noise.character.kind for _, noise in among).most_common(3)
        words = ", ".join(f"{name} {count}" for name, count in kinds)
        lines.append(f"| {kind} | {cells[0]} | {cells[1]} | {unsure:.0%} | {words} |")
    return "\n".join(lines)


BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.97, 1.01)
"""Bounds of the probabilities that are counted together."""


def write_calibration(found: list[tuple[str, bool, NoiseLevel]]) -> str:
    """How often there is noise, by the probability that is said, with clean meshes as frequent as
    all others together."""
    lines = ["| probability of noise | cases | noisy |", "|---|--:|--:|"]
    said = [
        (reading.probability, kind == "clean")
        for kind, _, noise in found
        for reading in noise.readings
        if reading.kind == NOISE
    ]
    for low, high in itertools.pairwise(BINS):
        among = [is_clean for probability, is_clean in said if low <= probability < high]
        n_clean = sum(among)
        noisy = (len(among) - n_clean) / (len(KINDS) - 1)
        share = f"{noisy / (noisy + n_clean):.0%}" if among else "-"
        lines.append(f"| {low:g} to {min(high, 1.0):g} | {len(among)} | {share} |")
    return "\n".join(lines)


def main(words: list[str] | None = None) -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--most", type=int, default=1_000)
    parser.add_argument("--parts", type=int, default=0)
    arguments = parser.parse_args(words)
    print(machine.line(), end="\n\n")
    if arguments.parts:
        print(write_parts(arguments.folder, arguments.parts))
        return
    for label, options in COMMANDS.items():
        print(write_changes(label, read_records(arguments.folder, options)), end="\n\n")
    found = [
        (kind, len(mesh.vertices) >= LARGE, estimate_noise(noisy))
        for mesh in meshes(arguments.folder, arguments.most)
        for kind, noise in KINDS.items()
        for noisy in [mesh if noise is None else mesh.with_vertices(add_noise(mesh, noise))]
    ]
    print(f"{write_estimates(found)}\n\n{write_calibration(found)}")


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
