"""Colours of vertices as files of each format have them, and numbers as colours."""

import numpy as np
import pytest

from msal_cli.analysis import colour_maps as colours
from msal_cli.analysis.colour_maps import colour_table
from msal_cli.view.pictures import open_coloured_surface, scale_of
from tests.codecs.plain_glb import Scene
from tests.ply_files import XYZ, to_ascii_ply

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


# Numbers


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
