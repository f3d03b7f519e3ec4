"""Make the pictures of noise.md: one sample with every kind of noise, and from every scanner.

    python docs/make_noise_pictures.py

Needs scikit-image; takes some seconds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

from make_pictures import DOCS, opened, panel, row, sample, write_png

from benchmarks.scan_simulation import ScannerSettings, simulate_scan
from msal_cli.analysis.added_noise import AddedNoise, add_noise
from msal_cli.mesh import PreparedMesh, prepare_mesh

Array = NDArray[Any]

PART, ANIMAL = "bracket", "bear"
VIEW = (0.45, -0.75, 0.5)

NOISE = (
    (
        AddedNoise("gaussian-normal"),
        AddedNoise("gaussian"),
        AddedNoise("correlated", level=0.4),
        AddedNoise("view", direction=VIEW),
        AddedNoise("quantised", direction=VIEW, level=0.0, step=1.0),
    ),
    (
        AddedNoise("grazing", direction=VIEW),
        AddedNoise("half", direction=(1.0, 0.0, 0.0), level=0.3),
        AddedNoise("ramp", level=0.5),
        AddedNoise("impulsive", level=0.7),
        AddedNoise("outliers", level=0.0, fraction=0.03),
    ),
)
SCANNERS = (
    ScannerSettings("voxels", cells=80),
    ScannerSettings("ct", cells=80, level=0.15),
    ScannerSettings("slices", cells=80),
    ScannerSettings("depth", cells=100, direction=(0.0, -1.0, 0.0)),
    ScannerSettings("fusion", cells=80),
)


def with_noise(ready: PreparedMesh, noise: AddedNoise) -> tuple[Array, Array]:
    """Vertices and triangles of the sample with noise."""
    return add_noise(ready.mesh, noise) + ready.origin, ready.mesh.faces


def scanned(ready: PreparedMesh, settings: ScannerSettings) -> tuple[Array, Array]:
    """Vertices and triangles of the sample as a scanner makes it."""
    scan = simulate_scan(ready.mesh, settings)
    return scan.vertices + ready.origin, scan.faces


def main() -> None:
    part, animal = (prepare_mesh(*opened(sample(name, "clean"))) for name in (PART, ANIMAL))
    size = (230, 200)
    rows = [row([panel(PART, with_noise(part, one), size) for one in some]) for some in NOISE]
    write_png(DOCS / "images" / "noise_kinds.png", np.concatenate(rows), 64)
    panels = [panel(ANIMAL, scanned(animal, one), (230, 250)) for one in SCANNERS]
    write_png(DOCS / "images" / "scanners.png", row(panels), 64)


if __name__ == "__main__":
    main()
