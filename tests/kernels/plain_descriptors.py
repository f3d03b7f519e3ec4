"""Plain numpy twins of the descriptors of face normals and of the network, face by face."""

from __future__ import annotations

import numpy as np

NARROW, WIDE = 1.45, 2.7


def to_unit(vector):
    length = np.linalg.norm(vector)
    return vector / length if length > 0 else vector


def biweight(squares):
    return np.maximum(1 - squares, 0) ** 2


def local_units(centroids, across):
    """Mean distances to the faces across edges, averaged with theirs, times root 3."""
    raw = np.array(
        [
            np.mean([np.linalg.norm(centroids[f] - centroids[g]) for g in row]) if row else 0.0
            for f, row in enumerate(across)
        ]
    )
    return np.sqrt(3) * np.array([np.mean(raw[[f, *row]]) for f, row in enumerate(across)])


def plane_normal(points, weights, base):
    """Normal, variance off the plane, height of the origin's mean above it, distance within it."""
    mean = weights @ points / weights.sum()
    centred = points - mean
    covariance = np.einsum("k,ki,kj->ij", weights, centred, centred) / weights.sum()
    covariance += 1e-4 * np.eye(3)
    normal = to_unit(np.linalg.solve(covariance, base))
    height = mean @ normal
    return normal, normal @ covariance @ normal, height, np.sqrt(max(mean @ mean - height**2, 0))


class Plain:
    """Vectors (m, 14, 3) and numbers of every face, as ``NormalDescriber`` has them."""

    def __init__(self, normals, areas, centroids, near, units):
        self.normals, self.areas = normals, areas / areas.mean()
        self.centroids, self.near, self.units = centroids, near, units
        m = len(normals)
        self.vectors = np.zeros((m, 14, 3))
        self.numbers = np.zeros((m, 13))
        self.tensors = np.zeros((m, 3, 3))
        for f in range(m):
            self.describe(f)
        for f in range(m):
            row = [f, *near[f]]
            self.numbers[f, 10] = self.numbers[row, 9].mean()
            mean_area = self.areas[row].mean()
            self.numbers[f, 12] = self.areas[f] / (self.areas[f] + mean_area)
        for guide, of, to, ranges in (
            (3, 0, 8, (0.25, 0.5)),
            (3, 3, 10, (0.25, 0.5)),
            (5, 5, 12, (0.25, 0.7)),
        ):
            for k, s in enumerate(ranges):
                self.vectors[:, to + k] = [
                    self.filtered(f, self.vectors[:, guide], self.vectors[:, of], s)
                    for f in range(m)
                ]

    def weights(self, f, reach):
        row = [f, *self.near[f]]
        away = (self.centroids[row] - self.centroids[f]) / (reach * self.units[f])
        return row, away, self.areas[row] * biweight((away**2).sum(axis=1))

    def filtered(self, f, guides, normals, s):
        row, _, w = self.weights(f, WIDE)
        w = w * biweight(((guides[row] - guides[f]) ** 2).sum(axis=1) / s**2)
        return to_unit(w @ normals[row])

    def describe(self, f):
        n, vectors, numbers = self.normals, self.vectors[f], self.numbers[f]
        vectors[0] = n[f]
        row, wide_away, wide = self.weights(f, WIDE)
        _, _, narrow = self.weights(f, NARROW)
        jump = ((n[row] - n[f]) ** 2).sum(axis=1)
        vectors[1] = to_unit(narrow @ n[row])
        for k, s in enumerate((0.4, 0.7, 1.2, np.inf)):
            w = wide * biweight(jump / s**2)
            vectors[2 + k] = to_unit(w @ n[row])
            if k < 3:
                numbers[k] = w.sum() / wide.sum()
        # All in wide reaches.
        vectors[6], square, numbers[6], numbers[7] = plane_normal(wide_away, wide, vectors[3])
        numbers[5] = np.sqrt(square)
        ranged = wide * biweight(jump / 0.7**2)
        vectors[7] = plane_normal(wide_away, ranged, vectors[3])[0]
        self.tensors[f] = np.einsum("k,ki,kj->ij", wide, n[row], n[row]) / wide.sum()
        values = np.maximum(np.linalg.eigvalsh(self.tensors[f]), 0)
        numbers[3], numbers[4] = np.sqrt(values[1]), np.sqrt(values[0])
        numbers[8] = len(self.near[f]) / 64
        scatter = ((n[row] - vectors[1]) ** 2).sum(axis=1)
        mean = narrow @ scatter / narrow.sum()
        numbers[9] = (scatter[narrow > 0].max() * mean) ** 0.25
        numbers[11] = self.units[f] / (self.units[f] + self.units.mean())


def predict(layers, inputs, vectors):
    """The normals (k, 3) that a network of three layers gives for vectors (k, v, 3)."""
    x = inputs
    for at, (bias, matrix) in enumerate(layers):
        x = x @ matrix.T + bias
        if at < 2:
            x = np.maximum(x, x / 64)
    combined = np.einsum("kv,kvi->ki", x, vectors)
    return combined / np.linalg.norm(combined, axis=1)[:, None]
