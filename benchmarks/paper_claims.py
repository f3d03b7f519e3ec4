"""Show the paper's claims on data at hand: cost, texture, volume, irregular meshes, convergence.

    MSAL_DATA=FOLDER python benchmarks/paper_claims.py

FOLDER holds clean/ (fandisk.obj, stanford-bunny.obj, igea.ply) and scans/dragon_vrip_res2.ply.gz.
Prints the tables of benchmarks/results/paper_claims.txt.  Times are the best of five runs on one
core, in one process, and only their ratios mean anything.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path
from typing import Any

import numpy as np

from msal_cli import codecs, methods
from msal_cli.analysis.measures import area_and_volume, measure_surface_change
from msal_cli.mesh import Mesh, PreparedMesh, prepare_mesh
from msal_cli.storage import gzip_streams

SWEEPS = 3
REPEATS = 5


def opened(path: Path) -> PreparedMesh:
    """A mesh file of the data folder."""
    data = gzip_streams.expand(gzip_streams.read_whole(str(path)), path.name)
    mesh_file = codecs.open_mesh(data, path.name)
    return prepare_mesh(mesh_file.vertices, mesh_file.faces)


def with_noise(clean: Mesh, level: float, seed: int = 0) -> Mesh:
    """Uniform noise of +-``level`` mean edge lengths in every coordinate of used vertices."""
    amount = level * clean.mean_edge_length
    noise = np.random.default_rng(seed).uniform(-amount, amount, clean.vertices.shape)
    used = np.diff(clean.topology.ring_start) > 0
    return clean.with_vertices(clean.vertices + noise * used[:, None])


def run(mesh: Mesh, name: str, **given: Any) -> tuple[Mesh, float]:
    """The mesh after a method, and the seconds of its sweeps."""
    method = methods.find(name)
    result = method.denoise(mesh, method.validate(given))
    return mesh.with_vertices(result.vertices), result.seconds["sweeps"]


def errors(clean: Mesh, mesh: Mesh) -> str:
    """Mean angle between face normals / mean vertex distance in % of the mean edge length."""
    used = np.diff(clean.topology.ring_start) > 0
    distance = np.linalg.norm(mesh.vertices - clean.vertices, axis=1)[used].mean()
    angle = measure_surface_change(clean, mesh).mean_angular_error_deg
    return f"{angle:.2f}° / {100 * distance / clean.mean_edge_length:.1f} %"


def cost(mesh: Mesh) -> str:
    """Seconds of a sweep relative to AL's."""
    rows = [
        ("AL", "al", {}, "1"),
        ("MSAL", "msal", {}, "1.12"),
        ("AL, edge length scaling", "al", {"scaling": "edge"}, "1.8"),
        ("AL, lumped mass scaling", "al", {"scaling": "mass"}, "4.7"),
        ("bilateral, one ring", "bilateral", {"variant": "one_ring"}, "1.74"),
        ("bilateral of Fleishman et al.", "bilateral", {"variant": "fleishman"}, "2.47"),
    ]
    best = {row[0]: float("inf") for row in rows}
    for _ in range(REPEATS):
        for label, name, given, _ in rows:
            seconds = run(mesh, name, iterations=SWEEPS, **given)[1]
            best[label] = min(best[label], seconds)
    lines = ["| sweep of | time / AL's | the paper |", "|---|--:|--:|"]
    for label, _, _, paper in rows:
        lines.append(f"| {label} | {best[label] / best['AL']:.2f} | {paper} |")
    return "\n".join(lines)


def texture(folder: Path) -> str:
    """AL, the bilateral filters and MSAL on textured models with 10 % noise."""
    rows = [
        ("noisy", None, {}),
        ("AL", "al", {}),
        ("bilateral, one ring", "bilateral", {"variant": "one_ring"}),
        ("bilateral of Fleishman et al.", "bilateral", {"variant": "fleishman"}),
        ("MSAL, K = 1/2", "msal", {}),
        ("MSAL, K = 1/5", "msal", {"K": 0.2}),
    ]
    models = ["clean/stanford-bunny.obj", "clean/igea.ply", "scans/dragon_vrip_res2.ply.gz"]
    columns: list[list[str]] = []
    for model in models:
        clean = opened(folder / model).mesh
        noisy = with_noise(clean, 0.1)
        columns.append(
            [
                errors(clean, run(noisy, name, iterations=SWEEPS, **given)[0] if name else noisy)
                for _, name, given in rows
            ]
        )
    lines = ["| 3 sweeps | bunny | igea | dragon |", "|---|--:|--:|--:|"]
    for k, (label, _, _) in enumerate(rows):
        lines.append(f"| {label} | " + " | ".join(column[k] for column in columns) + " |")
    return "\n".join(lines)


def shrinkage(clean: Mesh) -> str:
    """Volume of the Fandisk after growing numbers of sweeps."""
    noisy = with_noise(clean, 0.1)
    volume = area_and_volume(noisy)[1]
    lines = ["| sweeps | AL | MSAL |", "|--:|--:|--:|"]
    for sweeps in (1, 2, 3, 4, 8):
        cells = [
            100 * (area_and_volume(run(noisy, name, iterations=sweeps)[0])[1] / volume - 1)
            for name in ("al", "msal")
        ]
        lines.append(f"| {sweeps} | {cells[0]:+.2f} % | {cells[1]:+.2f} % |")
    return "\n".join(lines)


def irregular_torus() -> Mesh:
    """A torus whose triangles differ in edge length by a factor of about ten."""
    across, around = 60, 120
    u = np.linspace(0, 1, around, endpoint=False)
    v = np.linspace(0, 1, across, endpoint=False)
    # A monotone map of the circle onto itself crowds the parameter lines on one side.
    u = u + 0.13 * np.sin(2 * np.pi * u)
    v = v + 0.11 * np.sin(2 * np.pi * v)
    alpha, beta = np.meshgrid(2 * np.pi * u, 2 * np.pi * v, indexing="ij")
    ring = 3 + np.cos(beta)
    vertices = np.stack([ring * np.cos(alpha), ring * np.sin(alpha), np.sin(beta)], axis=-1)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")

    def at(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a % around) * across + b % across

    one = np.stack([at(i, j), at(i + 1, j), at(i + 1, j + 1)], axis=-1)
    two = np.stack([at(i, j), at(i + 1, j + 1), at(i, j + 1)], axis=-1)
    faces = np.concatenate([one.reshape(-1, 3), two.reshape(-1, 3)]).astype(np.int32)
    return prepare_mesh(vertices.reshape(-1, 3), faces).mesh


def irregularity() -> str:
    """Fig. 10 in kind: a mesh of strongly varying triangle size, the same noise everywhere."""
    clean = irregular_torus()
    noisy = with_noise(clean, 0.1)
    rows: list[tuple[str, str | None, dict[str, Any]]] = [
        ("noisy", None, {}),
        ("AL, tau = 1, 3 sweeps", "al", {"iterations": 3}),
        ("AL, lumped mass, 8 sweeps", "al", {"scaling": "mass", "iterations": 8}),
        ("AL, edge length, 8 sweeps", "al", {"scaling": "edge", "iterations": 8}),
        ("MSAL, K = 1/3, 3 sweeps", "msal", {"K": 1 / 3, "iterations": 3}),
    ]
    lines = ["| | error | volume |", "|---|--:|--:|"]
    volume = area_and_volume(clean)[1]
    for label, name, given in rows:
        mesh = run(noisy, name, **given)[0] if name else noisy
        change = 100 * (area_and_volume(mesh)[1] / volume - 1)
        lines.append(f"| {label} | {errors(clean, mesh)} | {change:+.2f} % |")
    return "\n".join(lines)


def convergence(clean: Mesh) -> str:
    """Distance of MSAL's result from its input as the sweeps go on."""
    noisy = with_noise(clean, 0.1)
    lines = ["| sweeps | largest distance from the input, in mean edge lengths |", "|--:|--:|"]
    for sweeps in (1, 2, 4, 8, 16, 64, 256, 1000):
        mesh, _ = run(noisy, "msal", iterations=sweeps)
        largest = np.linalg.norm(mesh.vertices - noisy.vertices, axis=1).max()
        lines.append(f"| {sweeps} | {largest / clean.mean_edge_length:.2g} |")
    return "\n".join(lines)


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.parse_args()
    if "MSAL_DATA" not in os.environ:
        parser.error("set MSAL_DATA to the folder that holds clean/ and scans/")
    os.environ["MSAL_THREADS"] = "1"
    folder = Path(os.environ["MSAL_DATA"])
    fandisk = opened(folder / "clean" / "fandisk.obj").mesh
    igea = with_noise(opened(folder / "clean" / "igea.ply").mesh, 0.1)
    started = time.perf_counter()
    for title, table in (
        ("Cost", cost(igea)),
        ("Texture", texture(folder)),
        ("Volume", shrinkage(fandisk)),
        ("Irregular meshes", irregularity()),
        ("Convergence", convergence(fandisk)),
    ):
        print(f"## {title}\n\n{table}\n")
    print(f"({time.perf_counter() - started:.0f} s in all)")


if __name__ == "__main__":
    main()
