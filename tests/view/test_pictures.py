"""Surfaces made ready for a picture; colours as files of each format have them, and of numbers."""

import numpy as np
import pytest

from msal_cli.codecs import colours
from msal_cli.codecs.colours import colour_table
from msal_cli.codecs.mesh_file import Surface, SurfaceColours
from msal_cli.view import pages, pictures
from msal_cli.view.pictures import View, open_coloured_surface, scale_of
from tests.codecs.plain_glb import Scene
from tests.ply_files import XYZ, to_ascii_ply
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
    scene = pictures.scene_of(_painted(vertices, faces[:1], colours), None, NAMES[:1])
    assert pictures.counts_text(scene, 0) == "1 triangle, 3 vertices"


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


CORNERS = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
RED_GREEN_BLUE = [[255, 0, 0], [0, 128, 0], [0, 0, 255]]


def _colours(tmp_path, name, data):
    path = tmp_path / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return open_coloured_surface(str(path)).colours


def _glb(colours=None, code="<f4"):
    scene = Scene()
    attributes = {"POSITION": scene.positions(CORNERS)}
    if colours is not None:
        attributes["COLOR_0"] = scene.accessor(colours, code, f"VEC{len(colours[0])}")
    scene.mesh({"attributes": attributes})
    return scene.data()


@pytest.mark.parametrize("prefix", ["", "diffuse_"])
def test_ply(tmp_path, prefix):
    names = [f"uchar {prefix}{name}" for name in ("red", "green", "blue")]
    rows = [" ".join(map(str, row)) for row in np.hstack([CORNERS, RED_GREEN_BLUE])]
    found = _colours(tmp_path, "a.ply", to_ascii_ply([*XYZ, *names], rows))
    assert found.vertices.tolist() == RED_GREEN_BLUE and not found.notes


def test_obj(tmp_path):
    text = "v 0 0 0 1 0 0\nv 1 0 0 0 0.5 0\nv 0 1 0 0 0 1\nf 1 2 3\n"
    assert _colours(tmp_path, "a.obj", text).vertices.tolist() == RED_GREEN_BLUE


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        (np.array([[*colour, 255] for colour in RED_GREEN_BLUE], np.uint8), "<u1"),
        # Floats are linear: 0.2158605 is what a screen shows as 128 of 255.
        (np.array([[1, 0, 0], [0, 0.2158605, 0], [0, 0, 1]], "<f4"), "<f4"),
    ],
)
def test_glb(tmp_path, rows, code):
    assert _colours(tmp_path, "a.glb", _glb(rows, code)).vertices.tolist() == RED_GREEN_BLUE


def test_what_cannot_be_read_is_a_note(tmp_path):
    data = _glb(np.eye(3, dtype="<f4")).replace(b'"bufferView": 1', b'"bufferView": 7')
    found = _colours(tmp_path, "a.glb", data)
    assert found.vertices is None and "cannot be read" in found.notes[0]


def test_one_stray_vertex_does_not_pale_the_rest():
    values = np.append(np.linspace(-1.0, 1.0, 1000), 500.0)
    scale = scale_of(values, is_signed=True)
    assert 0.95 < scale.high <= 1.0
    assert (scale.paint(np.array([500.0])) == colour_table("diverging")[-1]).all()


@pytest.mark.parametrize(
    ("size", "end"), [(0.00123, 0.0013), (1.0, 1.0), (987.0, 990.0), (3e-9, 3e-9), (1e12, 1e12)]
)
def test_ends_are_rounded_up_to_two_digits(size, end):
    assert scale_of(np.full(5, size), is_signed=False).high == pytest.approx(end, rel=1e-12)


@pytest.mark.parametrize("values", [[0.0, 0.0], [], [np.nan]])
@pytest.mark.parametrize("is_signed", [True, False])
def test_nothing_to_show_still_has_a_scale(values, is_signed):
    scale = scale_of(np.array(values), is_signed=is_signed)
    assert scale.high == 1.0
    assert len(scale.paint(np.array(values))) == len(values)


def test_the_legend_says_both_units():
    legend = scale_of(np.array([-4.0, 4.0]), is_signed=True).legend(("moved",), 8.0)
    assert [tick[0] for tick in legend.ticks] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert [tick[1] for tick in legend.ticks] == ["-4", "-2", "0", "2", "4"]
    assert [tick[2] for tick in legend.ticks] == ["-0.5", "-0.25", "0", "0.25", "0.5"]


@pytest.mark.parametrize("name", ["sequential", "diverging"])
def test_ends_beyond_and_not_a_number(name):
    table = colours.colour_table(name)
    got = colours.map_colours(np.array([-9.0, 1.0, 3.0, np.inf, -np.inf, np.nan]), 1.0, 3.0, name)
    assert got.dtype == np.uint8
    expected = [table[0], table[0], table[-1], table[-1], table[0], colours.UNKNOWN]
    assert np.array_equal(got, expected)
