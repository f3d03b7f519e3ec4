"""Pictures and pages of meshes with colours of their own."""

import numpy as np
import pytest

from msal_cli.codecs.colours import SurfaceColours
from msal_cli.job.comparison import Surface
from msal_cli.view import pages, pictures
from msal_cli.view.pictures import View
from tests.shapes import ball, cube, grid

NAMES = ("before.ply", "after.ply")


def _painted(vertices, faces, colours):
    return Surface(vertices, faces, 0, SurfaceColours(np.asarray(colours, np.uint8)))


def _halves(vertices):
    """Red where x is negative, else blue."""
    return np.where(vertices[:, :1] < 0.0, (220, 0, 0), (0, 0, 220))


def _flat_grid():
    vertices, faces = grid()
    vertices = (vertices - vertices.mean(axis=0)) * (1.0, 1.0, 0.0)
    return vertices, faces


def test_a_sheet_shows_its_colours_where_they_are():
    vertices, faces = _flat_grid()
    scene = pictures.scene_of(_painted(vertices, faces, _halves(vertices)), None, NAMES[:1])
    view = View(view="front", up="y", size=120)
    image = pictures.panel(
        scene.before, pictures.camera_of(scene, view), view, scene.painted(0), colours_are="paint"
    ).astype(int)
    middle = image.shape[0] // 2
    left, right = image[middle, 20], image[middle, -20]
    assert left[0] > 100 and left[1:].max() < 20
    assert right[2] > 100 and right[:2].max() < 20


def test_shading_stays_visible_on_one_colour():
    vertices, faces = ball()
    scene = pictures.scene_of(
        _painted(vertices, faces, np.full(vertices.shape, 200)), None, NAMES[:1]
    )
    view = View(size=120)
    image = pictures.panel(
        scene.before, pictures.camera_of(scene, view), view, scene.painted(0), colours_are="paint"
    )
    on_mesh = image[(image != 255).any(axis=2)].astype(int)
    assert np.quantile(on_mesh, 0.95) - np.quantile(on_mesh, 0.05) > 70
    assert (on_mesh >= 255).mean() < 0.02


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


def test_notes_of_files_are_on_the_page():
    vertices, faces = ball()
    surface = Surface(vertices, faces, 0, SurfaceColours(None, ("its <b> cannot be read",)))
    page = pages.page_of(pictures.scene_of(surface, None, ("a.ply",)), View(size=60), "msal view")
    assert b"a.ply: its &lt;b&gt; cannot be read." in page


@pytest.mark.xdist_group("chromium")
def test_a_page_shows_colours_on_both_sides_and_clay_by_a_button(browser, tmp_path):
    vertices, faces = ball()
    red = np.tile((220, 0, 0), (len(vertices), 1))
    scene = pictures.scene_of(
        _painted(vertices, faces, red), _painted(1.01 * vertices, faces, red[:, ::-1]), NAMES
    )
    path = tmp_path / "both.html"
    path.write_bytes(pages.page_of(scene, View(size=60), "msal view"))
    browser.open(path)

    def sides():
        image = browser.pixels()
        height, width = image.shape[:2]
        middle = slice(height // 3, height // 3 + 9)
        return [
            image[middle, at : at + 9].mean(axis=(0, 1)) for at in (width * 2 // 5, width * 3 // 5)
        ]

    left, right = sides()
    assert left[0] > left[2] + 80 and right[2] > right[0] + 80
    browser.click("Clay")
    assert all(np.ptp(one) < 60 for one in sides())
    assert browser.complaints() == []
