"""One small file, from the start of the command to its end, beside other tools.

    MSAL_DATA=FOLDER python -m benchmarks.small_file [--peers-python PATH] [--repeats 15]
        [--forms ply stl obj] [--cores one|all|both] [--peers NAME ...]

As ``benchmarks/large_file.py``, on the bunny (clean/stanford-bunny.obj in MSAL_DATA, with noise of
0.2 mean edge lengths), or on a torus of as many vertices where MSAL_DATA is not set.  Everything
is warm: kernels compiled, modules and libraries in the page cache.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path

import numpy as np

from benchmarks import contest, scans

_AROUND, _ACROSS = 266, 134


def bunny(path: Path) -> scans.Scan:
    """The vertices of the bunny that a face uses, with noise."""
    rows = path.read_text(encoding="ascii").split("\n")
    vertices = np.array([row.split()[1:4] for row in rows if row.startswith("v ")], dtype=float)
    words = [row.split()[1:] for row in rows if row.startswith("f ")]
    faces = np.array([[word.partition("/")[0] for word in row] for row in words], dtype=int) - 1
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3).astype(np.int32)
    edge = np.linalg.norm(vertices[faces[:, 1]] - vertices[faces[:, 0]], axis=1).mean()
    noise = np.random.default_rng(1).normal(0.0, 0.2 * edge, vertices.shape)
    return scans.Scan((vertices + noise).astype(np.float32), faces)


def main(words: list[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    contest.add_options(parser, repeats=15, forms=("ply", "stl", "obj"))
    parser.add_argument("--around", type=int, default=_AROUND)
    arguments = parser.parse_args(words)
    path = Path(os.environ.get("MSAL_DATA", "")) / "clean" / "stanford-bunny.obj"
    if path.exists() and arguments.around == _AROUND:
        name, scan = "bunny", bunny(path)
    else:
        across = max(3, arguments.around * _ACROSS // _AROUND)
        name, scan = "torus", scans.scan("torus", arguments.around, across, noise=0.2, seed=1)
    print(f"A {name} of {len(scan.vertices):,} vertices and {len(scan.faces):,} faces.")
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.folder or Path(scratch)
        whole = f"{name}-{len(scan.vertices)}"
        sources = {
            form: scans.file_of(folder, whole, form, lambda: scan) for form in arguments.forms
        }
        contest.hold(arguments, folder, sources, scan)


if __name__ == "__main__":
    main()
