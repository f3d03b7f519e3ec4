"""What every candidate of ``--auto`` costs, in runs of the default filter over the same mesh.

    python benchmarks/candidate_costs.py [--vertices 150000] [--repeats 3]

The mesh is a torus of nearly equilateral triangles with Gaussian noise of 0.2 mean edge lengths,
its vertices in the order of a grid.  Processor time on one core, the least of the repeats, with
kernels compiled before, beside the cost in msal_cli/auto/candidates.py.
"""

from __future__ import annotations

import argparse
import os
import time
from typing import Any

import numpy as np

from benchmarks.ground_truth import add_plain_noise
from msal_cli import methods
from msal_cli.auto.candidates import CANDIDATES
from msal_cli.mesh import Mesh, prepare_mesh

LEVEL = 0.2


def torus(vertices: int) -> Mesh:
    """A torus of radii 3 and 1 of about as many vertices, with noise."""
    around = max(round((vertices / 3.0) ** 0.5), 3)
    u, v = np.meshgrid(
        2.0 * np.pi * np.arange(3 * around) / (3 * around),
        2.0 * np.pi * np.arange(around) / around,
        indexing="ij",
    )
    ring = 3.0 + np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), np.sin(v)], axis=-1)
    i, j = np.meshgrid(np.arange(3 * around), np.arange(around), indexing="ij")
    here, right = i * around + j, (i + 1) % (3 * around) * around + j
    above = i * around + (j + 1) % around
    across = (i + 1) % (3 * around) * around + (j + 1) % around
    faces = np.concatenate(
        [
            np.stack([here, right, across], axis=-1).reshape(-1, 3),
            np.stack([here, across, above], axis=-1).reshape(-1, 3),
        ]
    )
    clean = prepare_mesh(points.reshape(-1, 3), faces.astype(np.int32)).mesh
    return clean.with_vertices(add_plain_noise(clean, "gaussian-normal", LEVEL, 1))


def seconds(mesh: Mesh, name: str, given: dict[str, Any], repeats: int) -> float:
    """The least processor time of a run; the one-rings are known, as they are in a command."""
    method = methods.find(name)
    settled = method.validate(given)
    best = float("inf")
    for _ in range(repeats):
        fresh = mesh.with_vertices(mesh.vertices.copy())
        started = time.process_time()
        method.denoise(fresh, settled)
        best = min(best, time.process_time() - started)
    return best


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--vertices", type=int, default=150_000)
    parser.add_argument("--repeats", type=int, default=3)
    arguments = parser.parse_args()
    os.environ["MSAL_THREADS"] = "1"
    mesh, small = torus(arguments.vertices), torus(2_000)
    unit = seconds(mesh, "msal", {}, arguments.repeats + 2)
    print(f"default filter: {1e9 * unit / len(mesh.vertices):.0f} ns per vertex\n")
    print("| candidate | measured | cost |")
    print("|---|--:|--:|")
    for candidate in CANDIDATES:
        given = candidate.settings(LEVEL)
        seconds(small, candidate.method, given, 1)
        cost = seconds(mesh, candidate.method, given, arguments.repeats) / unit
        print(f"| {candidate.label} | {cost:.1f} | {candidate.cost:g} |", flush=True)


if __name__ == "__main__":
    main()
