"""How near each setting comes to the truth on the sample meshes, which come clean and noisy.

    python benchmarks/sample_accuracy.py

Prints benchmarks/results/sample_accuracy.txt: the mean angle between the face normals of the result
and those of the clean mesh in degrees, and the root mean square distance of the vertices from the
clean surface, along its normals, in mean edge lengths.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from msal_cli import codecs, methods
from msal_cli.analysis.measures import measure_surface_change
from msal_cli.mesh import PreparedMesh, prepare_mesh
from msal_cli.storage import gzip_streams

SAMPLES = Path(__file__).resolve().parents[1] / "sample_meshes"

SETTINGS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("msal", {"K": 0.35}),
    ("msal", {}),
    ("msal", {"K": 0.7}),
    ("msal", {"K": 1.0}),
    ("al", {"iterations": 2}),
    ("al", {}),
)


def opened(path: Path) -> PreparedMesh:
    """A sample, ready for computing."""
    data = gzip_streams.expand(path.read_bytes(), path.name)
    mesh_file = codecs.open_mesh(data, path.name)
    return prepare_mesh(mesh_file.vertices, mesh_file.faces)


def errors(name: str) -> list[tuple[float, float]]:
    """Angle (degrees) and distance (mean edge lengths): noisy first, then every setting."""
    noisy, clean = (opened(next(SAMPLES.glob(f"{name}_{k}.*"))) for k in ("noisy", "clean"))
    mesh = noisy.mesh
    truth = mesh.with_vertices(_in_order(noisy, clean) - noisy.origin)
    normals = truth.vertex_normals()
    rows = []
    for setting in (None, *SETTINGS):
        vertices = mesh.vertices
        if setting is not None:
            method = methods.find(setting[0])
            vertices = method.denoise(mesh, method.validate(setting[1])).vertices
        angle = measure_surface_change(mesh.with_vertices(vertices), truth).mean_angular_error_deg
        along = ((vertices - truth.vertices) * normals).sum(axis=1)
        rows.append((angle, float(np.sqrt((along**2).mean()) / truth.mean_edge_length)))
    return rows


def _in_order(noisy: PreparedMesh, clean: PreparedMesh) -> np.ndarray:
    """The clean positions (n, 3), numbered as the noisy mesh's: both weld in the same order."""
    positions = clean.mesh.vertices + clean.origin
    if positions.shape != noisy.mesh.vertices.shape:
        raise SystemExit("the clean and the noisy mesh do not have the same vertices")
    return positions


def main() -> None:
    head = ["noisy", *("K = 0.35", "**K = 0.5**", "K = 0.7", "K = 1", "AL, n = 2", "AL, n = 4")]
    print(f"| model | {' | '.join(head)} |")
    print("|---|" + "--:|" * len(head))
    for name in ("dragon_egg", "coin", "rock", "vase", "bear", "toadstool", "knot", "bracket"):
        cells = [f"{angle:.1f}° / {distance:.3f}" for angle, distance in errors(name)]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
