"""How much of each voxel a closed surface fills."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.simulation.occupancy import Grid, close_holes, fill_centres, fill_voxels
from msal_cli.kernels.geometry import area_and_volume
from tests.shapes import ball, cube, grid, torus

pytest.importorskip("scipy")


def box(low, high):
    """The cube stretched from one corner to another."""
    vertices, faces = cube()
    return np.asarray(low) + vertices * (np.asarray(high) - np.asarray(low)), faces


def test_the_voxels_of_a_box_are_filled_by_their_share():
    # Two and a half voxels wide, one and a quarter deep and three and three quarters high.
    vertices, faces = box((0.5, 0.5, 0.5), (3.0, 1.75, 4.25))
    made = fill_voxels(vertices, faces, Grid(np.zeros(3), np.ones(3), (5, 4, 6)), columns=4)
    x = np.array([0.0, 1.0, 1.0, 0.5, 0.0])
    y = np.array([0.0, 1.0, 0.25, 0.0])
    z = np.array([0.0, 1.0, 1.0, 1.0, 0.75, 0.0])
    expected = x[:, None, None] * y[:, None] * z
    assert made == pytest.approx(expected, abs=1e-6)


def test_the_centres_of_a_box():
    vertices, faces = box((0.6, -0.1, 0.9), (3.4, 2.2, 2.1))
    inside = fill_centres(vertices, faces, Grid(np.zeros(3), np.ones(3), (5, 4, 4)))
    expected = np.zeros((5, 4, 4), dtype=bool)
    expected[1:4, 0:3, 1:3] = True
    assert np.array_equal(inside, expected)


def test_spacing_and_origin_may_differ_along_the_axes():
    vertices, faces = box((0.0, 0.0, 0.0), (4.0, 4.0, 4.0))
    made = Grid(np.array([-1.0, -1.0, -1.0]), np.array([1.0, 2.0, 0.5]), (7, 4, 13))
    inside = fill_centres(vertices + 1e-3, faces, made)
    # Centres above 0 up to 4: at 1 to 4, at 1 and 3, and at 0.5 to 4.
    assert inside.any(axis=(1, 2)).sum() == 4
    assert inside.any(axis=(0, 2)).sum() == 2
    assert inside.any(axis=(0, 1)).sum() == 8
    assert inside.sum() == 4 * 2 * 8


@pytest.mark.parametrize("shape", [ball, torus])
def test_the_sum_over_all_voxels_is_the_volume(shape):
    vertices, faces = shape()
    turned = vertices @ np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0].T
    if area_and_volume(turned, faces)[1] < 0.0:
        faces = faces[:, ::-1]
    edge = 0.2
    low = turned.min(axis=0) - 3.3 * edge
    counts = np.ceil(np.ptp(turned, axis=0) / edge).astype(int) + 7
    made = fill_voxels(turned, faces, Grid(low, np.full(3, edge), tuple(counts)))
    volume = area_and_volume(turned, np.ascontiguousarray(faces))[1]
    assert made.sum() * edge**3 == pytest.approx(volume, rel=2e-3)


def test_columns_that_pass_through_edges_and_vertices_are_left_again():
    # Every vertex of the cube, and the diagonals of its faces, lie on columns.
    vertices, faces = box((1.0, 1.0, 0.6), (4.0, 4.0, 3.4))
    inside = fill_centres(vertices, faces, Grid(np.zeros(3), np.ones(3), (6, 6, 5)))
    assert not inside[:, :, 4].any()
    assert inside[2:4, 2:4, 1:4].all()
    # The half-open rule: of two opposite sides one takes its columns.
    assert 4 <= inside[:, :, 2].sum() <= 16


def test_solids_that_overlap_are_one():
    first, faces = box((0.6, 0.6, 0.6), (3.4, 3.4, 3.4))
    vertices = np.concatenate([first, first + 1.0])
    both = np.concatenate([faces, faces + 8])
    inside = fill_centres(vertices, both, Grid(np.zeros(3), np.ones(3), (6, 6, 6)))
    assert inside.sum() == 27 + 27 - 8


def test_a_hole_is_closed_by_a_fan():
    vertices, faces = ball(24, 12)
    volume = area_and_volume(vertices, faces)[1]
    far = vertices[faces].mean(axis=1)[:, 0] < 0.8
    closed, all_faces, n_holes = close_holes(vertices, faces[far])
    assert n_holes == 1
    assert len(closed) == len(vertices) + 1
    assert area_and_volume(closed, all_faces)[1] == pytest.approx(volume, rel=0.1)
    assert close_holes(closed, all_faces)[2] == 0


def test_a_closed_mesh_has_no_holes_and_a_sheet_is_one():
    vertices, faces = torus()
    assert close_holes(vertices, faces)[1] is faces
    assert close_holes(*grid())[2] == 1


def test_two_holes_are_two():
    vertices, faces = ball(24, 12)
    middle = np.abs(vertices[faces].mean(axis=1)[:, 0]) < 0.8
    assert close_holes(vertices, faces[middle])[2] == 2
