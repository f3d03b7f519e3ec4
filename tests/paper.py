"""AL and MSAL as the paper prints them, vertex by vertex, in plain numpy.

Written from the text of Huang and Ascher alone, slowly and literally, to stand beside the fast
kernels.  Only the limits that the text leaves out are added, and marked as such.
"""

from __future__ import annotations

import numpy as np


def one_rings(n: int, faces: np.ndarray) -> list[list[int]]:
    """N(i): the distinct vertices linked to i by an edge."""
    rings: list[set[int]] = [set() for _ in range(n)]
    for a, b, c in faces.tolist():
        rings[a] |= {b, c}
        rings[b] |= {a, c}
        rings[c] |= {a, b}
    return [sorted(ring) for ring in rings]


def normal_field(vertices: np.ndarray, faces: np.ndarray, mollify: int) -> np.ndarray:
    """Normalised sums of unit face normals, then normalised averages of the neighbours'."""
    n = len(vertices)
    sums = np.zeros((n, 3))
    for a, b, c in faces.tolist():
        cross = np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a])
        unit = cross / np.linalg.norm(cross)
        for i in (a, b, c):
            sums[i] += unit
    normals = np.zeros((n, 3))
    for i in range(n):
        length = np.linalg.norm(sums[i])
        if length > 0:  # a vertex without faces has no normal
            normals[i] = sums[i] / length
    rings = one_rings(n, faces)
    for _ in range(mollify):
        smooth = normals.copy()
        for i in range(n):
            if rings[i]:
                total = normals[rings[i]].sum(axis=0)
                smooth[i] = total / np.linalg.norm(total)
        normals = smooth
    return normals


def algorithm_1(
    v: np.ndarray, faces: np.ndarray, iterations: int, K: float | None, mollify: int
) -> np.ndarray:
    """Algorithm 1; with K = None it is AL, tau = 1 and lambda = 0."""
    n = normal_field(v, faces, mollify)
    rings = one_rings(len(v), faces)
    x = v.copy()
    for j in range(iterations):
        sigma = np.zeros(len(v))
        d = np.zeros(len(v))
        for i, ring in enumerate(rings):
            if not ring:
                continue
            h = (x[ring] - x[i]) @ n[i]
            sigma[i] = 2 * np.mean(np.abs(h - np.mean(h)))  # eq. (4)
            if sigma[i] <= 1e-9 * np.ptp(v):
                d[i] = h.mean()  # the limit of eq. (5) for equal heights
                continue
            g = np.exp(-(h**2) / (2 * sigma[i] ** 2))
            d[i] = (g * h).sum() / g.sum()  # eq. (5)
        if K is None:
            x = x + d[:, None] * n
        else:
            lam = sigma / sigma.max() if sigma.max() > 0 else sigma  # eq. (7)
            x = x + K**j * d[:, None] * n + lam[:, None] * (v - x)  # eqs. (2), (6)
    return x
