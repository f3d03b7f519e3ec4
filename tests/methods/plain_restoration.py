"""The Wiener schedule, vertex by vertex, in plain Python from its definition."""

from __future__ import annotations

import numpy as np

from tests.paper import heights_and_sigma, normal_field, one_rings


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
