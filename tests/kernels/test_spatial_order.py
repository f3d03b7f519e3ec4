"""Meshes in random order: renumbered along the surface, and back."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels import spatial_order
from msal_cli.kernels.geometry import area_and_volume
from msal_cli.mesh import prepare_mesh
from tests import shapes


def shuffle(vertices, faces, seed=3):
    """The same mesh in random order, and the old number of each vertex."""
    draw = np.random.default_rng(seed)
    old = draw.permutation(len(vertices))
    new = np.argsort(old).astype(np.int32)
    return vertices[old], new[faces][draw.permutation(len(faces))], old


def volume_of(ready):
    return area_and_volume(ready.mesh.vertices, ready.mesh.faces)[1]


@pytest.fixture
def renumbers_all(monkeypatch):
    monkeypatch.setattr(spatial_order, "MIN_VERTICES", 1)
    # Several blocks, so that a row may belong to any of them.
    monkeypatch.setattr(spatial_order, "BLOCK_BYTES", 1000)
    monkeypatch.setattr(spatial_order, "is_random", lambda faces: True)


def test_the_order_is_that_of_the_cells_and_the_numbers(monkeypatch):
    monkeypatch.setattr(spatial_order, "BLOCK_BYTES", 50)
    # Corners of the unit cube: the code of a cell has the bits of x below those of y and z.
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = np.array([[7, 6, 4], [0, 1, 2]], dtype=np.int32)
    vertices, ordered, ranks = spatial_order.sort_in_space(corners, faces, np.zeros(3), 1.0)
    assert vertices.tolist() == [
        [0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]
    ]  # fmt: skip
    assert ranks.tolist() == [0, 4, 2, 6, 1, 5, 3, 7]
    assert ordered.tolist() == [[0, 4, 2], [7, 3, 1]]


def test_faces_that_follow_one_another_tell_the_order():
    n = 350
    faces = np.stack([np.arange(n * n - n - 1) + k for k in (0, 1, n)], axis=1).astype(np.int32)
    assert not spatial_order.is_random(faces)
    draw = np.random.default_rng(1)
    assert spatial_order.is_random(draw.permutation(n * n).astype(np.int32)[faces])
    assert spatial_order.is_random(faces[draw.permutation(len(faces))])


def test_small_meshes_keep_their_order():
    vertices, faces, _ = shuffle(*shapes.ball())
    ready = prepare_mesh(vertices, faces)
    assert ready.vertex_map is None
    assert (ready.mesh.faces == faces).all()


def test_what_is_denoised_comes_back_in_the_order_of_the_file(renumbers_all):
    before, faces = shapes.ball()
    before = before + [3.0, 0.0, 5.0]
    vertices, shuffled, old = shuffle(before, faces)
    ready = prepare_mesh(vertices, shuffled)
    assert not (ready.mesh.vertices == vertices - ready.origin).all()
    np.testing.assert_array_equal(ready.mesh.vertices[ready.vertex_map], vertices - ready.origin)
    moved = ready.mesh.vertices * [1.0, 2.0, 3.0]
    expected = (before - ready.origin) * [1.0, 2.0, 3.0] + ready.origin
    np.testing.assert_allclose(
        ready.to_file_vertices(moved, vertices), expected[old], rtol=0, atol=1e-14
    )
    # The surface is the same, and its faces still look outwards.
    assert volume_of(ready) == pytest.approx(volume_of(prepare_mesh(before, faces)))
    assert ready.seam_gap(vertices) == 0.0


def test_vertices_at_one_position_and_unused_ones_find_their_way_back(renumbers_all):
    before, faces = shapes.ball(24, 12)
    soup = np.concatenate([before[faces.reshape(-1)], [[9.0, 9.0, 9.0]]])
    own = np.arange(3 * len(faces), dtype=np.int32).reshape(-1, 3)
    vertices, shuffled, old = shuffle(soup, own)
    ready = prepare_mesh(vertices, shuffled)
    assert len(ready.mesh.vertices) == len(before)
    assert ready.defects.welded_vertices == 3 * len(faces) - len(before)
    assert ready.defects.unreferenced_vertices == 1
    result = ready.to_file_vertices(2.0 * ready.mesh.vertices, vertices)
    expected = 2.0 * (vertices - ready.origin) + ready.origin
    expected[old == len(soup) - 1] = 9.0
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-14)
    assert ready.seam_gap(result) == 0.0
