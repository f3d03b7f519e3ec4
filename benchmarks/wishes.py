"""Whether wishes for less move less, and those for more farther, on files of others.

    python -m benchmarks.wishes FOLDER [--most N]

FOLDER holds models of any kind.  Up to N of them get noise of the ``KINDS`` of
benchmarks/clean_files.py in turn, or none, and ``msal denoise`` runs on all with each of the
``WISHES``, plain and with ``--auto``.  docs/auto.md has the result.
"""

from __future__ import annotations

import argparse
import itertools
import random
import tempfile
from pathlib import Path

import numpy as np
import trimesh

from benchmarks import ground_truth, machine
from benchmarks.clean_files import KINDS, MAX_VERTICES, MIN_VERTICES, SEED, read_records
from msal_cli.analysis.added_noise import add_noise
from msal_cli.errors import MsalError

WISHES: dict[str, list[str]] = {
    "-2": ["--strength=-2"],
    "-1": ["--strength=-1"],
    "none": [],
    "+1": ["--strength=1"],
    "+2": ["--strength=2"],
    "texture": ["--keep", "texture"],
}
"""Less to more, and one that is for no more than none."""

LEEWAY = 1e-3
"""Relative difference of mean moves that is rounding of the shares."""


def write_scans(models: Path, target: Path, most: int) -> None:
    """Up to ``most`` of the ``models`` as PLY files in ``target``, with noise of each kind in turn;
    which ones is drawn, always the same."""
    paths = sorted(path for path in models.rglob("*") if path.is_file())
    random.Random(SEED).shuffle(paths)
    count = 0
    for path in paths:
        if count == most:
            return
        try:
            mesh = ground_truth.opened(path)
        except (MsalError, ValueError):
            continue
        if not MIN_VERTICES <= len(mesh.vertices) <= MAX_VERTICES:
            continue
        kind, noise = list(KINDS.items())[count % len(KINDS)]
        vertices = mesh.vertices if noise is None else add_noise(mesh, noise)
        scan = trimesh.Trimesh(vertices, mesh.faces, process=False)
        scan.export(target / f"{count} {kind} {path.stem}.ply")
        count += 1


def find_moves(scans: Path, options: list[str]) -> dict[str, dict[str, float]]:
    """How far each file moves in the mean by each wish, mean edge lengths."""
    found: dict[str, dict[str, float]] = {}
    for wish, words in WISHES.items():
        for record in read_records(scans, [*options, *words]):
            moves = record["displacement"]["mean_edges"] if record["displacement"] else 0.0
            found.setdefault(Path(record["input"]).name, {})[wish] = moves
    return found


def is_ordered(moves: dict[str, float]) -> bool:
    """Whether more moves farther than less, and what keeps texture no farther than no wish."""
    pairs = [*itertools.pairwise(list(WISHES)[:-1]), ("texture", "none")]
    return all(moves[less] <= moves[more] * (1.0 + LEEWAY) for less, more in pairs)


def main(words: list[str] | None = None) -> None:
    """Print how many files are in order, and the others."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--most", type=int, default=70)
    given = parser.parse_args(words)
    print(machine.line(), end="\n\n")
    print("| choice | files | in order |", "|---|--:|--:|", sep="\n")
    others = []
    with tempfile.TemporaryDirectory() as folder:
        write_scans(given.folder, Path(folder), given.most)
        for label, options in (("plain command", []), ("--auto", ["--auto"])):
            found = find_moves(Path(folder), options)
            wrong = {name: moves for name, moves in found.items() if not is_ordered(moves)}
            print(f"| {label} | {len(found)} | {len(found) - len(wrong)} |")
            for name, moves in wrong.items():
                cells = ", ".join(f"{wish} {move:.4f} e" for wish, move in moves.items())
                others.append(f"{label}, {name}: {cells}")
    print("", *others, sep="\n")


if __name__ == "__main__":
    np.seterr(all="ignore")
    main()
