"""Faces within a distance against a plain flood."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.face_neighbourhoods import faces_within
from msal_cli.kernels.face_rings import face_centroids, face_rings
from tests.methods import plain_guides as plain
from tests.shapes import grid, noisy, torus


def rows(vertices, faces, radius, most):
    ring = face_rings(faces, connectivity(len(vertices), faces), "vertex")
    start, near = faces_within(face_centroids(vertices, faces), *ring, radius, most)
    return [row.tolist() for row in np.split(near, start[1:-1])]


@pytest.mark.parametrize("radius", [0.0, 0.5, 1.0, 2.5])
def test_it_is_a_flood_to_the_radius(radius):
    vertices, faces = torus(14, 8)
    vertices = noisy(vertices, 1, 0.2)
    found = rows(vertices, faces, radius, 1000)
    expected = plain.near(vertices[faces].mean(axis=1), plain.sharing(faces, 1), radius)
    assert [set(row) for row in found] == expected
    assert all(len(set(row)) == len(row) for row in found)


def test_it_does_not_jump_gaps():
    # The far strip is within the radius, the one between it and the near one was taken away.
    vertices, faces = grid(4, 4)
    centroids = vertices[faces].mean(axis=1)
    faces = faces[np.abs(centroids[:, 1] - 1.5) > 0.5]
    low = np.flatnonzero(vertices[faces].mean(axis=1)[:, 1] < 1)
    found = rows(vertices, faces, 100.0, 1000)
    for f in low:
        assert set(found[f]) == set(low) - {f}


def test_it_stops_at_the_most():
    vertices, faces = grid(20, 20)
    found = rows(vertices, faces, 100.0, 30)
    assert {len(row) for row in found} == {30}
    # The first are those that share a vertex.
    for row, others in zip(found, plain.sharing(faces, 1), strict=True):
        assert set(row[: len(others)]) == others
