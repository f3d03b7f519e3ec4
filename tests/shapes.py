"""Meshes made by formula, for tests: vertices (n, 3) float64 and faces (m, 3) int32."""

import numpy as np


def torus(around: int = 24, across: int = 12, radius: float = 3.0, tube: float = 1.0):
    """A closed torus; ``around * across`` vertices of valence six."""
    u, v = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    alpha, beta = 2 * np.pi * u / around, 2 * np.pi * v / across
    ring = radius + tube * np.cos(beta)
    vertices = np.stack([ring * np.cos(alpha), ring * np.sin(alpha), tube * np.sin(beta)], axis=-1)

    def at(i, j):
        return (i % around) * across + j % across

    lower = np.stack([at(u, v), at(u + 1, v), at(u + 1, v + 1)], axis=-1)
    upper = np.stack([at(u, v), at(u + 1, v + 1), at(u, v + 1)], axis=-1)
    faces = np.stack([lower, upper], axis=2).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces.astype(np.int32)


def grid(rows: int = 6, columns: int = 5):
    """A flat open grid in the plane z = 0 with unit spacing, facing up."""
    y, x = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3).astype(np.float64)
    corner = (y * columns + x)[:-1, :-1].reshape(-1)
    faces = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + columns + 1], axis=1),
            np.stack([corner, corner + columns + 1, corner + columns], axis=1),
        ]
    )
    return vertices, faces.astype(np.int32)


def roof(rows: int, columns: int, slope: float = np.pi / 4):
    """An open grid folded along its middle column; both sides fall off at ``slope`` radians."""
    vertices, faces = grid(rows, columns)
    across = vertices[:, 0] - columns // 2
    vertices[:, 0], vertices[:, 2] = across * np.cos(slope), -np.abs(across) * np.sin(slope)
    return vertices, faces


def fan(heights) -> tuple[np.ndarray, np.ndarray]:
    """A vertex at the origin amid a closed ring of unit radius with the given heights."""
    count = len(heights)
    angle = 2 * np.pi * np.arange(count) / count
    ring = np.stack([np.cos(angle), np.sin(angle), np.asarray(heights, dtype=float)], axis=1)
    vertices = np.concatenate([np.zeros((1, 3)), ring])
    k = np.arange(count)
    faces = np.stack([np.zeros(count, int), 1 + k, 1 + (k + 1) % count], axis=1)
    return vertices, faces.astype(np.int32)


def cube() -> tuple[np.ndarray, np.ndarray]:
    """The unit cube, closed, outward, volume 1 and area 6."""
    vertices = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=float)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return vertices, np.array(faces, dtype=np.int32)


def box(*sizes: int) -> tuple[np.ndarray, np.ndarray]:
    """A box with so many edges of length 1 along each axis; closed once its sides are welded."""
    parts, faces, count = [], [], 0
    for axis in range(3):
        across, up = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            flat, triangles = grid(sizes[up] + 1, sizes[across] + 1)
            part = np.zeros_like(flat)
            part[:, across], part[:, up], part[:, axis] = flat[:, 0], flat[:, 1], side * sizes[axis]
            parts.append(part)
            faces.append((triangles if side else triangles[:, ::-1]) + count)
            count += len(part)
    return np.concatenate(parts), np.concatenate(faces).astype(np.int32)


def ball(around: int = 48, across: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """The unit sphere about the origin in ``across`` bands from pole to pole along z, outward."""
    u, v = np.meshgrid(np.arange(around), np.arange(1, across), indexing="ij")
    alpha, beta = 2 * np.pi * u / around, np.pi * v / across
    ring = np.stack([np.sin(beta) * np.cos(alpha), np.sin(beta) * np.sin(alpha), np.cos(beta)], -1)
    vertices = np.concatenate([ring.reshape(-1, 3), [(0, 0, 1), (0, 0, -1)]])
    north, south = around * (across - 1) + np.arange(2)

    def at(i, j):
        return (i % around) * (across - 1) + j - 1

    faces = []
    for i in range(around):
        faces += [
            (north, at(i, 1), at(i + 1, 1)),
            (south, at(i + 1, across - 1), at(i, across - 1)),
        ]
        for j in range(1, across - 1):
            faces += [(at(i, j), at(i, j + 1), at(i + 1, j + 1))]
            faces += [(at(i, j), at(i + 1, j + 1), at(i + 1, j))]
    return vertices, np.array(faces, dtype=np.int32)


def noisy(vertices, seed: int = 0, level: float = 0.1):
    """Positions with uniform noise of +-level in every coordinate."""
    return vertices + np.random.default_rng(seed).uniform(-level, level, vertices.shape)
