"""Plain-Python twins of the neighbourhoods of faces and of Sun's vertex update."""

from __future__ import annotations

import itertools

import numpy as np


def sharing(faces: np.ndarray, common: int) -> list[list[int]]:
    """For each face the others that share at least ``common`` of its vertices."""
    corners = [set(face) for face in faces.tolist()]
    result: list[list[int]] = [[] for _ in corners]
    for f, g in itertools.permutations(range(len(corners)), 2):
        if len(corners[f] & corners[g]) >= common:
            result[f].append(g)
    return result


def neighbours(faces: np.ndarray, kind: str) -> list[list[int]]:
    """For each face those that share an edge, or a vertex, with it."""
    return sharing(faces, 2 if kind == "edge" else 1)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Each row (k, 3) divided by its length."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def normals_and_areas(x: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (m, 3) and areas (m,) of faces that all have an area."""
    a, b, c = (x[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    return unit(cross), 0.5 * np.linalg.norm(cross, axis=1)


def updated(
    v: np.ndarray, normals: np.ndarray, faces: np.ndarray, passes: int, fixed: frozenset[int]
) -> np.ndarray:
    """x_i + mean over the faces around of n'_f (n'_f . (c_f - x_i)), all from the pass before."""
    x = v.copy()
    for _ in range(passes):
        centroids = x[faces].mean(axis=1)
        y = x.copy()
        for i in range(len(x)):
            around = [f for f, face in enumerate(faces.tolist()) if i in face and normals[f].any()]
            if around and i not in fixed:
                ways = [normals[f] * (normals[f] @ (centroids[f] - x[i])) for f in around]
                y[i] += np.mean(ways, axis=0)
        x = y
    return x


def rim(faces: np.ndarray) -> frozenset[int]:
    """The ends of the edges that one face has."""
    count: dict[frozenset[int], int] = {}
    for face in faces.tolist():
        for edge in itertools.combinations(face, 2):
            count[frozenset(edge)] = count.get(frozenset(edge), 0) + 1
    return frozenset(i for edge, number in count.items() if number == 1 for i in edge)
