"""Edges without an opposite, against counting all edges."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.edge_sketch import FACES, FLAT, EdgeSketch
from msal_cli.mesh import prepare_mesh
from tests.shapes import cube, grid, torus


def sketch_of(vertices, faces, part_bits=12, pieces=3):
    sketch = EdgeSketch(vertices.mean(axis=0), 100.0, len(vertices), part_bits)
    for part in np.array_split(np.asarray(faces), pieces):
        sketch.add(np.ascontiguousarray(vertices[part].reshape(-1, 9)), part.astype(np.uint32))
    return sketch


def with_holes(vertices, faces):
    chosen = np.random.default_rng(4).random(len(faces)) > 0.2
    return vertices, faces[chosen]


def with_turned_faces(vertices, faces):
    faces = faces.copy()
    faces[3:9] = faces[3:9, ::-1]
    return vertices, faces


def as_soup(vertices, faces):
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def shuffled(vertices, faces):
    return vertices, np.random.default_rng(5).permutation(faces)


MESHES = {
    "cube": cube(),
    "torus": torus(),
    "grid": grid(),
    "shuffled": shuffled(*torus()),
    "holes": with_holes(*torus(40, 30)),
    "turned": with_turned_faces(*torus()),
    "soup": as_soup(*grid(20, 20)),
}


@pytest.mark.parametrize("name", MESHES)
def test_it_finds_what_counting_all_edges_finds(name):
    vertices, faces = MESHES[name]
    ready = prepare_mesh(vertices, faces)
    sketch = sketch_of(vertices, faces)
    left = sketch.left_edges()
    assert left.boundary_edges == ready.defects.boundary_edges
    assert left.inconsistent_edges == ready.defects.inconsistent_edges
    assert left.crowded_edges == 0
    n_sides = 3 * sketch.sums[FACES]
    assert sketch.sums[FLAT] == ready.defects.degenerate_faces
    assert (sketch.sums[2] + left.boundary_length) / (
        n_sides + left.boundary_edges
    ) == pytest.approx(ready.mesh.mean_edge_length, rel=1e-12)


def test_an_edge_that_three_faces_run_through_in_one_direction_is_crowded():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -1, 0]], dtype=float)
    left = sketch_of(vertices, np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]])).left_edges()
    assert (left.boundary_edges, left.crowded_edges) == (6, 1)


def test_too_many_edges_for_the_table_are_not_counted():
    vertices = np.random.default_rng(0).random((900, 3))
    faces = np.arange(900).reshape(-1, 3)
    assert sketch_of(vertices, faces, part_bits=12).left_edges().boundary_edges == 900
    assert sketch_of(vertices, faces, part_bits=8).left_edges() is None


def test_faces_with_a_repeated_corner_have_no_edges_and_use_no_vertices():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, 0], [5, 5, 5]], dtype=float)
    sketch = sketch_of(vertices, np.array([[0, 1, 2], [0, 4, 3]]))
    assert np.unpackbits(sketch.used, bitorder="little")[:5].tolist() == [1, 1, 1, 0, 0]
    assert (sketch.sums[FACES], sketch.sums[FLAT]) == (1, 1)
    assert sketch.left_edges().boundary_edges == 3


def test_a_fan_from_minus_zero_to_zero_is_one_surface():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [-0.0, 0, 0], [0, -1, 0]])
    assert sketch_of(vertices, np.array([[0, 1, 2], [1, 3, 4]])).left_edges().boundary_edges == 4
