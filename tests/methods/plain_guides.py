"""Plain numpy twins of what filters of face normals share, face by face, from the formulas."""

from __future__ import annotations

import itertools

import numpy as np


def normals_and_areas(x: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals and areas; zero normals where the area is zero."""
    a, b, c = (x[faces[:, corner]] for corner in range(3))
    cross = np.cross(b - a, c - a)
    length = np.linalg.norm(cross, axis=1)
    return cross / np.where(length > 0, length, 1)[:, None], length / 2


def sharing(faces: np.ndarray, corners: int) -> list[set[int]]:
    """For each face the others with which it shares at least so many corners."""
    sets = [set(face) for face in faces.tolist()]
    return [
        {g for g, other in enumerate(sets) if g != f and len(own & other) >= corners}
        for f, own in enumerate(sets)
    ]


def mean_distance(centroids: np.ndarray, across: list[set[int]]) -> float:
    """Mean distance of centroids over the pairs of faces."""
    return float(
        np.mean(
            [
                np.linalg.norm(centroids[f] - centroids[g])
                for f, others in enumerate(across)
                for g in others
                if g > f
            ]
        )
    )


def guides(
    normals: np.ndarray, areas: np.ndarray, touching: list[set[int]], across: list[set[int]]
) -> np.ndarray:
    """Mean normals of the patches with the least scores."""
    scores, means = [], []
    for f, others in enumerate(touching):
        patch = others | {f}
        widest = max(
            np.linalg.norm(normals[a] - normals[b])
            for a, b in itertools.product(patch, patch)
            if normals[a].any() and normals[b].any()
        )
        jumps = [
            np.linalg.norm(normals[a] - normals[b])
            for a in patch
            for b in across[a] & patch
            if a < b and normals[a].any() and normals[b].any()
        ]
        scores.append(widest * max(jumps) / (1e-9 + sum(jumps)))
        mean = sum(areas[a] * normals[a] for a in patch)
        means.append(mean / np.linalg.norm(mean))
    best = [min([f, *others], key=lambda g: scores[g]) for f, others in enumerate(touching)]
    return np.array([means[g] for g in best])


def near(centroids: np.ndarray, touching: list[set[int]], radius: float) -> list[set[int]]:
    """The faces within the radius that touch the face or others found before."""
    result = []
    for f in range(len(touching)):
        found, waiting = {f}, [f]
        while waiting:
            for g in touching[waiting.pop()] - found:
                if np.linalg.norm(centroids[g] - centroids[f]) <= radius:
                    found.add(g)
                    waiting.append(g)
        result.append(found - {f})
    return result


def moved(
    x: np.ndarray, normals: np.ndarray, faces: np.ndarray, free: np.ndarray, passes: int
) -> np.ndarray:
    """Vertices after so many moves towards the planes through the centroids of their faces."""
    for _ in range(passes):
        centroids = x[faces].mean(axis=1)
        new = x.copy()
        for i in np.flatnonzero(free):
            around = np.flatnonzero((faces == i).any(axis=1))
            if len(around):
                heights = ((centroids[around] - x[i]) * normals[around]).sum(axis=1)
                new[i] = x[i] + (heights[:, None] * normals[around]).mean(axis=0)
        x = new
    return x
