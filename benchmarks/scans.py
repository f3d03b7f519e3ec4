"""Meshes that benchmarks make for themselves: noisy grids on surfaces, in the order of a scan.

Nothing here reads or writes with the code that is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True)
class Scan:
    """vertices : (n, 3) float32.  faces : (m, 3) int32."""

    vertices: np.ndarray
    faces: np.ndarray

    @property
    def array_bytes(self) -> int:
        """What positions as float64 and faces as int32 take in memory."""
        return 24 * len(self.vertices) + 12 * len(self.faces)


@dataclass(frozen=True)
class Surface:
    """A surface over the unit square.

    points : u, v, each (n,) in 0 to 1, to positions (n, 3).
    closes : whether it closes in u, and in v.
    """

    points: Callable[[np.ndarray, np.ndarray], np.ndarray]
    closes: tuple[bool, bool]


def _torus(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    a, b = 2 * np.pi * u, 2 * np.pi * v
    ring = 3.0 + np.cos(b)
    return np.stack([ring * np.cos(a), ring * np.sin(a), np.sin(b)], axis=-1)


def _knot(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A tube around a trefoil knot."""

    def trefoil(a: np.ndarray) -> np.ndarray:
        ring = 2.0 + np.cos(3 * a)
        return np.stack([ring * np.cos(2 * a), ring * np.sin(2 * a), np.sin(3 * a)], axis=-1)

    a, b = 2 * np.pi * u, 2 * np.pi * v
    centre = trefoil(a)
    along = trefoil(a + 1e-4) - centre
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    outward = centre * np.array([1.0, 1.0, 0.0])
    outward -= (outward * along).sum(axis=-1, keepdims=True) * along
    outward /= np.linalg.norm(outward, axis=-1, keepdims=True)
    sideways = np.cross(along, outward)
    return centre + 0.35 * (np.cos(b)[:, None] * outward + np.sin(b)[:, None] * sideways)


def _vase(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A body of revolution with grooves, open above and below."""
    a = 2 * np.pi * u
    ring = 1.0 + 0.3 * np.sin(2 * np.pi * v) + 0.03 * np.sin(40 * np.pi * v) * np.cos(12 * a)
    return np.stack([ring * np.cos(a), ring * np.sin(a), 4.0 * v], axis=-1)


def _relief(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A range scan: heights over a rectangle, with a boundary."""
    heights = 0.2 * np.sin(5 * u) * np.cos(7 * v) + 0.02 * np.sin(60 * u) * np.sin(50 * v)
    return np.stack([2.0 * u, v, heights], axis=-1)


SURFACES = {
    "torus": Surface(_torus, (True, True)),
    "knot": Surface(_knot, (True, True)),
    "vase": Surface(_vase, (True, False)),
    "relief": Surface(_relief, (False, False)),
}


def scan(name: str, around: int, across: int, noise: float, seed: int) -> Scan:
    """A noisy grid of ``around`` by ``across`` vertices on one of the surfaces.

    noise : standard deviation of every coordinate, in mean lengths of the grid's edges.
    """
    surface = SURFACES[name]
    steps = [
        np.arange(n) / (n if closes else n - 1)
        for n, closes in zip((around, across), surface.closes, strict=True)
    ]
    u, v = np.meshgrid(*steps, indexing="ij")
    points = surface.points(u.reshape(-1), v.reshape(-1))
    rows, columns = (
        np.arange(n if closes else n - 1)
        for n, closes in zip((around, across), surface.closes, strict=True)
    )
    i, j = np.meshgrid(rows, columns, indexing="ij")

    def at(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        return (i % around) * across + j % across

    a, b, c, d = at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)
    faces = np.stack([a, b, c, a, c, d], axis=-1).reshape(-1, 3).astype(np.int32)
    some = faces[:: max(1, len(faces) // 100_000)]
    edge = float(np.linalg.norm(points[some[:, 1]] - points[some[:, 0]], axis=1).mean())
    points = points + np.random.default_rng(seed).normal(0.0, noise * edge, points.shape)
    return Scan(points.astype(np.float32), faces)


def large_torus(around: int) -> Scan:
    """``around`` times half as many vertices with noise of 0.2 mean edge lengths."""
    return scan("torus", around, (around // 2 + 1) // 2 * 2, noise=0.2, seed=1)


def _ply_header(scan: Scan, form: str) -> bytes:
    return (
        f"ply\nformat {form} 1.0\nelement vertex {len(scan.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(scan.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()


def binary_ply(scan: Scan) -> bytes:
    """Little-endian PLY, float32."""
    rows = np.empty(len(scan.faces), dtype=[("n", "u1"), ("corners", "<i4", 3)])
    rows["n"], rows["corners"] = 3, scan.faces
    header = _ply_header(scan, "binary_little_endian")
    return header + scan.vertices.astype("<f4").tobytes() + rows.tobytes()


def _lines(row: str, numbers: np.ndarray) -> bytes:
    return ((row * len(numbers)) % tuple(numbers.reshape(-1).tolist())).encode()


def ascii_ply(scan: Scan) -> bytes:
    """PLY as text, six decimals."""
    vertices = _lines("%.6f %.6f %.6f\n", scan.vertices)
    return _ply_header(scan, "ascii") + vertices + _lines("3 %d %d %d\n", scan.faces)


def obj(scan: Scan) -> bytes:
    """OBJ with nothing but positions and triangles, six decimals."""
    return _lines("v %.6f %.6f %.6f\n", scan.vertices) + _lines("f %d %d %d\n", scan.faces + 1)


def binary_stl(scan: Scan) -> bytes:
    """Binary STL with its normals."""
    corners = scan.vertices[scan.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    fields = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
    rows = np.zeros(len(scan.faces), dtype=fields)
    rows["normal"], rows["corners"] = normals / np.maximum(lengths, 1e-30), corners
    return b"a noisy scan".ljust(80) + np.uint32(len(rows)).tobytes() + rows.tobytes()


@dataclass(frozen=True)
class Form:
    """One kind of file: its title in tables, its suffix, and what makes its bytes."""

    title: str
    suffix: str
    encoded: Callable[[Scan], bytes]


FORMS = {
    "ply": Form("binary PLY", ".ply", binary_ply),
    "ply-ascii": Form("ascii PLY", ".ply", ascii_ply),
    "stl": Form("binary STL", ".stl", binary_stl),
    "obj": Form("OBJ", ".obj", obj),
}


def file_of(folder: Path, name: str, form: str, make: Callable[[], Scan]) -> Path:
    """The file of that name and form in ``folder``; made from ``make()`` when it is missing."""
    path = folder / f"{name}-{form}{FORMS[form].suffix}"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        half = path.with_name(path.name + ".half")
        half.write_bytes(FORMS[form].encoded(make()))
        half.rename(path)
    return path
