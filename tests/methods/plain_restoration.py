"""The robust and the Wiener schedule, vertex by vertex, in plain Python from their definitions."""

from __future__ import annotations

import numpy as np

from tests.paper import normal_field, one_rings


def quantile_above_zero(values: np.ndarray, share: float) -> float:
    """The least value which at least ``share`` of those above zero do not exceed."""
    above = sorted(value for value in values.tolist() if value > 0)
    for at, value in enumerate(above):
        if at + 1 >= share * len(above):
            return value
    return 0.0


def heights_and_sigma(x, rings, normals):
    """d of eq. (5) and sigma of eq. (4)."""
    d, sigma = np.zeros(len(x)), np.zeros(len(x))
    for i, ring in enumerate(rings):
        if ring:
            h = (x[ring] - x[i]) @ normals[i]
            sigma[i] = 2 * np.mean(np.abs(h - np.mean(h)))
            if sigma[i] <= 1e-9 * np.ptp(x):
                d[i] = h.mean()
            else:
                g = np.exp(-(h**2) / (2 * sigma[i] ** 2))
                d[i] = (g * h).sum() / g.sum()
    return d, sigma


def robust(v, faces, iterations: int, K: float, quantile: float, mollify: int) -> np.ndarray:
    """Algorithm 1 with lambda = min(1, sigma / quantile of sigma)."""
    normals, rings = normal_field(v, faces, mollify), one_rings(len(v), faces)
    x = v.copy()
    for j in range(iterations):
        d, sigma = heights_and_sigma(x, rings, normals)
        scale = quantile_above_zero(sigma, quantile)
        lam = np.minimum(1, sigma / scale) if scale else sigma
        x = x + K**j * d[:, None] * normals + lam[:, None] * (v - x)
    return x


def noise_shares(bands: int) -> list[float]:
    """What unit white noise leaves in each band, on the lattice of valence 6, by convolution."""
    size = 4 * bands + 1
    values = np.zeros((size, size))
    values[size // 2, size // 2] = 1.0

    def mean(a):
        moves = [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1), (1, -1), (-1, 1)]
        return sum(np.roll(a, move, (0, 1)) for move in moves) / 7

    shares = []
    for _ in range(bands - 1):
        low = mean(values)
        shares.append(((values - low) ** 2).sum())
        values = low
    return [*shares, (values**2).sum()]


def returned(t, rings, noise: float, caution: float, bands: int) -> np.ndarray:
    """What of the residual t (n,) is more than noise."""

    def mean(a):
        return np.array([np.mean([a[i], *a[ring]]) for i, ring in enumerate(rings)])

    def cut(rest):
        for _ in range(bands - 1):
            low = mean(rest)
            yield rest - low
            rest = low
        yield rest

    def around(a, passes):
        for _ in range(passes):
            a = mean(a)
        return a

    shares = noise_shares(bands)
    guess = np.zeros(len(t))
    for part, share in zip(cut(t), shares, strict=True):
        for i, power in enumerate(around(part**2, 6)):
            if power > 0:
                guess[i] += max(0, 1 - 1.4 * caution * share * noise**2 / power) * part[i]
    result = np.zeros(len(t))
    for part, signal, share in zip(cut(t), cut(guess), shares, strict=True):
        for i, power in enumerate(around(signal**2, 3)):
            if power > 0 and t[i] != 0:
                result[i] += power / (power + 0.4 * caution * share * noise**2) * part[i]
    return result


def wiener(v, faces, iterations: int, noise: float, caution: float, mollify: int) -> np.ndarray:
    """Plain sweeps of AL, and what they took beyond noise; ``noise`` in file units."""
    normals, rings = normal_field(v, faces, mollify), one_rings(len(v), faces)
    x = v.copy()
    for _ in range(iterations):
        x = x + heights_and_sigma(x, rings, normals)[0][:, None] * normals
    t = ((x - v) * normals).sum(axis=1)
    return x - returned(t, rings, noise, caution, 5)[:, None] * normals
