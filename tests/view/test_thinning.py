"""Pictures of meshes beyond the memory: a part of the vertices, the numbers of all."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.codecs.mesh_file import Surface, SurfaceColours
from msal_cli.errors import ContentError
from msal_cli.kernels import spatial_order
from msal_cli.view import pages, pictures
from msal_cli.view.pictures import View, draw_picture, scene_of
from tests.shapes import torus


@pytest.fixture
def beyond(monkeypatch):
    monkeypatch.setattr(pictures, "are_arrays_in_files", lambda: True)
    monkeypatch.setattr(pictures, "MIN_VERTICES", 1000)


def surface_of_torus(move: float = 0.0) -> Surface:
    vertices, faces = torus(60, 30)
    moved = vertices + move * np.array([0.0, 0.0, 1.0])
    colours = (np.arange(len(vertices))[:, None] % 200 + [50, 20, 0]).astype(np.uint8)
    return Surface(moved, faces, colours=SurfaceColours(colours))


def test_in_a_fine_grid_all_vertices_stay_as_they_are(beyond):
    surface = surface_of_torus()
    kept, faces = pictures.choose_vertices(surface)
    assert np.array_equal(np.sort(kept), np.arange(len(surface.vertices)))
    assert {frozenset(face) for face in kept[faces].tolist()} == {
        frozenset(face) for face in surface.faces.tolist()
    }
    thinned = pictures.thin(surface, kept, faces)
    assert np.array_equal(thinned.vertices, surface.vertices[kept])
    assert np.array_equal(thinned.colours.vertices, surface.colours.vertices[kept])


def test_one_vertex_of_a_cell_stays(beyond, monkeypatch):
    monkeypatch.setattr(spatial_order, "_CELLS", 12)
    surface = surface_of_torus()
    kept, faces = pictures.choose_vertices(surface)
    low = surface.vertices.min(axis=0)
    width = np.ptp(surface.vertices, axis=0).max() / 12
    cells = np.floor((surface.vertices - low) / width)
    assert len(kept) == len(np.unique(cells, axis=0)) == len(np.unique(cells[kept], axis=0))
    assert len(np.unique(faces)) > 0.9 * len(kept)


def test_the_numbers_are_those_of_the_files(beyond, monkeypatch):
    before, after = surface_of_torus(), surface_of_torus(0.01)
    with monkeypatch.context() as patch:
        patch.setattr(pictures, "MIN_VERTICES", 10**6)
        whole = scene_of(before, after, ("a", "b"))
    monkeypatch.setattr(spatial_order, "_CELLS", 12)
    scene = scene_of(before, after, ("a", "b"))
    assert len(scene.before.vertices) == len(scene.painted(1)) < 1000
    assert scene.record.displacement == whole.record.displacement
    assert scene.edge == whole.edge
    moved = scene.after.vertices - scene.before.vertices
    assert moved == pytest.approx(np.broadcast_to([0.0, 0.0, 0.01], moved.shape))
    n_drawn = pictures.count_of_vertices(scene.before)
    assert pictures._counts(scene, 1) == f"3,600 triangles, 1,800 vertices ({n_drawn:,} drawn)"
    page = pages.page_of(scene, View(size=48), "msal view a b").decode()
    assert f"Beyond the memory: {n_drawn:,} of 1,800 vertices and" in page
    one = scene_of(before, None, ("a",))
    assert draw_picture(one, View(size=48)).shape[1] >= 48
    assert "1,800" in pages.page_of(one, View(size=48), "msal view a").decode()


def test_what_is_no_surface_names_its_file(beyond):
    surface = surface_of_torus()
    surface.vertices[7, 1] = np.nan
    with pytest.raises(ContentError) as caught:
        scene_of(surface, None, ("a.ply",))
    assert (caught.value.path, caught.value.where) == ("a.ply", "vertex 7")
