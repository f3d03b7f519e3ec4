"""Light, colours and background."""

import numpy as np

from msal_cli.view.camera import choose_camera, frame_vertices, rotate
from msal_cli.view.shading import shade
from tests.shapes import ball

X, Y, Z = np.eye(3)
FACING = rotate(Z, Y, 0.0, 0.0)


def square(z=0.0):
    vertices = np.array([(-1, -1, z), (1, -1, z), (1, 1, z), (-1, 1, z)], dtype=float)
    return vertices, np.array([(0, 1, 2), (0, 2, 3)], dtype=np.int32)


def seen(vertices, faces, colours=None, **options):
    return shade(vertices, faces, frame_vertices(FACING, vertices), 60, 50, colours, **options)


def test_the_mesh_is_where_the_camera_puts_it():
    image = seen(*square())
    is_background = (image == 255).all(axis=2)
    # The margin of a square in a picture of 60 x 50: 46 pixels of its height, as many across.
    assert not is_background[3:47, 8:52].any()
    assert is_background[:2].all() and is_background[-2:].all()
    assert is_background[:, :7].all() and is_background[:, -7:].all()


def test_the_light_comes_from_the_upper_left():
    vertices, faces = ball()
    image = seen(vertices, faces).astype(int).sum(axis=2)
    assert image[15, 20] > image[35, 40] + 60


def test_a_face_from_behind_has_another_tone():
    vertices, faces = square()
    front = seen(vertices, faces)[25, 30].astype(int)
    back = seen(vertices, faces[:, ::-1])[25, 30].astype(int)
    assert front[0] > front[2]
    assert back[2] > back[0]


def test_colours_reach_the_picture():
    vertices, faces = square()
    colours = np.array([(200, 0, 0), (0, 200, 0), (0, 200, 0), (200, 0, 0)], dtype=np.uint8)
    image = seen(vertices, faces, colours).astype(int)
    left, right = image[25, 10], image[25, 49]
    assert left[0] > 4 * left[1] and left[2] == 0
    assert right[1] > 4 * right[0] and right[2] == 0
    middle = image[25, 30]
    assert abs(middle[0] - middle[1]) < 8


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


def test_the_same_mesh_gives_the_same_image(monkeypatch):
    vertices, faces = ball()
    images = []
    for threads in ("1", "2"):
        monkeypatch.setenv("MSAL_THREADS", threads)
        images.append(seen(vertices, faces))
    assert (images[0] == images[1]).all()


def test_a_closed_mesh_wound_inwards_is_shown_like_any_other():
    vertices, faces = ball()
    camera = choose_camera(vertices, faces)
    images = [shade(vertices, one, camera, 60, 60).astype(int) for one in (faces, faces[:, ::-1])]
    assert np.abs(images[0] - images[1]).max() <= 1
