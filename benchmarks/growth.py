"""Time and memory from ten thousand vertices to twenty million, and to fifty.

    python -m benchmarks.growth [--most 50] [--repeats 3] [--folder FOLDER] [--cores one|all]

Noisy tori in scan order are written as binary PLY, in pieces, so that making them takes little
memory, and each is denoised by ``msal denoise`` in a process of its own.  Printed are the least
seconds of the runs from fork to exit and the processor time, per million vertices, and the peak of
resident memory per vertex.  A file of four vertices in the same run tells what the interpreter, the
imports and the loading of kernels take; it is subtracted where the table says so.  The last lines
compare the largest mesh with the smallest, and with the one of a million vertices.

MOST is in millions of vertices.  A file takes 38 bytes per vertex on the disk and its output as
much; both are removed before the next is made.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks import machine
from benchmarks.measured import Ran, run
from benchmarks.scans import SURFACES

SIZES = (10_000, 100_000, 1_000_000, 5_000_000, 20_000_000, 50_000_000)
_COMPARED = (
    "time",
    "time without the start",
    "processor time without the start",
    "memory without the start",
)
_AT_ONCE = 500_000
_RUN_ALTOGETHER = 10_000_000
"""Vertices that the runs on one size go through at most, unless one run has more."""


def _header(n_vertices: int, n_faces: int) -> bytes:
    return (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {n_vertices}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {n_faces}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()


def write_torus(path: Path, around: int, across: int) -> None:
    """A noisy torus of ``around`` by ``across`` vertices, row by row; noise of 0.2 of an edge."""
    rows = max(1, _AT_ONCE // across)
    blocks = [range(i, min(i + rows, around)) for i in range(0, around, rows)]
    noise = 0.2 * 2.0 * np.pi * 3.0 / around
    with path.open("wb") as file:
        file.write(_header(around * across, 2 * around * across))
        for block in blocks:
            u, v = np.meshgrid(np.array(block) / around, np.arange(across) / across, indexing="ij")
            points = SURFACES["torus"].points(u.reshape(-1), v.reshape(-1))
            points += np.random.default_rng(block.start).normal(0.0, noise, points.shape)
            file.write(points.astype("<f4").tobytes())
        for block in blocks:
            i, j = np.meshgrid(np.array(block), np.arange(across), indexing="ij")
            here, below = i * across, (i + 1) % around * across
            right = (j + 1) % across
            a, b, c, d = here + j, below + j, below + right, here + right
            facets = np.empty((i.size, 2), dtype=[("n", "u1"), ("corners", "<i4", 3)])
            facets["n"] = 3
            for k, three in enumerate(((a, b, c), (a, c, d))):
                for corner, numbers in enumerate(three):
                    facets["corners"][:, k, corner] = numbers.reshape(-1)
            file.write(facets.tobytes())


def _write_tetrahedron(path: Path) -> None:
    facets = np.empty(4, dtype=[("n", "u1"), ("corners", "<i4", 3)])
    facets["n"] = 3
    facets["corners"] = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype="<f4")
    path.write_bytes(_header(4, 4) + corners.tobytes() + facets.tobytes())


def _least(path: Path, repeats: int, is_pinned: bool) -> Ran:
    """The fastest of several runs; SystemExit if one fails."""
    output = path.with_name("out.ply")
    command = [sys.executable, "-m", "msal_cli", "denoise", str(path), "-o", str(output), "-q"]
    command += ["--method", "msal"]
    runs = []
    for _ in range(repeats):
        runs.append(run(command, is_pinned))
        if runs[-1].fault:
            raise SystemExit(f"{path.name}: {runs[-1].fault}")
        output.unlink()
    best = min(runs, key=lambda one: one.seconds)
    best.cpu_seconds = min(one.cpu_seconds for one in runs)
    # The first run may have compiled a kernel, which takes 150 MB.
    best.peak_bytes = min(one.peak_bytes for one in runs)
    return best


def main(words: list[str] | None = None) -> None:
    """Print the table and the ratios."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--most", type=float, default=20.0, help="millions of vertices")
    parser.add_argument("--least", type=float, default=0.01, help="millions of vertices")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--folder", type=Path, help="where the files are made")
    parser.add_argument("--cores", choices=("one", "all"), default="one")
    arguments = parser.parse_args(words)
    is_pinned = arguments.cores == "one"
    print(machine.line())
    print(f"\nFour sweeps of the default method on {arguments.cores} core(s).\n")
    rows: list[tuple[float, ...]] = []
    by_size: dict[int, tuple[float, ...]] = {}
    if arguments.folder is not None:
        Path(arguments.folder).mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=arguments.folder) as scratch:
        path = Path(scratch) / "torus.ply"
        _write_tetrahedron(path)
        _least(path, 1, is_pinned)  # kernels are compiled
        start = _least(path, max(5, arguments.repeats), is_pinned)
        print(
            f"A file of four vertices: {start.seconds:.3f} s, {start.cpu_seconds:.3f} s of "
            f"processor time, {start.peak_bytes / 1e6:.0f} MB.\n"
        )
        print(
            "| vertices | faces | seconds | s per million | without the start | processor s "
            "| per million without the start | peak MB | bytes per vertex | without the start |"
        )
        print("|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|")
        for size in SIZES:
            if not arguments.least * 1e6 <= size <= arguments.most * 1e6:
                continue
            across = round((size / 2) ** 0.5)
            write_torus(path, 2 * across, across)
            n = 2 * across * across
            repeats = max(1, min(arguments.repeats, _RUN_ALTOGETHER // n))
            ran = _least(path, repeats, is_pinned)
            net = (ran.seconds - start.seconds) * 1e6 / n
            cpu_net = (ran.cpu_seconds - start.cpu_seconds) * 1e6 / n
            held = (ran.peak_bytes - start.peak_bytes) / n
            print(
                f"| {n:,} | {2 * n:,} | {ran.seconds:.2f} | {ran.seconds * 1e6 / n:.2f} "
                f"| {net:.2f} | {ran.cpu_seconds:.2f} | {cpu_net:.2f} "
                f"| {ran.peak_bytes / 1e6:,.0f} | {ran.peak_bytes / n:.0f} | {held:.0f} |",
                flush=True,
            )
            rows.append((ran.seconds * 1e6 / n, net, cpu_net, held))
            by_size[size] = rows[-1]
    for other, name in ((rows[0], "the smallest"), (by_size.get(1_000_000), "a million vertices")):
        if other is None or other is rows[-1]:
            continue
        print(f"\nThe largest to {name}, per vertex:")
        for what, here, there in zip(_COMPARED, rows[-1], other, strict=True):
            print(f"- {what}: {here / there:.2f}")


if __name__ == "__main__":
    main()
