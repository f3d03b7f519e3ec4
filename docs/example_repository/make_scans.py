"""Make the three scans beside this file: small shapes with noise of 0.1 mean edge lengths.

    python docs/example_repository/make_scans.py [FOLDER]

Needs numpy only.  Every random number comes from a seeded ``numpy.random.RandomState``, whose
streams numpy keeps unchanged, and positions are rounded to 1e-4 mm.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parent
NOISE = 0.1


def lattice(rows: int, columns: int, wrap_rows: bool, wrap_columns: bool) -> np.ndarray:
    """Triangles (m, 3) of a lattice of ``rows * columns`` vertices, closed where it wraps."""
    row, column = np.meshgrid(
        np.arange(rows if wrap_rows else rows - 1),
        np.arange(columns if wrap_columns else columns - 1),
        indexing="ij",
    )

    def at(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return (i % rows) * columns + j % columns

    lower = np.stack([at(row, column), at(row + 1, column), at(row + 1, column + 1)], axis=-1)
    upper = np.stack([at(row, column), at(row + 1, column + 1), at(row, column + 1)], axis=-1)
    return np.concatenate([lower.reshape(-1, 3), upper.reshape(-1, 3)]).astype("<i4")


def ring(ribs: int, wave: float) -> tuple[np.ndarray, np.ndarray]:
    """A ring with ribs, closed; millimetres."""
    rows, columns = 72, 24
    u, v = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    alpha, beta = 2 * np.pi * u / rows, 2 * np.pi * v / columns
    tube = 4 + wave * np.cos(ribs * alpha)
    reach = 12 + tube * np.cos(beta)
    points = [reach * np.cos(alpha), reach * np.sin(alpha), tube * np.sin(beta)]
    return np.stack(points, axis=-1).reshape(-1, 3), lattice(rows, columns, True, True)


def plaque() -> tuple[np.ndarray, np.ndarray]:
    """A plaque with two waves in relief, open; millimetres."""
    rows, columns = 40, 40
    x, y = np.meshgrid(np.arange(rows) * 0.5, np.arange(columns) * 0.5, indexing="ij")
    z = np.sin(x / 2) * np.cos(y / 3)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), lattice(rows, columns, False, False)


def add_noise(vertices: np.ndarray, faces: np.ndarray, seed: int) -> np.ndarray:
    """Positions (n, 3) with independent noise of ``NOISE`` mean edge lengths in each coordinate."""
    ends = vertices[faces], vertices[np.roll(faces, 1, axis=1)]
    edge = np.linalg.norm(ends[0] - ends[1], axis=-1).mean()
    offsets = np.random.RandomState(seed).standard_normal(vertices.shape)
    return np.round(vertices + NOISE * edge * offsets, 4)


def to_ply(vertices: np.ndarray, faces: np.ndarray) -> bytes:
    """A binary PLY file."""
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"], rows["corners"] = 3, faces
    return header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes()


def main() -> None:
    """Write the scans."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "scans"
    folder.mkdir(parents=True, exist_ok=True)
    scans = {"plaque": plaque(), "ring": ring(0, 0.0), "ring_with_ribs": ring(9, 0.8)}
    for seed, (name, (vertices, faces)) in enumerate(scans.items()):
        (folder / f"{name}.ply").write_bytes(to_ply(add_noise(vertices, faces, seed), faces))


if __name__ == "__main__":
    main()
