"""Distances to a surface, and which border points of different meshes are one."""

import numpy as np
import pytest

from msal_cli.analysis import measures
from msal_cli.analysis.measures import at_other_positions, nearest_on_surface, surface_distances
from msal_cli.analysis.shared_borders import Border, count_unmatched, find_border, share_borders
from msal_cli.codecs import open_mesh
from msal_cli.job import room
from msal_cli.kernels.nearest_triangles import find_nearest_triangles
from msal_cli.mesh import Mesh, prepare_mesh
from tests.batch.tile_files import ply
from tests.shapes import cube, grid, noisy, torus

TRIANGLE = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]])


def distances_to_triangles(points, corners):
    """Distances (n,) from points (n, 3) each to its own triangle, (n, 3, 3)."""
    best = np.full(len(points), np.inf)
    first = corners[:, 0]
    normals = np.cross(corners[:, 1] - first, corners[:, 2] - first)
    squared = (normals * normals).sum(axis=1)
    within = squared > 0.0
    for start, end in ((0, 1), (1, 2), (2, 0)):
        edge, offset = corners[:, end] - corners[:, start], points - corners[:, start]
        length = (edge * edge).sum(axis=1)
        share = (offset * edge).sum(axis=1) / np.where(length > 0.0, length, 1.0)
        rest = offset - np.clip(share, 0.0, 1.0)[:, None] * edge
        best = np.minimum(best, (rest * rest).sum(axis=1))
        within &= (np.cross(edge, offset) * normals).sum(axis=1) >= 0.0
    height = ((points - first) * normals).sum(axis=1)
    flat = height * height / np.where(squared > 0.0, squared, 1.0)
    return np.sqrt(np.where(within, np.minimum(flat, best), best))


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
    surface = Mesh(TRIANGLE[0], np.array([[0, 1, 2]], dtype=np.int32))
    got = nearest_on_surface(np.array([point], dtype=float), surface)
    assert got[1][0] == pytest.approx(distance, abs=1e-15)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("count", [1, 5, 9, 576])
def test_as_a_search_through_all_triangles(scale, count):
    vertices, faces = torus()
    # The last one has no area.
    faces = np.concatenate([faces[: count - 1], [[0, 1, 1]]]).astype(np.int32)
    vertices = scale * noisy(vertices, 3, 0.1)
    points = scale * np.random.default_rng(1).uniform(-5.0, 5.0, (80, 3))
    points[:20] = vertices[:20]
    found, distances = find_nearest_triangles(points, vertices, faces)
    triangles = vertices[faces]
    for point, nearest, distance in zip(points, found, distances, strict=True):
        everywhere = distances_to_triangles(np.tile(point, (len(triangles), 1)), triangles)
        assert distance == pytest.approx(everywhere.min(), rel=1e-12, abs=1e-14 * scale)
        assert everywhere[nearest] == pytest.approx(distance, rel=1e-12, abs=1e-14 * scale)


@pytest.mark.parametrize("scale", [1e-120, 1e120])
def test_no_square_overflows_or_vanishes(scale):
    vertices, faces = torus()
    points = np.random.default_rng(2).uniform(-5.0, 5.0, (50, 3))
    _, expected = nearest_on_surface(points, Mesh(vertices, faces))
    _, got = nearest_on_surface(scale * points, Mesh(scale * vertices, faces))
    assert got == pytest.approx(scale * expected, rel=1e-9, abs=0.0)


def test_the_first_of_triangles_that_are_equally_near():
    vertices, faces = torus()
    expected = [int(np.flatnonzero((faces == i).any(axis=1))[0]) for i in range(len(vertices))]
    surface = Mesh(vertices, faces)
    assert nearest_on_surface(vertices, surface)[0].tolist() == expected
    # Whatever was looked up before.
    back = nearest_on_surface(vertices[::-1].copy(), surface)[0]
    assert back[::-1].tolist() == expected


def test_both_ways_and_hausdorff_of_two_cubes():
    small = prepare_mesh(*cube()).mesh
    large = small.with_vertices(3.0 * small.vertices)
    to_small, to_large, hausdorff = surface_distances(small, large)
    assert to_small.max == pytest.approx(np.sqrt(3.0))
    assert to_large.max == pytest.approx(1.0)
    assert hausdorff == pytest.approx(np.sqrt(3.0))
    assert surface_distances(small, small)[2] == pytest.approx(0.0, abs=1e-12)


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


def test_large_meshes_are_sampled(monkeypatch):
    small = prepare_mesh(*torus()).mesh
    large = small.with_vertices(1.1 * small.vertices)
    exact = surface_distances(small, large)
    monkeypatch.setattr(measures, "MAX_POINTS", 300)
    monkeypatch.setattr(measures, "SAMPLED_POINTS", 300)
    assert measures.sampling_step(small) == 3
    sampled = surface_distances(small, large)
    assert sampled[0].mean == pytest.approx(exact[0].mean, rel=0.15)
    assert sampled[2] <= exact[2]


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


def border_of(vertices, faces):
    mesh_file = open_mesh(ply(vertices, faces, "<f8"), "a.ply")
    return find_border(room.prepare_mesh(mesh_file), mesh_file.vertices, mesh_file.faces)


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
    # Of two points of a file that round to a third it is not known which one is that.
    assert share(rough, near, single=[True, False]).group.tolist() == [0, 1, 2]


def test_points_amid_the_edges_of_another_file_are_unmatched():
    coarse, faces = grid(3, 3)
    fine, fine_faces = grid(5, 5)
    fine = fine / 2.0 + (2.0, 0.0, 0.0)
    several = [border_of(coarse, faces), border_of(fine, fine_faces)]
    shared = share(*several)
    assert shared.is_shared.sum() == 6
    assert count_unmatched(several, shared, 1.0) == [0, 2]
