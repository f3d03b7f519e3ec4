"""Nanoseconds per vertex and sweep, beside what it takes to copy the bytes that a sweep touches.

    python -m benchmarks.sweep [--around 1414] [--sweeps 4] [--repeats 7]

The mesh is a noisy torus of ``around`` times half as many vertices, all of valence six, in scan
order; and the same mesh with its vertices shuffled.  Copied are positions, normals, one-rings with
their starts, and for the result positions once more.  Runs take turns, and the least of every one
counts: processor time on one core, which other work disturbs little, and the clock on all cores.
Arrays that a run of sweeps makes, and their page faults, are in its time; kernels are compiled
before.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

import numpy as np

from benchmarks import machine, scans
from msal_cli.kernels.operators import RingOperator
from msal_cli.kernels.parallel import over_ranges
from msal_cli.kernels.sweeps import Schedule, run_sweeps
from msal_cli.machine import usable_cores
from msal_cli.mesh import Mesh


def shuffled(mesh: Mesh) -> Mesh:
    """The same mesh with vertices and faces in random order."""
    random = np.random.default_rng(0)
    old = random.permutation(len(mesh.vertices))
    new = np.empty_like(old)
    new[old] = np.arange(len(old))
    faces = new[mesh.faces][random.permutation(len(mesh.faces))]
    return Mesh(mesh.vertices[old], faces.astype(np.int32))


def runs(mesh: Mesh, sweeps: int) -> dict[str, Callable[[], object]]:
    """What is measured, by name; each makes ``sweeps`` sweeps, or one copy."""
    links = mesh.topology
    normals = mesh.vertex_normals("uniform", 1)
    free = np.ones(len(mesh.vertices), dtype=bool)
    unit = mesh.mean_edge_length
    laplacian = RingOperator(normals, links.ring_start, links.ring, free, unit)
    bilateral = RingOperator(normals, links.ring_start, links.ring, free, unit, unit)
    touched = (mesh.vertices, normals, links.ring_start, links.ring, mesh.vertices)
    copies = [np.zeros_like(one) for one in touched]

    def copied_part(start: int, stop: int) -> None:
        for one, copy in zip(touched, copies, strict=True):
            low, high = (len(one) * at // len(free) for at in (start, stop))
            np.copyto(copy[low:high], one[low:high])

    def run(operator: RingOperator, schedule: Schedule) -> Callable[[], object]:
        return lambda: run_sweeps(mesh.vertices, operator, schedule, sweeps)

    return {
        "copy": lambda: over_ranges(copied_part, len(free)),
        "al": run(laplacian, Schedule()),
        "msal": run(laplacian, Schedule(decay=0.5, quantile=1.0)),
        "bilateral": run(bilateral, Schedule()),
    }


def least(
    runs: dict[str, Callable[[], object]], clock: Callable[[], float], repeats: int
) -> dict[str, float]:
    """The least seconds of every run, taken in turns."""
    best = dict.fromkeys(runs, float("inf"))
    for at in range(repeats + 1):
        for name, run in runs.items():
            started = clock()
            run()
            # The first round compiles, and warms the caches.
            if at:
                best[name] = min(best[name], clock() - started)
    return best


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--around", type=int, default=1414)
    parser.add_argument("--sweeps", type=int, default=4)
    parser.add_argument("--repeats", type=int, default=7)
    chosen = parser.parse_args(words)
    scan = scans.large_torus(chosen.around)
    mesh = Mesh(scan.vertices.astype(np.float64), scan.faces)
    n = len(mesh.vertices)
    orders = {"scan order": runs(mesh, chosen.sweeps)}
    orders["shuffled"] = runs(shuffled(mesh), chosen.sweeps)
    print(machine.line())
    print(f"\n{n:,} vertices, {len(mesh.faces):,} faces; ns per vertex and sweep.\n")
    print("| order | cores | copy | al | / copy | msal | / al | bilateral | / al |")
    print("|---|--:|--:|--:|--:|--:|--:|--:|--:|")
    alone: dict[str, dict[str, float]] = {}
    gains: list[str] = []
    for cores in dict.fromkeys((1, usable_cores())):
        os.environ["MSAL_THREADS"] = str(cores)
        clock = time.process_time if cores == 1 else time.perf_counter
        for order, measured in orders.items():
            seconds = least(measured, clock, chosen.repeats)
            ns = {name: 1e9 * s / n / chosen.sweeps for name, s in seconds.items()}
            ns["copy"] *= chosen.sweeps
            alone.setdefault(order, ns)
            print(
                f"| {order} | {cores} | {ns['copy']:.1f} "
                f"| {ns['al']:.1f} | {ns['al'] / ns['copy']:.1f} "
                f"| {ns['msal']:.1f} | {ns['msal'] / ns['al']:.2f} "
                f"| {ns['bilateral']:.1f} | {ns['bilateral'] / ns['al']:.2f} |",
                flush=True,
            )
            if cores > 1:
                gain_texts = (f"{name} {alone[order][name] / ns[name]:.2f}" for name in ns)
                gains.append(f"{cores} cores against one, {order}: {', '.join(gain_texts)}.")
    print("", *gains, sep="\n")


if __name__ == "__main__":
    main()
