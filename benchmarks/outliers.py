"""How many planted outliers are found, what is taken for one wrongly, and what comes of it.

    MSAL_DATA=FOLDER python -m benchmarks.outliers [--auto] [SHAPE ...]

Outliers are moved by 1 to 3 mean edge lengths in random directions, all other vertices by Gaussian
noise along their normals.  The second table has the errors of the plain command, with --auto those
of --auto too, without and with outliers brought back.  The tables are in
benchmarks/results/outliers.txt.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import ground_truth, machine
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.analysis.measures import (
    measure_surface_change,
    surface_distances,
    vertex_error_percent,
)
from msal_cli.analysis.outliers import find_outliers
from msal_cli.auto import Wishes
from msal_cli.job import choice as automatic
from msal_cli.job.settings import ADAPTIVE, AUTO
from msal_cli.kernels.geometry import distances
from msal_cli.mesh import Mesh

SEED = 11
LEVELS = (0.0, 0.1, 0.2, 0.3)
SHARES = (0.0, 0.005, 0.02, 0.05, 0.1)
GAINS = ("bunny", "igea", "Fandisk", "bracket", "coin")
"""Shapes of the second table."""

Flags = NDArray[np.bool_]


def planted(true: Mesh, level: float, share: float) -> tuple[Mesh, Flags]:
    """The shape with noise and outliers, and which vertices (n,) the outliers are."""
    kind = AddedNoise("outliers", level=level, seed=SEED, fraction=share)
    vertices = add_noise(true, kind)
    far = distances(true.vertices, vertices) > 0.99 * true.mean_edge_length
    return true.with_vertices(vertices), far & true.topology.has_ring


def detection(shapes: Mapping[str, Mesh]) -> None:
    """Print what is found, and what wrongly, mean over the shapes."""
    print("| noise | " + " | ".join(f"{100 * one:g} % outliers" for one in SHARES) + " |")
    print("|--:|" + "--:|" * len(SHARES), flush=True)
    for level in LEVELS:
        cells = []
        for share in SHARES:
            hits, wrong = [], []
            for true in shapes.values():
                mesh, flags = planted(true, level, share)
                found = find_outliers(mesh).flags
                hits.append(100.0 * (found & flags).sum() / max(flags.sum(), 1))
                wrong.append(100.0 * (found & ~flags).sum() / len(flags))
            found_share = f"{np.mean(hits):.1f} %, " if share else ""
            cells.append(f"{found_share}{np.mean(wrong):.2f} % wrongly")
        print(f"| {level:g} | {' | '.join(cells)} |", flush=True)


def errors(mesh: Mesh, true: Mesh, wishes: dict[str, Any] | None) -> str:
    """Angle, vertex error and distance to the surface of what is chosen for a mesh."""
    among = ADAPTIVE if wishes is None else AUTO
    made = automatic.choose(mesh, among, wishes or {}, lambda done, total: None)
    vertices = mesh.vertices
    if made.method is not None:
        run = made.method.denoise(mesh, made.parameters, lambda done, total: None)
        vertices = run.vertices
    result = true.with_vertices(vertices)
    angle = measure_surface_change(true, result).mean_angular_error_deg
    distance = 100.0 * surface_distances(true, result)[0].mean / true.mean_edge_length
    vertices_off = vertex_error_percent(true, result)
    return f"{angle:.2f} / {vertices_off:.1f} / {distance:.1f}"


def gains(shapes: Mapping[str, Mesh], with_auto: bool) -> None:
    """Print the errors of choices without and with outliers brought back."""
    ways: dict[str, dict[str, Any] | None] = {"plain": None}
    if with_auto:
        ways["--auto"] = asdict(Wishes())
    print("\n| shape | noise | " + " | ".join(f"{one}, before | after" for one in ways) + " |")
    print("|---|--:|" + "--:|" * (2 * len(ways)), flush=True)
    for level in (0.0, 0.2):
        for name in GAINS:
            if name not in shapes:
                continue
            true = shapes[name]
            mesh, _ = planted(true, level, 0.05)
            back = mesh.with_vertices(find_outliers(mesh).vertices)
            cells = [errors(one, true, wish) for wish in ways.values() for one in (mesh, back)]
            print(f"| {name} | {level:g} | {' | '.join(cells)} |", flush=True)


def seconds(true: Mesh) -> None:
    """Print processor seconds for 100,000 vertices."""
    for level, share in ((0.0, 0.0), (0.2, 0.0), (0.2, 0.05)):
        mesh, _ = planted(true, level, share)
        times = []
        for _ in range(4):
            before = time.process_time()
            find_outliers(mesh)
            times.append(time.process_time() - before)
        print(
            f"noise {level:g}, {share:g} outliers: {1e8 * min(times) / len(mesh.vertices):.0f} ms"
        )


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--auto", action="store_true", help="the second table with --auto, too")
    parser.add_argument("shapes", nargs="*", metavar="SHAPE", help="only these shapes")
    arguments = parser.parse_args(words)
    print(f"{machine.line()}\n")
    sources = ground_truth.sources()
    names = arguments.shapes or [one for one in sources if one != "dragon"]
    shapes = {name: sources[name]() for name in names}
    detection({name: one for name, one in shapes.items() if name != "igea"})
    gains(shapes, arguments.auto)
    print("\nFor 100,000 vertices:")
    seconds(max(shapes.values(), key=lambda one: len(one.vertices)))


if __name__ == "__main__":
    main()
