"""What trust in the data term is worth where a part of a scan is poor.

    python -m benchmarks.trust

Takes clean sample meshes, adds noise along the normals of 0.4 mean edge lengths to the 15 % of the
vertices nearest to one of them and of 0.05 to the others, and denoises with ``msal``: once with no
trust, and once with a trust of 0.1 in the poor part and 1 elsewhere.  Prints the table of
docs/algorithm.md: mean angle between face normals and those of the clean mesh in degrees, and mean
distance of the vertices of the poor part from where they were, in mean edge lengths.
"""

from __future__ import annotations

import numpy as np

from benchmarks.sample_accuracy import SAMPLES, opened
from msal_cli import methods
from msal_cli.core.geometry import distances
from msal_cli.mesh import Mesh
from msal_cli.metrics.surface import normal_statistics

NAMES = ("bracket", "coin", "dragon_egg")

POOR, GOOD = 0.4, 0.05
"""Noise of the two parts, in mean edge lengths."""


def errors(truth: Mesh, seed: int = 3) -> list[tuple[float, float]]:
    """Angle (degrees) and distance (mean edge lengths) without and with trust."""
    edge, vertices = truth.mean_edge_length, truth.vertices
    away = np.linalg.norm(vertices - vertices[100], axis=1)
    is_poor = away < np.quantile(away, 0.15)
    size = np.where(is_poor, POOR, GOOD) * edge
    size *= np.random.default_rng(seed).standard_normal(len(vertices))
    noisy = truth.moved(vertices + size[:, None] * truth.vertex_normals())
    trust = np.where(is_poor, 0.1, 1.0)
    method = methods.find("msal")
    rows = []
    for mesh in (noisy, noisy.constrained(None, trust)):
        result = method.denoised(mesh, method.settled({})).vertices
        angle = normal_statistics(truth.moved(result), truth).mean_angular_error_deg
        rows.append((angle, float(distances(vertices, result)[is_poor].mean() / edge)))
    return rows


def main() -> None:
    """Print the table."""
    print("| mesh | angle | with trust | distance | with trust |\n|---|--:|--:|--:|--:|")
    for name in NAMES:
        (angle, distance), (angle_2, distance_2) = errors(
            opened(next(SAMPLES.glob(f"{name}_clean.*"))).mesh
        )
        print(f"| {name} | {angle:.2f} | {angle_2:.2f} | {distance:.3f} | {distance_2:.3f} |")


if __name__ == "__main__":
    main()
