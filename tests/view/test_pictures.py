"""Surfaces made ready for a picture, with colours, or with a part of their vertices."""

import numpy as np
import pytest

from msal_cli.codecs.mesh_file import Surface, SurfaceColours
from msal_cli.view import pages, pictures
from msal_cli.view.pictures import View
from tests.shapes import ball, cube, grid

NAMES = ("before.ply", "after.ply")


def test_outwards_is_away_from_the_solid_where_the_surface_is_inside_out():
    vertices, faces = ball()
    turned = faces[:, ::-1]
    scene = pictures.scene_of(Surface(vertices, turned), Surface(1.1 * vertices, turned), NAMES)
    assert scene.deviation == pytest.approx(np.full(len(vertices), 0.1), abs=2e-3)
    assert scene.record.volume_change_percent > 0.0


@pytest.mark.parametrize("by", [0.0, 1e-17, -3e-15])
def test_a_mesh_that_did_not_move_has_the_scale_of_its_edges(by):
    vertices, faces = ball()
    small = 0.01 * vertices
    scene = pictures.scene_of(
        Surface(small, faces), Surface(small + 0.01 * by * vertices, faces), NAMES
    )
    scale = pictures.scale_of_scene(scene)
    assert scale.high == -scale.low == pytest.approx(scene.before.mean_edge_length, rel=0.1)
    # Middle grey, and not the colours of noise in the last digit.
    assert np.ptp(scale.paint(scene.deviation).astype(int)) <= 3
    assert not pictures.has_moved(scene)


def test_split_vertices_are_drawn_as_one():
    vertices, faces = cube()
    soup = vertices[faces.reshape(-1)]
    triangles = np.arange(len(soup), dtype=np.int32).reshape(-1, 3)
    scene = pictures.scene_of(Surface(soup, triangles), Surface(2 * soup, triangles), NAMES)
    assert len(scene.before.vertices) == len(scene.after.vertices) == len(scene.deviation) == 8


def test_distances_to_the_surface():
    vertices, faces = cube()
    there = vertices.copy()
    there[vertices[:, 2] == 1, 2] = 1.25
    scene = pictures.scene_of(Surface(vertices, faces), Surface(there, faces[::-1]), NAMES)
    assert not scene.is_signed
    assert scene.deviation == pytest.approx(np.where(there[:, 2] > 1, 0.25, 0.0), abs=1e-6)
    assert pictures.draw_picture(scene, View(size=64)).shape[1] > 2 * 64


# With colours


def _painted(vertices, faces, colours):
    return Surface(vertices, faces, colours=SurfaceColours(np.asarray(colours, np.uint8)))


def test_a_sheet_shows_its_colours_where_they_are():
    vertices, faces = grid()
    vertices = (vertices - vertices.mean(axis=0)) * (1.0, 1.0, 0.0)
    red_and_blue = np.where(vertices[:, :1] < 0.0, (220, 0, 0), (0, 0, 220))
    scene = pictures.scene_of(_painted(vertices, faces, red_and_blue), None, NAMES[:1])
    view = View(view="front", up="y", size=120)
    image = pictures.panel(
        scene.before, pictures.camera_of(scene, view), view, scene.painted(0), colours_are="paint"
    ).astype(int)
    middle = image.shape[0] // 2
    left, right = image[middle, 20], image[middle, -20]
    assert left[0] > 100 and left[1:].max() < 20
    assert right[2] > 100 and right[:2].max() < 20


def test_split_vertices_have_the_mean_of_their_colours():
    vertices, faces = cube()
    flat = faces.reshape(-1)
    triangles = np.arange(len(flat), dtype=np.int32).reshape(-1, 3)
    colours = np.tile(np.arange(8)[:, None] * 30, (1, 3))[flat]
    scene = pictures.scene_of(_painted(vertices[flat], triangles, colours), None, NAMES[:1])
    assert sorted(scene.painted(0)[:, 0].tolist()) == (np.arange(8) * 30).tolist()


@pytest.mark.parametrize(
    ("colours", "n_panels", "is_red"),
    [("auto", 3, True), ("file", 2, True), ("deviation", 3, False), ("none", 2, False)],
)
def test_what_colours_show(colours, n_panels, is_red):
    vertices, faces = ball()
    red = np.tile((220, 0, 0), (len(vertices), 1))
    scene = pictures.scene_of(
        _painted(vertices, faces, red), _painted(1.01 * vertices, faces, red), NAMES
    )
    view = View(size=100, colours=colours)
    image = pictures.draw_picture(scene, view).astype(int)
    assert round(image.shape[1] / 110) == n_panels
    first = image[60, 60]
    assert (first[0] - first[1] > 80) == is_red
    page = pages.page_of(scene, view, "msal view").decode()
    assert ("Colours of the file" in page) == is_red
