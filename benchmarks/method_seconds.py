"""Seconds that every method takes at its default setting, on one core.

    MSAL_DATA=FOLDER python benchmarks/method_seconds.py [--repeats 2]

FOLDER holds clean/igea.ply (134,345 vertices); it gets Gaussian noise of 0.2 mean edge lengths
along its normals.  Printed are the best of the repeats, kernels compiled before, without reading
and writing, beside what C++ implementations took for the same on a machine of the same kind.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

from msal_cli import codecs, methods
from msal_cli.mesh import Mesh, prepare_mesh
from msal_cli.storage import gzip_streams

CPP_SECONDS = {
    "bilateral_non_iterative": 6.0,
    "bilateral_normal": 1.7,
    "guided_normal": 16.0,
    "l0": 60.0,
}


def seconds(mesh: Mesh, name: str, repeats: int) -> float:
    """The least time of ``repeats`` runs at the default setting, one-rings known."""
    method = methods.find(name)
    settled = method.validate({})
    best = float("inf")
    for _ in range(repeats):
        fresh = mesh.with_vertices(mesh.vertices.copy())
        started = time.perf_counter()
        method.denoise(fresh, settled)
        best = min(best, time.perf_counter() - started)
    return best


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=2)
    arguments = parser.parse_args()
    if "MSAL_DATA" not in os.environ:
        parser.error("set MSAL_DATA to the folder that holds clean/igea.ply")
    os.environ["MSAL_THREADS"] = "1"
    path = Path(os.environ["MSAL_DATA"]) / "clean" / "igea.ply"
    opened = codecs.open_mesh(gzip_streams.read_whole(str(path)), path.name)
    clean = prepare_mesh(opened.vertices, opened.faces).mesh
    heights = np.random.default_rng(0).normal(
        0.0, 0.2 * clean.mean_edge_length, len(clean.vertices)
    )
    noisy = clean.with_vertices(clean.vertices + heights[:, None] * clean.vertex_normals())
    small = prepare_mesh(opened.vertices, opened.faces[:2000]).mesh
    print("| method | seconds | C++ |")
    print("|---|--:|--:|")
    for name in methods.names():
        seconds(small, name, 1)  # compiles the kernels
        cpp = CPP_SECONDS.get(name)
        beside = "" if cpp is None else f"{cpp:g}"
        print(f"| {name} | {seconds(noisy, name, arguments.repeats):.2f} | {beside} |", flush=True)


if __name__ == "__main__":
    main()
