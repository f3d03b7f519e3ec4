"""AL and MSAL as the paper prints them, vertex by vertex, in plain numpy.

Written from the text of Huang and Ascher alone, slowly and literally, to stand beside the fast
kernels.  Only the limits that the text leaves out are added, and marked as such.
"""

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


def heights_and_sigma(x, rings, normals):
    """d of eq. (5) and sigma of eq. (4)."""
    d, sigma = np.zeros(len(x)), np.zeros(len(x))
    for i, ring in enumerate(rings):
        if ring:
            h = (x[ring] - x[i]) @ normals[i]
            sigma[i] = 2 * np.mean(np.abs(h - np.mean(h)))
            if sigma[i] <= 1e-9 * np.ptp(x):
                d[i] = h.mean()  # the limit of eq. (5) for equal heights
            else:
                g = np.exp(-(h**2) / (2 * sigma[i] ** 2))
                d[i] = (g * h).sum() / g.sum()
    return d, sigma


def quantile_above_zero(values: np.ndarray, share: float) -> float:
    """The least value which at least ``share`` of those above zero do not exceed."""
    above = sorted(value for value in values.tolist() if value > 0)
    for at, value in enumerate(above):
        if at + 1 >= share * len(above):
            return value
    return 0.0


def algorithm_1(
    v: np.ndarray,
    faces: np.ndarray,
    iterations: int,
    K: float | None,
    mollify: int,
    quantile: float = 1.0,
) -> np.ndarray:
    """Algorithm 1; with K = None it is AL, tau = 1 and lambda = 0.

    A quantile below 1 makes it robust: lambda = min(1, sigma / quantile of sigma).
    """
    n, rings = normal_field(v, faces, mollify), one_rings(len(v), faces)
    x = v.copy()
    for j in range(iterations):
        d, sigma = heights_and_sigma(x, rings, n)
        if K is None:
            x = x + d[:, None] * n
        else:
            scale = quantile_above_zero(sigma, quantile)
            lam = np.minimum(1, sigma / scale) if scale else sigma  # eq. (7)
            x = x + K**j * d[:, None] * n + lam[:, None] * (v - x)  # eqs. (2), (6)
    return x
