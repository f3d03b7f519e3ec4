"""Scenes of files that are larger than memory."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.errors import ContentError, UnsupportedError
from msal_cli.job.comparison import open_surface
from msal_cli.job.larger_than_memory import opened_in_pieces
from msal_cli.view import pages, pictures, streamed_scene
from msal_cli.view.pictures import View
from msal_cli.view.streamed_scene import scene_of_streamed
from tests.job.large_files import in_pieces, write_ply, write_stl
from tests.shapes import torus

__all__ = ["in_pieces"]


def scene_of(*paths):
    names = tuple(map(str, paths))
    with opened_in_pieces(names) as meshes:
        return scene_of_streamed(meshes, names, None)


def scene_in_memory(*paths):
    names = tuple(map(str, paths))
    surfaces = [open_surface(name) for name in names]
    return pictures.scene_of(surfaces[0], surfaces[1] if len(surfaces) > 1 else None, names)


@pytest.fixture
def pair(tmp_path):
    vertices, faces = torus(40, 30)
    moved = vertices + np.random.default_rng(1).normal(0.0, 0.03, vertices.shape)
    return (
        write_ply(tmp_path / "a.ply", vertices, faces),
        write_ply(tmp_path / "b.ply", moved, faces),
    )


def test_where_all_fits_the_scene_is_that_of_memory(pair, in_pieces):
    scene, known = scene_of(*pair), scene_in_memory(*pair)
    for one in ("before", "after"):
        assert getattr(scene, one).vertices == pytest.approx(getattr(known, one).vertices)
        assert np.array_equal(getattr(scene, one).faces, getattr(known, one).faces)
    assert scene.before.mean_edge_length == pytest.approx(known.before.mean_edge_length, rel=1e-9)
    assert scene.deviation == pytest.approx(known.deviation, abs=1e-12)
    assert scene.is_signed
    assert scene.record.displacement.mean == pytest.approx(known.record.displacement.mean)


def test_inside_out_the_deviation_is_still_outwards(tmp_path, in_pieces):
    vertices, faces = torus(40, 30)
    before = write_ply(tmp_path / "a.ply", vertices, faces[:, ::-1])
    after = write_ply(tmp_path / "b.ply", vertices * 1.01, faces[:, ::-1])
    scene, known = scene_of(before, after), scene_in_memory(before, after)
    assert scene.record.inside_out_before
    assert scene.deviation == pytest.approx(known.deviation, abs=1e-12)


def test_decimated_it_keeps_vertices_and_their_deviation(pair, in_pieces, monkeypatch):
    monkeypatch.setattr(streamed_scene, "MOST_CELLS", 300)
    scene, known = scene_of(*pair), scene_in_memory(*pair)
    assert 50 < len(scene.before.vertices) <= 300
    gaps = np.linalg.norm(known.before.vertices[None] - scene.before.vertices[:, None], axis=2)
    same = gaps.argmin(axis=1)
    assert gaps.min(axis=1).max() < 1e-12
    assert scene.after.vertices == pytest.approx(known.after.vertices[same])
    assert scene.deviation == pytest.approx(known.deviation[same], abs=1e-12)
    assert scene.after.faces is scene.before.faces
    assert scene.full_sizes[1].triangles == 2400
    assert pictures.draw_picture(scene, View(size=100)).shape[1] > 300
    page = pages.page_of(scene, View(size=100), "msal view").decode()
    assert f"Larger than memory, and decimated for the page: {len(scene.before.faces)} of" in page
    assert "2,400 triangles" in page


def test_one_stl(tmp_path, in_pieces):
    path = write_stl(tmp_path / "a.stl", *torus(40, 30))
    scene, known = scene_of(path), scene_in_memory(path)
    assert len(scene.before.vertices) == len(known.before.vertices)
    assert len(scene.before.faces) == len(known.before.faces)
    assert scene.full_sizes[0].vertices is None
    page = pages.page_of(scene, View(size=100), "msal view").decode()
    assert "2,400" in page


def test_what_cannot_be_drawn(tmp_path, pair, in_pieces, monkeypatch):
    vertices, faces = torus(40, 30)
    other = write_ply(tmp_path / "c.ply", vertices, faces[1:])
    with pytest.raises(UnsupportedError, match="the faces are not those of the reference"):
        scene_of(pair[0], other)
    monkeypatch.setattr(streamed_scene, "MOST_CELLS", 4)
    far = write_ply(tmp_path / "d.ply", np.append(vertices, [[1e6, 0, 0]], axis=0), faces)
    with pytest.raises(ContentError, match="nothing is left to draw"):
        scene_of(far)
