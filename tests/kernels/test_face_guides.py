"""Guide normals by hand and against their plain twin."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.face_guides import patches
from msal_cli.kernels.geometry import face_normals_and_areas
from tests.methods import plain_guides as plain
from tests.shapes import cube, fan, grid, noisy, torus


def guides(vertices, faces):
    links = connectivity(len(vertices), faces)
    return patches(faces, links).guides(*face_normals_and_areas(vertices, faces))


def test_the_inner_pairs_of_a_patch():
    # A fan of six: every patch is the whole fan, with six pairs across its spokes.
    vertices, faces = fan([0.0] * 6)
    around = patches(faces, connectivity(len(vertices), faces))
    assert sorted(map(sorted, around.pairs.tolist())) == [
        [0, 1], [0, 5], [1, 2], [2, 3], [3, 4], [4, 5],
    ]  # fmt: skip
    rows = np.split(around.inner, around.inner_start[1:-1])
    assert [sorted(row) for row in rows] == [list(range(6))] * 6


def test_one_strip_of_three():
    # Faces 0 and 2 of a strip share the vertex (1, 0, 0) and so every patch is the whole strip;
    # the areas 1/2, 1/2, 1 weigh the normals z, z and x.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, -2]], dtype=float)
    faces = np.array([[0, 1, 2], [1, 3, 2], [3, 1, 4]], dtype=np.int32)
    assert guides(vertices, faces) == pytest.approx(np.tile([1, 0, 1] / np.sqrt(2), (3, 1)))


@pytest.mark.parametrize("shape", ["torus", "sheet", "cube"])
def test_they_agree_with_the_plain_twin(shape):
    vertices, faces = {"torus": torus(12, 7), "sheet": grid(7, 6), "cube": cube()}[shape]
    vertices = noisy(vertices, 5, 0.2)
    if shape == "sheet":
        faces = np.concatenate([faces, [[0, 1, 20]]]).astype(np.int32)  # edge with three faces
    normals, areas = plain.normals_and_areas(vertices, faces)
    expected = plain.guides(normals, areas, plain.sharing(faces, 1), plain.sharing(faces, 2))
    assert np.abs(guides(vertices, faces) - expected).max() < 1e-13


def test_faces_without_normals_do_not_count():
    vertices, faces = torus(12, 7)
    vertices = noisy(vertices, 5, 0.2)
    vertices[faces[3, 0]] = (vertices[faces[3, 1]] + vertices[faces[3, 2]]) / 2
    normals, areas = face_normals_and_areas(vertices, faces)
    assert not normals[3].any()
    expected = plain.guides(normals, areas, plain.sharing(faces, 1), plain.sharing(faces, 2))
    assert np.abs(guides(vertices, faces) - expected).max() < 1e-13


def test_without_any_mean_normal_a_face_is_guided_by_its_own():
    # Two faces back to back: the one mean vanishes.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 1, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 2, 1]], dtype=np.int32)
    assert (guides(vertices, faces) == [[0, 0, 1], [0, 0, -1]]).all()


def test_no_face_may_have_a_normal():
    # Forty faces, more than one block, and none of them has an area.
    vertices, faces = grid(6, 5)
    vertices[:, 1:] = 0.0
    assert (guides(vertices, faces) == 0.0).all()
