"""Shapes with sharp edges and known faces, meshed finely and a little unevenly."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def _patched(corners: list[Floats], steps: int) -> tuple[Floats, Ints]:
    """Triangles (3, 3), each cut into ``steps``^2, joined where they meet."""
    points, faces, n = [], [], 0
    for a, b, c in corners:
        index = {}
        for i in range(steps + 1):
            for j in range(steps + 1 - i):
                index[i, j] = n + len(index)
                points.append(a + (b - a) * (i / steps) + (c - a) * (j / steps))
        for i in range(steps):
            for j in range(steps - i):
                faces.append((index[i, j], index[i + 1, j], index[i, j + 1]))
                if i + j < steps - 1:
                    faces.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
        n += len(index)
    return _joined(np.array(points), np.array(faces))


def _joined(points: Floats, faces: Ints) -> tuple[Floats, Ints]:
    """The same with points that are equal to 1e-7 made one."""
    _, first, number = np.unique(
        np.round(points * 1e7).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    joined = number.reshape(-1)[faces]
    whole = (
        (joined[:, 0] != joined[:, 1])
        & (joined[:, 1] != joined[:, 2])
        & (joined[:, 2] != joined[:, 0])
    )
    return points[first], joined[whole]


def star_prism() -> tuple[Floats, Ints]:
    """A prism over a five-pointed star, with a roof over each half: edges of many angles."""
    angle = np.linspace(0.0, 2.0 * np.pi, 11)[:-1]
    radius = np.where(np.arange(10) % 2, 0.5, 1.0)
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(10)], axis=1)
    low, high = ring - [0.0, 0.0, 0.25], ring + [0.0, 0.0, 0.25]
    bottom, top = np.array([0.0, 0.0, -0.25]), np.array([0.0, 0.0, 0.55])
    corners = []
    for k in range(10):
        m = (k + 1) % 10
        corners.append((top, high[k], high[m]))
        corners.append((bottom, low[m], low[k]))
        corners.append((low[k], low[m], high[m]))
        corners.append((low[k], high[m], high[k]))
    return _patched(corners, 16)


def stepped_cylinder() -> tuple[Floats, Ints]:
    """A turned shaft: cylinders, a cone, shoulders and a groove."""
    outline = np.array(
        [(0, 0), (1, 0), (1, 0.6), (0.7, 0.6), (0.7, 1.2), (0.55, 1.2), (0.55, 1.4)]
        + [(0.7, 1.4), (0.7, 1.7), (0.3, 2.4), (0, 2.4)],
        dtype=float,
    )
    spacing = 0.05
    profile = [outline[0]]
    for a, b in itertools.pairwise(outline):
        steps = max(round(float(np.linalg.norm(b - a)) / spacing), 1)
        profile += [a + (b - a) * (k / steps) for k in range(1, steps + 1)]
    rows, points, n = [], [], 0
    for radius, height in profile:
        around = max(round(2.0 * np.pi * radius / spacing), 1) if radius > 0.0 else 1
        turn = 2.0 * np.pi * (np.arange(around) + 0.5 * (len(rows) % 2)) / around
        z = np.full(around, height)
        points.append(np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1))
        rows.append((np.arange(n, n + around), turn))
        n += around
    faces = []
    for (low, low_turn), (high, high_turn) in itertools.pairwise(rows):
        faces += _zipped(low, low_turn, high, high_turn)
    return np.concatenate(points), np.array(faces)


def _zipped(low: Ints, low_turn: Floats, high: Ints, high_turn: Floats) -> list[tuple[int, ...]]:
    """Triangles between two rings of points, outwards for rings that rise."""
    faces, i, j, p, q = [], 0, 0, len(low), len(high)

    def at(turn: Floats, k: int) -> float:
        return float(turn[k % len(turn)]) + 2.0 * np.pi * (k // len(turn))

    while i < p or j < q:
        is_low = j == q or (i < p and at(low_turn, i + 1) <= at(high_turn, j + 1))
        a, b = low[i % p], high[j % q]
        if is_low:
            if p > 1:
                faces.append((int(a), int(low[(i + 1) % p]), int(b)))
            i += 1
        else:
            if q > 1:
                faces.append((int(a), int(high[(j + 1) % q]), int(b)))
            j += 1
    return faces


def chipped_cube() -> tuple[Floats, Ints]:
    """A cube with a corner cut deep off and a pyramid sunk into a side."""
    cut = 0.55
    o, x, y, z = np.zeros(3), *np.eye(3)
    a, b, c = x + y + z - cut * x, x + y + z - cut * y, x + y + z - cut * z
    corners = [
        (o, z, y + z),
        (o, y + z, y),
        (o, x, x + z),
        (o, x + z, z),
        (x, x + y, c),
        (x, c, b),
        (x, b, x + z),
        (y, y + z, a),
        (y, a, c),
        (y, c, x + y),
        (z, x + z, b),
        (z, b, a),
        (z, a, y + z),
        (a, b, c),
    ]
    tip = np.array([0.5, 0.5, 0.35])
    square = [o, y, x + y, x]
    for k in range(4):
        corners.append((square[k], square[(k + 1) % 4], tip))
    return _patched([tuple(corner) for corner in corners], 20)
