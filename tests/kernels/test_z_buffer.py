"""Which face a sample shows, and the normals at corners."""

import numpy as np
import pytest

from msal_cli.kernels import z_buffer


def drawn(points, faces, height, width):
    return z_buffer.nearest_faces(
        np.array(points, dtype=float), np.array(faces, dtype=np.int32), height, width
    )


def test_a_triangle_covers_the_samples_in_it():
    # Legs of 4 along the top and the left: in row r the middles of 4 - r samples are inside or on
    # the longest edge.
    _, front = drawn([(0, 0, 0), (4, 0, 0), (0, 4, 0)], [(0, 1, 2)], 5, 6)
    inside = [[c + r + 1 <= 4 for c in range(6)] for r in range(5)]
    assert ((front == 0) == inside).all()
    assert (front[~np.array(inside)] == z_buffer.NOTHING).all()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_face_wins_in_any_order(order):
    square = [(0, 0), (6, 0), (6, 6), (0, 6)]
    points = [(x, y, 1.0) for x, y in square] + [(x, y, 2.0) for x, y in square[:3]]
    parts = [[(0, 1, 2), (0, 2, 3)], [(4, 5, 6)]]
    faces = [face for k in order for face in parts[k]]
    nearness, front = drawn(points, faces, 6, 6)
    near = faces.index((4, 5, 6))
    rows, columns = np.mgrid[:6, :6]
    assert ((front == near) == (columns >= rows)).all()
    assert (nearness[columns >= rows] == 2.0).all()
    assert (nearness[columns < rows] == 1.0).all()


def roof(angle):
    """Two squares that meet at an edge and turn by ``angle`` there."""
    vertices = [(0, 0, 0), (0, 1, 0), (-1, 0, 0), (-1, 1, 0)]
    vertices += [(np.cos(angle), y, -np.sin(angle)) for y in (0, 1)]
    faces = [(2, 0, 1), (2, 1, 3), (0, 4, 5), (0, 5, 1)]
    return np.array(vertices), np.array(faces, dtype=np.int32)


def test_an_edge_is_smooth_up_to_half_the_crease_and_sharp_beyond_it():
    vertices, faces = roof(np.radians(30.0))
    smooth = z_buffer.corner_normals(vertices, faces, np.radians(61.0))
    between = z_buffer.corner_normals(vertices, faces, np.radians(45.0))
    sharp = z_buffer.corner_normals(vertices, faces, np.radians(29.0))
    # At vertex 0: one triangle on the left, two on the right, all of one half.
    left, right = np.array([0, 0, 1.0]), np.array([0.5, 0, np.sqrt(0.75)])
    mean = (left + 2 * right) / np.linalg.norm(left + 2 * right)
    assert np.allclose(smooth[0, 1], mean, atol=1e-6)
    assert np.allclose(smooth[2, 0], mean, atol=1e-6)
    assert np.allclose(sharp[:2], left, atol=1e-6)
    assert np.allclose(sharp[2:], right, atol=1e-6)
    assert left @ mean < left @ between[0, 1] < 1.0
    assert right @ mean < right @ between[2, 0] < 1.0


def test_what_is_outside_or_has_no_area_is_not_drawn():
    points = [(-9, -9, 0), (-1, -9, 0), (-1, -1, 0), (1, 1, 0), (3, 3, 0), (5, 5, 0)]
    _, front = drawn(points, [(0, 1, 2), (3, 4, 5), (3, 3, 4)], 8, 8)
    assert (front == z_buffer.NOTHING).all()
