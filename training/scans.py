"""Meshes out of simulated scanners for training, with the true normals of their faces."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.scan_simulation import ScannerSettings, find_truth, simulate_scan
from msal_cli.kernels.geometry import face_normals_and_areas
from msal_cli.mesh import Mesh

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

SHARES = {"voxels": 2.0, "ct": 4.0, "slices": 2.0, "depth": 5.0, "fusion": 2.0}
"""How often each scanner is drawn, relative to the others."""

CELLS = {"ct": (0.9, 1.6), "depth": (0.45, 1.1)}
"""Least and greatest cell, mean edge lengths of the clean mesh; that of ``ct`` for the others."""

LEAST_AREA = 0.05
"""A face whose true area is a smaller share of its own has no true normal that is known."""


def draw_scan(clean: Mesh, generator: Generator) -> tuple[Floats, Ints, Floats, Floats]:
    """Vertices (n, 3) and faces (m, 3) of a scan of the mesh, where the vertices should be, and
    the true normals (m, 3), zero where these are not known."""
    _, vertices, faces, true_vertices = draw_scan_of(clean, generator)
    truth, areas = face_normals_and_areas(true_vertices, faces)
    normals, own_areas = face_normals_and_areas(vertices, faces)
    is_known = (areas > LEAST_AREA * own_areas) & (np.einsum("ij,ij->i", truth, normals) > -0.2)
    return vertices, faces, true_vertices, np.where(is_known[:, None], truth, 0.0)


def draw_scan_of(
    clean: Mesh, generator: Generator, is_aligned: bool = False
) -> tuple[str, Floats, Ints, Floats]:
    """A scanner, vertices (n, 3) and faces (m, 3) of its scan of the mesh, and where the vertices
    should be; the scanner looks along the third axis if it ``is_aligned``."""
    shares = np.array(list(SHARES.values()))
    scanner = list(SHARES)[int(generator.choice(len(SHARES), p=shares / shares.sum()))]
    settings = _draw_settings(scanner, generator)
    if is_aligned:
        settings = dataclasses.replace(settings, direction=(0.0, 0.0, 1.0))
    scan = simulate_scan(clean, settings)
    return scanner, scan.vertices, scan.faces, find_truth(clean, scan)


def _draw_settings(scanner: str, generator: Generator) -> ScannerSettings:
    direction = generator.standard_normal(3)
    given: dict[str, Any] = {
        "direction": (float(direction[0]), float(direction[1]), float(direction[2])),
        "seed": int(generator.integers(2**31)),
        "cell_edges": float(generator.uniform(*CELLS.get(scanner, CELLS["ct"]))),
    }
    correlated = float(generator.choice([0.0, generator.uniform(0.5, 1.5)]))
    if scanner == "ct":
        given |= {"level": float(generator.uniform(0.02, 0.25)), "correlation": correlated}
        given |= {"smoothing": float(generator.uniform(0.3, 1.0))}
    elif scanner == "slices":
        given |= {"slices": int(generator.integers(2, 4))}
    elif scanner in ("depth", "fusion"):
        given |= {"level": float(generator.uniform(0.2, 1.2)), "correlation": correlated}
        given |= {"smoothing": float(generator.uniform(0.0, 1.5))}
        given |= {"step": float(generator.choice([0.0, generator.uniform(0.1, 0.6)]))}
        if scanner == "fusion":
            given |= {"views": int(generator.integers(6, 12))}
    return ScannerSettings(scanner, **given)
