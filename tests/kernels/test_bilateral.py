"""Floods along the surface into hubs."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels import bilateral as reach
from msal_cli.kernels.connectivity import connectivity
from tests.shapes import fan


def vertices_around(i, x, faces, radius):
    links = connectivity(len(x), faces)
    room = reach.room(0, len(x), links.ring_start)
    mark = np.full(len(x), -1, dtype=np.int32)
    found, squares = np.empty(room, dtype=np.int32), np.empty(room)
    count = reach.vertices_around(
        i, x, links.ring_start, links.ring, radius**2, mark, found, squares
    )
    return found[:count].tolist(), squares[:count]


def faces_around(i, x, faces, radius):
    links = connectivity(len(x), faces)
    centroids = x[faces].mean(axis=1)
    room = reach.room(0, len(x), links.incidence[0])
    vertex_mark = np.full(len(x), -1, dtype=np.int32)
    face_mark = np.full(len(faces), -1, dtype=np.int32)
    corners, found = np.empty(3 * room + 1, dtype=np.int32), np.empty(room, dtype=np.int32)
    squares = np.empty(room)
    count = reach.faces_around(
        i,
        x,
        centroids,
        faces,
        *links.incidence,
        radius**2,
        vertex_mark,
        face_mark,
        corners,
        found,
        squares,
    )
    return found[:count].tolist(), squares[:count]


def test_a_hub_has_its_whole_row_and_its_rim_a_bounded_part():
    x, faces = fan(np.zeros(6000))
    assert len(vertices_around(0, x, faces, 10.0)[0]) == 6001
    assert len(faces_around(0, x, faces, 10.0)[0]) == 6000
    assert len(vertices_around(1, x, faces, 10.0)[0]) == reach.MAX_FOUND
    assert len(faces_around(1, x, faces, 10.0)[0]) == reach.MAX_FOUND
