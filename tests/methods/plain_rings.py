"""Plain-Python twins of the ring operators, written from the formulas, vertex by vertex."""

from __future__ import annotations

from collections import Counter

import numpy as np


def rows(n: int, faces: np.ndarray, boundary: str) -> list[list[int]]:
    """The neighbours that each vertex is averaged with under a rule at open edges."""
    edges = Counter(
        tuple(sorted(pair)) for a, b, c in faces.tolist() for pair in ((a, b), (b, c), (c, a))
    )
    rim = {i for edge, count in edges.items() if count == 1 for i in edge}
    result: list[list[int]] = [[] for _ in range(n)]
    for (a, b), count in edges.items():
        for i, k in ((a, b), (b, a)):
            if i not in rim or boundary == "free" or (boundary == "curve" and count == 1):
                result[i].append(k)
    return result


def umbrella(x: np.ndarray, ring: list[list[int]]) -> np.ndarray:
    """Eq. (3): the mean of the neighbours, less the vertex."""
    return np.array(
        [x[row].mean(axis=0) - x[i] if row else np.zeros(3) for i, row in enumerate(ring)]
    )


def scale_dependent_umbrella(x: np.ndarray, ring: list[list[int]], tau: float) -> np.ndarray:
    """Fujiwara's operator with the step of each vertex held at its limit."""
    moves = np.zeros_like(x)
    for i, row in enumerate(ring):
        e = x[row] - x[i]
        length = np.linalg.norm(e, axis=1)
        e, length = e[length > 0], length[length > 0]
        if len(e):
            operator = 2 / length.sum() * (e / length[:, None]).sum(axis=0)
            moves[i] = min(tau, length.sum() / (2 * (1 / length).sum())) * operator
    return moves


def hc(o: np.ndarray, ring: list[list[int]], iterations: int, alpha: float, beta: float):
    """The algorithm of Vollmer, Mencl and Mueller."""
    p = o.copy()
    for _ in range(iterations):
        q = p.copy()
        for i, row in enumerate(ring):
            if row:
                p[i] = q[row].mean(axis=0)
        b = p - (alpha * o + (1 - alpha) * q)
        p = np.array(
            [
                p[i] - (beta * b[i] + (1 - beta) * b[row].mean(axis=0)) if row else p[i]
                for i, row in enumerate(ring)
            ]
        )
    return p
