"""Two surfaces made ready for a picture."""

import numpy as np
import pytest

from msal_cli.analysis import surface_distance
from msal_cli.errors import ContentError
from msal_cli.job.comparison import Surface
from msal_cli.view import pictures
from tests.shapes import ball, cube, grid

NAMES = ("before.ply", "after.ply")


def test_a_ball_that_grows_moves_outwards_everywhere():
    vertices, faces = ball()
    shifted = vertices + (10.0, 0.0, -4.0)
    scene = pictures.scene_of(
        Surface(shifted, faces), Surface(shifted + 0.1 * vertices, faces), NAMES
    )
    assert scene.is_signed
    assert scene.deviation == pytest.approx(np.full(len(vertices), 0.1), abs=2e-3)
    assert scene.record.displacement.mean == pytest.approx(0.1)


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


def test_a_mesh_that_moved_a_little_has_the_scale_of_its_way():
    vertices, faces = ball()
    scene = pictures.scene_of(
        Surface(vertices, faces), Surface((1.0 + 1e-9) * vertices, faces), NAMES
    )
    assert pictures.has_moved(scene)
    assert pictures.scale_of_scene(scene).high == pytest.approx(1e-9, rel=0.1)


def test_a_mesh_that_slid_within_its_surface_has_moved():
    vertices, faces = grid()
    flat = vertices * (1.0, 1.0, 0.0)
    scene = pictures.scene_of(Surface(flat, faces), Surface(flat + (0.1, 0.0, 0.0), faces), NAMES)
    assert pictures.has_moved(scene)
    assert pictures.scale_of_scene(scene).high == pytest.approx(
        scene.before.mean_edge_length, rel=0.1
    )


def test_split_vertices_are_drawn_as_one():
    vertices, faces = cube()
    soup = vertices[faces.reshape(-1)]
    triangles = np.arange(len(soup), dtype=np.int32).reshape(-1, 3)
    scene = pictures.scene_of(Surface(soup, triangles), Surface(2 * soup, triangles), NAMES)
    assert len(scene.before.vertices) == len(scene.after.vertices) == len(scene.deviation) == 8


def test_other_faces_are_measured_from_the_surface(monkeypatch):
    vertices, faces = ball()
    other = Surface(*cube())
    monkeypatch.setattr(surface_distance, "find_obstacle", lambda: "it needs the package fcpw")
    scene = pictures.scene_of(Surface(vertices, faces), other, NAMES)
    assert scene.deviation is None
    assert pictures.draw_picture(scene, pictures.View(size=64)).shape[1] > 2 * 64


def test_distances_to_the_surface():
    pytest.importorskip("fcpw")
    vertices, faces = cube()
    there = vertices.copy()
    there[vertices[:, 2] == 1, 2] = 1.25
    scene = pictures.scene_of(Surface(vertices, faces), Surface(there, faces[::-1]), NAMES)
    assert not scene.is_signed
    assert scene.deviation == pytest.approx(np.where(there[:, 2] > 1, 0.25, 0.0), abs=1e-6)


def test_an_error_names_its_file():
    vertices, faces = cube()
    broken = vertices.copy()
    broken[3, 1] = np.inf
    with pytest.raises(ContentError) as caught:
        pictures.scene_of(Surface(vertices, faces), Surface(broken, faces), NAMES)
    assert caught.value.path == "after.ply"


def test_files_of_one_name_are_told_apart_by_their_folders():
    assert pictures.titles_of(("in/a.ply", "out/a.ply")) == ("in/a.ply", "out/a.ply")
    assert pictures.titles_of(("in/a.ply", "out/b.ply")) == ("a.ply", "b.ply")
