"""Where pictures are taken from."""

import numpy as np
import pytest

from msal_cli.view.camera import VIEWS, choose_camera
from tests.shapes import ball, cube, grid

X, Y, Z = np.eye(3)


def box(width, depth, height):
    """A closed box with a corner at the origin."""
    vertices, faces = cube()
    return vertices * (width, depth, height), faces


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (5, 1, 2), (1, 3, 0.1), (1e-9, 1e-9, 3e-9), (1e4, 1, 1)]
)
@pytest.mark.parametrize("size", [(300, 200), (100, 400)])
def test_the_camera_frames_the_whole_mesh(view, shape, size):
    vertices, faces = box(*shape)
    vertices += 7.0 * np.array(shape)
    camera = choose_camera(vertices, faces, view)
    assert np.allclose(camera.axes @ camera.axes.T, np.eye(3))
    assert np.linalg.det(camera.axes) == pytest.approx(1.0)
    seen = camera.seen(vertices) * camera.pixels_per_unit(*size)
    assert (np.abs(seen[:, 0]) <= 0.47 * size[0]).all()
    assert (np.abs(seen[:, 1]) <= 0.47 * size[1]).all()
    # and no smaller than it must be
    fill = np.abs(seen[:, :2]).max(axis=0) / (0.5 * np.array(size))
    assert fill.max() == pytest.approx(0.92)


def test_named_views_look_at_one_another():
    vertices, faces = box(1, 2, 3)
    axes = {view: choose_camera(vertices, faces, view).axes for view in VIEWS}
    for one, other in (("front", "back"), ("left", "right"), ("top", "bottom")):
        assert np.allclose(axes[one][2], -axes[other][2])
    for view in ("front", "back", "left", "right"):
        assert np.allclose(axes[view][1], axes["front"][1])
    assert np.allclose(axes["top"][2], axes["front"][1])
    # The front is at the bottom of a picture from above.
    assert np.allclose(axes["top"][1], -axes["front"][2])
    # Who goes to the mesh's right side sees it from where the picture has its right.
    assert np.allclose(axes["right"][2], axes["front"][0])


def test_a_flat_relief_is_seen_from_its_front():
    vertices, faces = grid(30, 30)
    vertices = vertices - vertices.mean(axis=0)
    vertices[:, 2] += 0.02 * np.sin(3.0 * vertices[:, 0])
    assert np.allclose(choose_camera(vertices, faces).axes[2], Z)
    assert np.allclose(choose_camera(vertices, faces[:, ::-1]).axes[2], -Z)
    # The same standing upright, in a file with z upwards.
    standing = np.stack([vertices[:, 0], -vertices[:, 2], vertices[:, 1]], axis=1)
    axes = choose_camera(standing, faces).axes
    assert np.allclose(axes[2], -Y)
    assert np.allclose(axes[1], Z)


def test_what_has_a_base_stands_on_it():
    vertices, faces = ball()
    for axis in (1, 2):
        cut = vertices.copy()
        cut[:, axis] = np.maximum(cut[:, axis], -0.5)
        assert choose_camera(cut, faces).axes[1] @ np.eye(3)[axis] > 0.5


def test_a_scan_in_the_frame_of_a_depth_camera_is_not_upside_down():
    vertices, faces = grid(30, 30)
    vertices = vertices - vertices.mean(axis=0)
    vertices[:, 2] = 0.3 * np.cos(vertices[:, 0]) * np.cos(vertices[:, 1])
    seen_by_camera = vertices * (1.0, -1.0, -1.0) + (0.0, 0.0, 2.0)
    axes = choose_camera(seen_by_camera, faces).axes
    assert np.allclose(axes, [[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    assert np.allclose(choose_camera(seen_by_camera, faces, up="y").axes[1], Y)


def test_terrain_is_a_map_with_north_on_top():
    vertices, faces = grid(30, 30)
    vertices[:, 2] = 0.05 * np.sin(3.0 * vertices[:, 0]) * np.cos(2.0 * vertices[:, 1])
    assert np.allclose(choose_camera(vertices, faces).axes, np.eye(3))
