"""Distances to a surface, against hand cases and a search through all triangles."""

from __future__ import annotations

import importlib.util
import sys

import numpy as np
import pytest

from msal_cli.analysis import surface_distance
from msal_cli.analysis.surface_distance import (
    at_other_positions,
    distances_to_surface,
    distances_to_triangles,
    surface_distances,
)
from msal_cli.errors import UnsupportedError
from msal_cli.mesh import Mesh, prepare_mesh
from tests.shapes import cube, grid, noisy, torus

needs_library = pytest.mark.skipif(
    importlib.util.find_spec("fcpw") is None, reason="fcpw is not installed"
)

TRIANGLE = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]])


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((1, 1, 0), 0),
        ((1, 1, 2), 2),
        ((1, 1, -2), 2),
        ((-3, 0, 4), 5),  # a corner
        ((2, -5, 0), 5),  # an edge
        ((7, 0, 4), 5),  # another corner
        ((4, 3, 0), 2.4),  # the slanted edge
        ((0, 0, 0), 0),
    ],
)
def test_a_point_and_a_triangle(point, distance):
    got = distances_to_triangles(np.array([point], dtype=float), TRIANGLE)
    assert got[0] == pytest.approx(distance, abs=1e-15)


@pytest.mark.parametrize(
    "corners", [[[0, 0, 0], [1, 0, 0], [3, 0, 0]], [[0, 0, 0], [3, 0, 0], [0, 0, 0]]]
)
def test_a_triangle_without_area_is_its_edges(corners):
    points = np.array([[2.0, 1, 0], [5, 0, 0], [-1, 0, 0]])
    repeated = np.array([corners] * 3, dtype=float)
    assert distances_to_triangles(points, repeated) == pytest.approx([1, 2, 1])


@needs_library
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_as_a_search_through_all_triangles(scale):
    vertices, faces = torus()
    surface = Mesh(scale * noisy(vertices, 3, 0.1), faces)
    points = scale * np.random.default_rng(1).uniform(-5.0, 5.0, (200, 3))
    got = distances_to_surface(points, surface)
    triangles = surface.vertices[surface.faces]
    for point, distance in zip(points, got, strict=True):
        everywhere = distances_to_triangles(np.tile(point, (len(triangles), 1)), triangles)
        assert distance == pytest.approx(everywhere.min(), rel=1e-6, abs=0.0)


@needs_library
def test_both_ways_and_hausdorff_of_two_cubes():
    small = prepare_mesh(*cube()).mesh
    large = small.with_vertices(3.0 * small.vertices)
    to_small, to_large, hausdorff = surface_distances(small, large)
    assert to_small.max == pytest.approx(np.sqrt(3.0))
    assert to_large.max == pytest.approx(1.0)
    assert hausdorff == pytest.approx(np.sqrt(3.0))
    assert surface_distances(small, small)[2] == pytest.approx(0.0, abs=1e-12)


@needs_library
def test_centres_of_faces_count_for_hausdorff():
    flat, faces = grid(2, 2)
    raised = Mesh(
        np.concatenate([flat, [[0.5, 0.5, 2.0]]]),
        np.array([[0, 1, 4], [1, 3, 4], [3, 2, 4], [2, 0, 4]], dtype=np.int32),
    )
    # All vertices of the lower mesh lie on the upper one; only its faces are away from it.
    _, to_raised, hausdorff = surface_distances(raised, Mesh(flat, faces))
    assert hausdorff == 2.0
    _, back, hausdorff = surface_distances(Mesh(flat, faces), raised)
    assert (back.max, hausdorff) == (0.0, 2.0)
    assert to_raised.max == 2.0


def test_without_the_library_the_error_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "fcpw", None)
    with pytest.raises(UnsupportedError) as caught:
        distances_to_surface(np.zeros((1, 3)), Mesh(*cube()))
    assert caught.value.code == "E_NO_LIBRARY"
    assert "pip install fcpw" in caught.value.hint
    with pytest.raises(UnsupportedError):
        surface_distance.build_scene(Mesh(*cube()), 1.0)
    for found in (None, "a module"):
        monkeypatch.setattr("importlib.util.find_spec", lambda name, found=found: found)
        assert (not surface_distance.find_obstacle()) is (found is not None)


def test_of_vertices_that_are_one_the_first_counts():
    # Corners of a square as two triangles without shared vertices, and one that no face uses.
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]])
    vertices = np.concatenate([[[7.0, 7.0, 7.0]], vertices])
    faces = np.array([[1, 2, 3], [4, 5, 6]], dtype=np.int32)
    ready = prepare_mesh(vertices, faces)
    other = vertices + np.arange(7.0)[:, None]
    got = at_other_positions(ready, other).vertices + ready.origin
    place = ready.vertex_map
    assert place is not None and place[0] == -1 and place[1] == place[4] and place[3] == place[5]
    for file_vertex in (1, 2, 3, 6):
        assert got[place[file_vertex]] == pytest.approx(other[file_vertex])
