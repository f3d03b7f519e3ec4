"""Edges of a triangle mesh as arrays, for operations on many elements at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Edges:
    """Unique edges of triangles that meet at most two at an edge.

    Attributes
    ----------
    ends : (e, 2) the vertices, in the order in which the first face has them.
    faces : (e, 2) the faces beside it; -1 for the second of a boundary edge.
    opposite : (e, 2) the third vertex of each face; -1 likewise.
    """

    ends: Ints
    faces: Ints
    opposite: Ints

    @property
    def is_boundary(self) -> Bools:
        """(e,) whether the edge has one face."""
        return self.faces[:, 1] < 0


def build_edges(faces: Ints, n_vertices: int) -> Edges:
    """The edges of faces (m, 3).

    Raises
    ------
    ValueError
        where an edge has more than two faces, or two faces that are wound unlike each other.
    """
    start = faces.reshape(-1)
    end = faces[:, [1, 2, 0]].reshape(-1)
    third = faces[:, [2, 0, 1]].reshape(-1)
    key = np.minimum(start, end) * n_vertices + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    ordered = key[order]
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = ordered[1:] != ordered[:-1]
    place = np.flatnonzero(is_first)
    count = np.diff(np.append(place, len(order)))
    if count.max(initial=0) > 2:
        raise ValueError("an edge has more than two faces")
    first = order[place]
    paired = count == 2
    second = order[np.where(paired, place + 1, place)]
    if np.any(start[first[paired]] == start[second[paired]]):
        raise ValueError("two faces are wound unlike each other")
    return Edges(
        np.stack([start[first], end[first]], axis=1),
        np.stack([first // 3, np.where(paired, second // 3, -1)], axis=1),
        np.stack([third[first], np.where(paired, third[second], -1)], axis=1),
    )


def face_crosses(vertices: Floats, faces: Ints) -> Floats:
    """Normals (m, 3) of twice the faces' areas."""
    corner = vertices[faces]
    crosses: Floats = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    return crosses


def to_unit(vectors: Floats) -> Floats:
    """Vectors (n, 3) of length one; zero vectors stay."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(length > 0.0, length, 1.0)


def vertex_normals(vertices: Floats, faces: Ints) -> Floats:
    """Unit normals (n, 3), the faces' weighted by their areas."""
    crosses = face_crosses(vertices, faces)
    total = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(total, faces[:, corner], crosses)
    return to_unit(total)


def edge_lengths(vertices: Floats, ends: Ints) -> Floats:
    """Lengths (e,) of edges (e, 2)."""
    lengths: Floats = np.linalg.norm(vertices[ends[:, 0]] - vertices[ends[:, 1]], axis=1)
    return lengths


def mean_edge_length(vertices: Floats, faces: Ints) -> float:
    """Mean length of the unique edges."""
    return float(edge_lengths(vertices, build_edges(faces, len(vertices)).ends).mean())


def drop_unused(vertices: Floats, faces: Ints) -> tuple[Floats, Ints, Ints]:
    """Vertices that faces have, the faces renumbered, and the kept vertices' old numbers."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    kept = np.flatnonzero(used)
    number = np.full(len(vertices), -1, dtype=np.int64)
    number[kept] = np.arange(len(kept))
    return vertices[kept], number[faces], kept


def shape_quality(vertices: Floats, faces: Ints) -> Floats:
    """(m,) from 0 for a flat face to 1 for an equilateral one."""
    corner = vertices[faces]
    squared = ((corner - corner[:, [1, 2, 0]]) ** 2).sum(axis=(1, 2))
    area = np.linalg.norm(face_crosses(vertices, faces), axis=1)
    return 2.0 * np.sqrt(3.0) * area / np.maximum(squared, 1e-300)


def corner_angles(vertices: Floats, left: Ints, tip: Ints, right: Ints) -> Floats:
    """Angles (k,) at ``tip``, radians."""
    u, v = vertices[left] - vertices[tip], vertices[right] - vertices[tip]
    sine = np.linalg.norm(np.cross(u, v), axis=1)
    return np.arctan2(sine, np.einsum("ij,ij->i", u, v))
