"""Cells of a grid that becomes coarser as vertices come, and the faces between them."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.cell_clusters import CellTable
from msal_cli.kernels.geometry import vertex_normals
from tests.shapes import torus


def cells_of(vertices, faces, most, pieces=5):
    low = vertices.min(axis=0).astype(float)
    table = CellTable(low, float(np.ptp(vertices, axis=0).max()), most)
    start = 0
    for part in np.array_split(vertices, pieces):
        table.enter(start, np.ascontiguousarray(part))
        start += len(part)
    cells = table.close()
    for part in np.array_split(faces, pieces):
        cells.add(np.ascontiguousarray(vertices[part].reshape(-1, 9)))
    return cells


@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_a_mesh_with_few_vertices_stays_what_it_is(kind):
    vertices, faces = torus()
    vertices = vertices.astype(kind)
    cells = cells_of(vertices, faces, 1000)
    assert np.array_equal(cells.chosen, np.arange(len(vertices)))
    assert np.array_equal(cells.vertices, vertices)
    assert np.array_equal(cells.faces, faces)
    unit = cells.normals / np.linalg.norm(cells.normals, axis=1, keepdims=True)
    wanted = vertex_normals(vertices.astype(float), faces.astype(np.int32), "uniform")
    assert unit == pytest.approx(wanted, abs=1e-12)
    assert np.array_equal(cells.facing, cells.normals)


@pytest.mark.parametrize("most", [30, 200, 900])
def test_cells_are_as_many_as_wanted_and_their_vertices_are_the_first_ones(most):
    vertices, faces = torus(80, 40)
    cells = cells_of(vertices, faces, most)
    assert most / 3 < len(cells.chosen) <= most
    assert np.array_equal(cells.vertices, vertices[cells.chosen])
    # The grid, told again from its cells: no other vertex of a cell comes before.
    low, per_cell, shifts, _, _ = cells._grid
    places = ((vertices - low) * per_cell).astype(np.int64) >> shifts
    _, first = np.unique(places, axis=0, return_index=True)
    assert np.array_equal(cells.chosen, np.sort(first))


def test_the_coarse_surface_looks_like_the_fine_one():
    rng = np.random.default_rng(3)
    vertices, faces = torus(200, 100)
    vertices = vertices + rng.normal(0.0, 0.01, vertices.shape)
    cells = cells_of(vertices, rng.permutation(faces), 1500)
    coarse = cells.faces
    assert 1500 < len(coarse) < 4000
    a, b, c = (cells.vertices[coarse[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    centre = (a + b + c) / 3
    ring = 3.0 * centre * [1, 1, 0] / np.linalg.norm(centre[:, :2], axis=1, keepdims=True)
    outwards = (normals * (centre - ring)).sum(axis=1) > 0
    assert outwards.mean() > 0.99
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(4 * np.pi**2 * 3, rel=0.1)
    assert len(np.unique(np.sort(coarse, axis=1), axis=0)) == len(coarse)
