"""Which border points of different meshes are one."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.analysis.shared_borders import (
    Border,
    count_unmatched,
    find_border,
    near_pairs,
    share_borders,
)
from msal_cli.codecs import open_mesh
from msal_cli.job.room import prepare_mesh
from tests.batch.tile_files import ply
from tests.shapes import grid


def border_of(vertices, faces):
    mesh_file = open_mesh(ply(vertices, faces, "<f8"), "a.ply")
    return find_border(prepare_mesh(mesh_file), mesh_file.vertices, mesh_file.faces)


def points(*rows):
    """A border that has points only."""
    positions = np.array(rows, dtype=float).reshape(-1, 3)
    n = len(positions)
    return Border(
        positions,
        np.arange(n),
        np.arange(n, dtype=np.int32),
        np.zeros(n, dtype=np.int64),
        np.empty((0, 2), dtype=np.int32),
    )


def share(*several, single=None):
    return share_borders(several, single or [False] * len(several))


def test_the_border_of_a_grid_is_its_rim():
    vertices, faces = grid(4, 5)
    border = border_of(vertices, faces)
    assert len(border.positions) == len(border.edges) == 14
    assert np.array_equal(border.positions, vertices[border.vertices])
    assert np.array_equal(vertices[faces.reshape(-1)[border.corners]], border.positions)
    lengths = border.positions[border.edges[:, 0]] - border.positions[border.edges[:, 1]]
    assert np.allclose(np.linalg.norm(lengths, axis=1), 1.0)


def test_vertices_of_one_file_that_coincide_are_one_point():
    vertices, faces = grid(4, 5)
    soup = vertices[faces.reshape(-1)]
    border = border_of(soup, np.arange(len(soup)).reshape(-1, 3))
    assert len(border.positions) == 14 and len(border.vertices) > 14
    assert np.array_equal(border.positions[border.points], soup[border.vertices])


def test_points_at_one_place_are_one():
    shared = share(points((0, 0, 0), (1, 0, 0)), points((1, 0, 0)), points((-0.0, 0, 0), (3, 0, 0)))
    assert shared.group.tolist() == [0, 1, 1, 0, 4]
    assert shared.is_shared.tolist() == [True, True, True, True, False]
    assert shared.neighbours() == [[1, 2], [0], [0]]


def test_points_are_one_in_single_precision_where_a_file_has_only_that():
    third = 1.0 / 3.0
    rough, exact = points((float(np.float32(third)), 0, 0)), points((third, 0, 0))
    assert share(rough, exact, single=[True, False]).group.tolist() == [0, 0]
    assert share(rough, exact, single=[False, False]).group.tolist() == [0, 1]
    # Two files in double precision are compared in it, and one file is never joined with itself.
    near = points((third, 0, 0), (third + 1e-12, 0, 0))
    assert share(near, points((9, 9, 9)), single=[False, True]).group.tolist() == [0, 1, 2]
    # Of two points of a file that round to a third, the nearer one is that.
    assert share(rough, near, single=[True, False]).group.tolist() == [0, 1, 0]
    assert share(near, rough, near, single=[False, True, False]).group.tolist() == [0, 1, 1, 0, 1]


@given(st.integers(0, 1000), st.floats(0.05, 3.0))
def test_near_pairs_are_all_pairs_within_reach(seed, reach):
    random = np.random.default_rng(seed)
    a, b = random.normal(size=(12, 3)), random.normal(size=(9, 3))
    distances = np.linalg.norm(a[:, None] - b[None], axis=2)
    wanted = {(int(i), int(j)) for i, j in zip(*np.nonzero(distances <= reach), strict=True)}
    assert set(zip(*(x.tolist() for x in near_pairs(a, b, reach)), strict=True)) == wanted


def test_points_amid_the_edges_of_another_file_are_unmatched():
    coarse, faces = grid(3, 3)
    fine, fine_faces = grid(5, 5)
    fine = fine / 2.0 + (2.0, 0.0, 0.0)
    several = [border_of(coarse, faces), border_of(fine, fine_faces)]
    shared = share(*several)
    assert shared.is_shared.sum() == 6
    assert count_unmatched(several, shared, 1.0) == [0, 2]
