"""What the choices make of noisy scans, beside single simple settings and with the true noise.

    MSAL_DATA=FOLDER python -m benchmarks.choices --cache FILE.json [--held-out] [--again NAME ...]

The choices are tuned on the models of ``TUNED``; ``--held-out`` runs all others and the real scans.
Prints angle / distance as ``benchmarks.scanners`` does, kind by kind, and how often a choice is
worse than the default of Taubin's filter and than its input.  ``true plain`` and ``true auto`` know
the noise (``true_noise``): what they still miss is the choice's fault, not the estimate's.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks import scanner_cases, scanner_outcomes
from benchmarks.scanner_cases import CLEAN, Pair
from benchmarks.scanner_outcomes import NOISY, Outcome, Outcomes, Row
from benchmarks.scanner_tables import Rows, cell, errors_of
from msal_cli.analysis.measures import nearest_on_surface, share_over_rings
from msal_cli.analysis.noise_estimate import NoiseCharacter, NoiseLevel, estimate_noise
from msal_cli.arrays import Floats
from msal_cli.kernels.geometry import face_normals, ring_means
from msal_cli.mesh import Mesh

TUNED = ("joint", "bumpy_torus", "fandisk", "bracket")

TAUBIN = "taubin"

SIMPLE = (
    "learned",
    TAUBIN,
    "windowed_sinc(iterations=50,pass_band=0.01)",
    "windowed_sinc(iterations=30,pass_band=0.05)",
    "hc",
)
CHOICES = ("plain", "auto")
TRUE = "true "

WORSE = 1.01
"""Ratio of angles from which a result counts as worse."""


def true_noise(pair: Pair) -> tuple[NoiseLevel, Floats]:
    """The noise as the estimate should give it, and its level (n,) around each vertex in mean edge
    lengths: from the heights of the noisy vertices over the true surface."""
    mesh, edge = pair.noisy, pair.noisy.mean_edge_length
    moves, normals = _moves(pair), mesh.vertex_normals("uniform", 3)
    used = mesh.topology.has_ring
    across = np.einsum("ij,ij->i", moves, normals)
    heights = np.where(used, across, 0.0) / edge
    level = float(np.sqrt((heights[used] ** 2).mean()))
    shared = _share(mesh, heights)
    draws = np.random.default_rng(1).standard_normal(len(heights))
    rings = min(
        range(5), key=lambda k: abs(_share(mesh, share_over_rings(mesh, draws, k)) - shared)
    )
    squares = heights * heights
    for _ in range(20):
        squares = ring_means(squares, *mesh.topology.one_ring)
    local = np.sqrt(squares)
    lowest, highest = np.quantile(local[used], (0.05, 0.95)).tolist()
    within = float(((moves / edge)[used] ** 2).sum(axis=1).mean()) - level * level
    is_isotropic = pair.has_same_faces and not rings and within > level * level
    kind = "correlated" if rings else "isotropic" if is_isotropic else "white"
    character = NoiseCharacter(kind, rings, "isotropic" if is_isotropic else "normals")
    known = estimate_noise(mesh)
    return (
        NoiseLevel(
            level,
            level,
            level,
            level * edge,
            level,
            max(known.rms_edges, level),
            known.tail,
            level < 0.005,
            lowest,
            highest,
            known.regions,
            character,
        ),
        local,
    )


def _moves(pair: Pair) -> Floats:
    """How far the noisy vertices (n, 3) are from where they belong."""
    if pair.has_same_faces:
        return pair.noisy.vertices - pair.true.vertices
    triangles, distances = nearest_on_surface(pair.noisy.vertices, pair.true)
    normals = face_normals(pair.true.vertices, pair.true.faces)[triangles]
    offset = pair.noisy.vertices - pair.true.vertices[pair.true.faces[triangles, 0]]
    outside = np.sign(np.einsum("ij,ij->i", offset, normals))
    return np.asarray((outside * distances)[:, None] * normals)


def _share(mesh: Mesh, heights: Floats) -> float:
    """Correlation of heights (n,) with the mean over their one-rings."""
    means = ring_means(heights, *mesh.topology.one_ring)
    return float((means * heights).sum() / max((heights * heights).sum(), 1e-300))


@contextlib.contextmanager
def _told(pair: Pair) -> Iterator[None]:
    """Let the choices know the true noise."""
    level, local = true_noise(pair)
    with contextlib.ExitStack() as stack:
        for module in ("adaptive", "search"):
            stack.enter_context(
                mock.patch(f"msal_cli.auto.{module}.estimate_noise", lambda mesh: level)
            )
        for module in ("auto.adaptive", "auto.search", "auto.samples", "methods.blend"):
            stack.enter_context(mock.patch(f"msal_cli.{module}.local_levels", lambda mesh: local))
        yield


def run(pair: Pair, name: str) -> Outcome:
    """What a command, perhaps one that knows the noise, makes of a scan."""
    if not name.startswith(TRUE):
        return scanner_outcomes.run_command(pair, name)
    with _told(pair):
        return scanner_outcomes.run_command(pair, name.removeprefix(TRUE))


def count_worse(rows: Row, name: str, than: str) -> bool:
    return rows[name].errors.angle_deg > WORSE * rows[than].errors.angle_deg


def tables(found: Mapping[str, Rows], names: tuple[str, ...]) -> list[str]:
    """A line for each kind, and the counts."""
    lines = [f"| kind | {' | '.join((NOISY, *names))} |", "|---|" + "--:|" * (len(names) + 1)]
    noisy = {kind: rows for kind, rows in found.items() if kind != CLEAN}
    for kind, rows in found.items():
        cells = [cell(errors_of(rows, name).mean(axis=0)) for name in (NOISY, *names)]
        lines.append(f"| {kind} ({len(rows)}) | " + " | ".join(cells) + " |")
    for name in names:
        if name in SIMPLE:
            continue
        cases = [row for rows in noisy.values() for row in rows.values()]
        worse = [sum(count_worse(row, name, than) for row in cases) for than in (TAUBIN, NOISY)]
        missed = [
            kind
            for kind, rows in noisy.items()
            if errors_of(rows, name)[:, 0].mean()
            > WORSE * min(errors_of(rows, one)[:, 0].mean() for one in SIMPLE)
        ]
        lines.append(
            f"{name}: angle worse than Taubin's in {worse[0]}, than the input's in {worse[1]} of "
            f"{len(cases)}; worse than the best simple setting of the kind in {len(missed)} of "
            f"{len(noisy)}: {', '.join(missed)}"
        )
    return lines


def main(words: list[str] | None = None) -> None:
    """Run what is missing and print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cache", type=Path, help="JSON file that keeps what was run")
    parser.add_argument("--held-out", action="store_true", help="models that nothing is tuned to")
    parser.add_argument("--again", nargs="*", default=[], help="names that are run anew")
    parser.add_argument("--names", nargs="+", default=CHOICES, help="run beside simple settings")
    parser.add_argument("--kinds", nargs="+", help="only kinds with one of these words")
    parser.add_argument("--models", nargs="+", help="only models with one of these words")
    given = parser.parse_args(words)
    outcomes = Outcomes(given.cache, None, run)
    found = scanner_cases.cases(kinds=given.kinds, models=given.models)
    cases = {
        kind: [case for case in some if (case.model in TUNED) != given.held_out]
        for kind, some in found.items()
    }
    outcomes.forget(given.again, [case.key for some in cases.values() for case in some])
    names = (*given.names, *SIMPLE)
    rows = {kind: outcomes.run(some, names, ()) for kind, some in cases.items() if some}
    print("\n".join(tables(rows, names)))


if __name__ == "__main__":
    main()
