"""Faces that share edges and vertices, and floods over them."""

import numpy as np
import pytest

from msal_cli.errors import TooLargeError
from msal_cli.kernels import faces as module
from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.faces import MAX_AROUND, face_centroids, face_rings, faces_within
from tests.methods.plain_normals import neighbours
from tests.shapes import fan, grid


def rows(faces, sharing, n=None):
    faces = np.asarray(faces, dtype=np.int32)
    links = connectivity(int(faces.max()) + 1 if n is None else n, faces)
    start, ring = face_rings(faces, links, sharing)
    assert start.dtype == ring.dtype == np.int32
    assert start[0] == 0
    assert start[-1] == len(ring)
    return [ring[start[f] : start[f + 1]].tolist() for f in range(len(faces))]


def book(pages):
    """Faces that all share the edge from vertex 0 to vertex 1."""
    return [[0, 1, 2 + page] for page in range(pages)]


def test_books_and_bow_ties_by_hand():
    for sharing in ("edge", "vertex"):
        assert [sorted(row) for row in rows(book(3), sharing)] == [[1, 2], [0, 2], [0, 1]]
    # Faces that touch at one vertex only, and one face apart.
    ties = [[0, 1, 2], [2, 3, 4], [4, 5, 0], [6, 7, 8]]
    assert rows(ties, "edge") == [[]] * 4
    assert [sorted(row) for row in rows(ties, "vertex")] == [[1, 2], [0, 2], [0, 1], []]


def test_an_edge_with_too_many_faces_makes_no_neighbours():
    assert rows(book(MAX_AROUND + 1), "vertex") == [[] for _ in range(MAX_AROUND + 1)]


def test_around_a_hub_the_neighbours_are_those_across_edges():
    count = MAX_AROUND + 1
    found = rows(fan([0.0] * count)[1], "vertex")
    # The rim's vertices have two faces each, which share an edge anyway.
    assert [sorted(row) for row in found] == [
        sorted({(f - 1) % count, (f + 1) % count}) for f in range(count)
    ]


def test_small_meshes_keep_their_rows(monkeypatch):
    _, faces = grid(5, 4)
    links = connectivity(20, faces)
    kept = face_rings(faces, links, "vertex")
    assert face_rings(faces, links, "vertex") is kept
    assert len(face_rings(faces, links, "edge")[1]) < len(kept[1])
    monkeypatch.setattr("msal_cli.kernels.connectivity.KEPT_FACES", len(faces) - 1)
    assert face_rings(faces, links, "vertex") is not kept


def test_too_many_neighbours_are_refused(monkeypatch):
    _, faces = grid(5, 4)
    links = connectivity(20, faces)
    _, ring = face_rings(faces, links, "vertex")
    monkeypatch.setattr(module, "MAX_PAIRS", len(ring))
    face_rings(faces, connectivity(20, faces), "vertex")
    monkeypatch.setattr(module, "MAX_PAIRS", len(ring) - 1)
    links = connectivity(20, faces)  # the others keep their rings
    with pytest.raises(TooLargeError, match=f"{len(ring)} neighbours"):
        face_rings(faces, links, "vertex")


def near_rows(vertices, faces, radius, most):
    ring = face_rings(faces, connectivity(len(vertices), faces), "vertex")
    start, near = faces_within(face_centroids(vertices, faces), *ring, radius, most)
    return [row.tolist() for row in np.split(near, start[1:-1])]


def test_it_does_not_jump_gaps():
    # The far strip is within the radius, the one between it and the near one was taken away.
    vertices, faces = grid(4, 4)
    centroids = vertices[faces].mean(axis=1)
    faces = faces[np.abs(centroids[:, 1] - 1.5) > 0.5]
    low = np.flatnonzero(vertices[faces].mean(axis=1)[:, 1] < 1)
    found = near_rows(vertices, faces, 100.0, 1000)
    for f in low:
        assert set(found[f]) == set(low) - {f}


def test_it_stops_at_the_most():
    vertices, faces = grid(20, 20)
    found = near_rows(vertices, faces, 100.0, 30)
    assert {len(row) for row in found} == {30}
    # The first are those that share a vertex.
    for row, others in zip(found, neighbours(faces, "vertex"), strict=True):
        assert sorted(row[: len(others)]) == others
