"""Where pictures are taken from, light and colours, and panels with words."""

import io

import numpy as np
import pytest
from PIL import Image

from msal_cli.job.display_names import escape_for_display
from msal_cli.view.panels import Legend, draw_panels, fit_text, png_bytes
from msal_cli.view.rendering import choose_camera, frame_vertices, rotate, shade
from tests.report.made import HOSTILE_NAMES
from tests.shapes import ball, cube, grid

X, Y, Z = np.eye(3)


VIEWS = ("auto", "front", "back", "left", "right", "top", "bottom")


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(
    "shape", [(1, 1, 1), (5, 1, 2), (1, 3, 0.1), (1e-9, 1e-9, 3e-9), (1e4, 1, 1)]
)
@pytest.mark.parametrize("size", [(300, 200), (100, 400)])
def test_the_camera_frames_the_whole_mesh(view, shape, size):
    vertices, faces = cube()
    vertices = (vertices + 7.0) * shape
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
    vertices, faces = cube()
    axes = {view: choose_camera(vertices * (1, 2, 3), faces, view).axes for view in VIEWS}
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


FACING = rotate(Z, Y, 0.0, 0.0)


def square(z=0.0):
    vertices, faces = grid(2, 2)
    return vertices * 2.0 - (1.0, 1.0, -z), faces


def seen(vertices, faces, colours=None, **options):
    return shade(vertices, faces, frame_vertices(FACING, vertices), 60, 50, colours, **options)


def test_the_mesh_is_where_the_camera_puts_it():
    image = seen(*square())
    is_background = (image == 255).all(axis=2)
    # The margin of a square in a picture of 60 x 50: 46 pixels of its height, as many across.
    assert not is_background[3:47, 8:52].any()
    assert is_background[:2].all() and is_background[-2:].all()
    assert is_background[:, :7].all() and is_background[:, -7:].all()


def test_a_face_from_behind_has_another_tone():
    vertices, faces = square()
    front = seen(vertices, faces)[25, 30].astype(int)
    back = seen(vertices, faces[:, ::-1])[25, 30].astype(int)
    assert front[0] > front[2]
    assert back[2] > back[0]


def test_hollows_are_darker():
    """The bottom of a trench gets less light than the same plane without walls."""
    step = np.array([-3.0, -0.15, -0.15, 0.15, 0.15, 3.0])
    deep = np.array([0.0, 0.0, -1.0, -1.0, 0.0, 0.0])
    vertices = np.array([(x, y, z) for x, z in zip(step, deep, strict=True) for y in (-2, 2)])
    faces = [f for k in range(0, 10, 2) for f in ((k, k + 2, k + 3), (k, k + 3, k + 1))]
    faces = np.array(faces, dtype=np.int32)
    camera = frame_vertices(FACING, vertices)
    trench = shade(vertices, faces, camera, 200, 150).astype(int)
    plane = shade(vertices * (1, 1, 0), faces, camera, 200, 150).astype(int)
    assert trench[75, 100].sum() < plane[75, 100].sum() - 60
    assert abs(trench[75, 40].sum() - plane[75, 40].sum()) < 10


def test_a_closed_mesh_wound_inwards_is_shown_like_any_other():
    vertices, faces = ball()
    camera = choose_camera(vertices, faces)
    images = [shade(vertices, one, camera, 60, 60).astype(int) for one in (faces, faces[:, ::-1])]
    assert np.abs(images[0] - images[1]).max() <= 1


def plain(colour, width=120, height=80):
    return np.full((height, width, 3), colour, dtype=np.uint8)


def test_lines_that_are_too_long_are_broken_at_spaces():
    line = "Above the scale: file units; below: mean edge lengths (e)"
    heights = [draw_panels([(plain(9, 100), "", [words])]).shape[0] for words in ("e", line)]
    assert heights[0] + 30 < heights[1]


def test_the_legend_shows_its_colours_in_order():
    ramp = np.stack([np.arange(256), np.zeros(256), 255 - np.arange(256)], axis=1)
    legend = Legend(("how far",), ramp.astype(np.uint8), ((0.0, "0", "0"), (1.0, "3", "0.2")))
    image = draw_panels([(plain(255, 400), "", [])], legend).astype(int)
    on_scale = (image[:, :, 1] == 0) & (image[:, :, 0] + image[:, :, 2] == 255)
    row = np.argmax(on_scale.sum(axis=1))
    reds = image[row, on_scale[row], 0]
    assert len(reds) > 200
    assert (np.diff(reds) >= 0).all()
    assert reds[0] == 0 and reds[-1] == 255


@pytest.mark.parametrize("name", [*HOSTILE_NAMES, "byte\udcff.ply"])
def test_names_are_drawn_as_data(name):
    assert fit_text(name, 14, 10_000)[0] == escape_for_display(name)
    draw_panels([(plain(1), name, [name])], footer=[name])


def test_png_keeps_every_pixel_and_says_the_same_twice():
    image = np.random.default_rng(3).integers(0, 256, (40, 30, 3)).astype(np.uint8)
    data = png_bytes(image)
    assert (np.asarray(Image.open(io.BytesIO(data))) == image).all()
    assert png_bytes(image) == data
    assert len(png_bytes(image, 64)) < 0.6 * len(data)
