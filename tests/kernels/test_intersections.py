"""Faces that intersect each other, compared with exact fractions; and which one a sample shows."""

import numpy as np
import pytest

from msal_cli.kernels import intersections, z_buffer
from msal_cli.kernels.intersections import intersecting_pairs, plane_signs
from tests.kernels import plain_intersections as plain


def found(vertices, faces):
    pairs = intersecting_pairs(np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int32))
    return [tuple(pair) for pair in pairs.tolist()]


def whole(random, n):
    return random.integers(0, 4, (n, 3)).astype(float)


POSITIONS = {
    "anywhere": lambda random, n: random.normal(size=(n, 3)),
    "whole": whole,
    # 0.3 is not three times 0.1: what looks flat is not.
    "tenths": lambda random, n: 0.1 * whole(random, n),
    "flat": lambda random, n: random.integers(0, 5, (n, 3)) * (1.0, 1.0, 0.0),
    "flat and askew": lambda random, n: (
        random.integers(0, 5, (n, 2)) @ np.array([(0.48, 0.6, 0.64), (-0.6, 0.8, -0.3)]) + 1e3
    ),
    "tiny": lambda random, n: 1e-100 * whole(random, n),
    "huge": lambda random, n: 1e59 * whole(random, n),
}


def soup(random, make):
    """A few triangles among few points, so that many share vertices and edges, each once."""
    vertices = np.unique(make(random, int(random.integers(5, 10))), axis=0)
    n = len(vertices)
    triples = (random.choice(n, 3, replace=False) for _ in range(14)) if n > 2 else ()
    faces = {frozenset(map(int, triple)): triple for triple in triples}
    points = plain.exact(vertices)
    return vertices, [face for face in faces.values() if plain.has_area(points, face)]


@pytest.mark.parametrize("name", POSITIONS)
def test_fractions_say_the_same(name):
    random = np.random.default_rng(5)
    n_meeting = n_apart = 0
    for _ in range(5):
        vertices, faces = soup(random, POSITIONS[name])
        if len(faces) < 2:
            continue
        expected = plain.intersecting_pairs(vertices, faces)
        assert found(vertices, faces) == expected
        n_meeting += len(expected)
        n_apart += len(faces) * (len(faces) - 1) // 2 - len(expected)
    assert min(n_meeting, n_apart) > 7


@pytest.mark.parametrize(
    ("tip", "meet"),
    [
        # Folded onto its neighbour, partly or wholly; open by any angle; flat.
        ((0.5, 1.0, 0.0), True),
        ((9.0, 0.5, 0.0), True),
        ((0.5, 1.0, 1e-300), False),
        ((0.5, -1.0, 0.0), False),
    ],
)
def test_neighbours_intersect_only_if_they_are_folded_onto_each_other(tip, meet):
    vertices = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.3, 2.0, 0.0), tip]
    for face in ((1, 0, 3), (0, 1, 3), (3, 1, 0)):
        assert found(vertices, [(0, 1, 2), face]) == ([(0, 1)] if meet else [])


def test_neither_the_order_nor_the_size_of_chunks_matters(monkeypatch):
    random = np.random.default_rng(7)
    vertices = random.normal(size=(60, 3))
    faces = [random.choice(60, 3, replace=False) for _ in range(60)]
    pairs = found(vertices, faces)
    assert len(pairs) > 50
    monkeypatch.setattr(intersections, "NODE_PAIRS_AT_ONCE", 30)
    monkeypatch.setattr(intersections, "AT_ONCE", 23)
    assert found(vertices, faces) == pairs
    order = random.permutation(len(faces))
    mixed = np.sort(order[np.array(found(vertices, np.asarray(faces)[order]))], axis=1)
    assert sorted(map(tuple, mixed.tolist())) == pairs


@pytest.mark.parametrize("scale", [1.0, 1e-110, 1e60])
def test_signs_in_a_plane_are_exact_where_rounding_is_larger(scale):
    random = np.random.default_rng(2)
    p, q = scale * random.random((2, 200, 2))
    # On the line, but for the last digit.
    r = p + random.random((200, 1)) * (q - p)
    expected = [plain.in_plane(*rows) for rows in zip(*map(plain.exact, (p, q, r)), strict=True)]
    assert plane_signs(p, q, r).tolist() == expected
    assert {-1, 1} <= set(expected)


def drawn(points, faces, height, width):
    return z_buffer.nearest_faces(
        np.array(points, dtype=float), np.array(faces, dtype=np.int32), height, width
    )


def test_a_triangle_covers_the_samples_in_it():
    # Legs of 4 along the top and the left: in row r the middles of 4 - r samples are inside or on
    # the longest edge.
    _, front = drawn([(0, 0, 0), (4, 0, 0), (0, 4, 0)], [(0, 1, 2)], 5, 6)
    inside = [[c + r + 1 <= 4 for c in range(6)] for r in range(5)]
    assert ((front == 0) == inside).all()
    assert (front[~np.array(inside)] == z_buffer.NOTHING).all()


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_nearer_face_wins_in_any_order(order):
    square = [(0, 0), (6, 0), (6, 6), (0, 6)]
    points = [(x, y, 1.0) for x, y in square] + [(x, y, 2.0) for x, y in square[:3]]
    parts = [[(0, 1, 2), (0, 2, 3)], [(4, 5, 6)]]
    faces = [face for k in order for face in parts[k]]
    nearness, front = drawn(points, faces, 6, 6)
    near = faces.index((4, 5, 6))
    rows, columns = np.mgrid[:6, :6]
    assert ((front == near) == (columns >= rows)).all()
    assert (nearness[columns >= rows] == 2.0).all()
    assert (nearness[columns < rows] == 1.0).all()


def roof(angle):
    """Two squares that meet at an edge and turn by ``angle`` there."""
    vertices = [(0, 0, 0), (0, 1, 0), (-1, 0, 0), (-1, 1, 0)]
    vertices += [(np.cos(angle), y, -np.sin(angle)) for y in (0, 1)]
    faces = [(2, 0, 1), (2, 1, 3), (0, 4, 5), (0, 5, 1)]
    return np.array(vertices), np.array(faces, dtype=np.int32)


def test_an_edge_is_smooth_up_to_half_the_crease_and_sharp_beyond_it():
    vertices, faces = roof(np.radians(30.0))
    smooth = z_buffer.corner_normals(vertices, faces, np.radians(61.0))
    between = z_buffer.corner_normals(vertices, faces, np.radians(45.0))
    sharp = z_buffer.corner_normals(vertices, faces, np.radians(29.0))
    # At vertex 0: one triangle on the left, two on the right, all of one half.
    left, right = np.array([0, 0, 1.0]), np.array([0.5, 0, np.sqrt(0.75)])
    mean = (left + 2 * right) / np.linalg.norm(left + 2 * right)
    assert np.allclose(smooth[0, 1], mean, atol=1e-6)
    assert np.allclose(smooth[2, 0], mean, atol=1e-6)
    assert np.allclose(sharp[:2], left, atol=1e-6)
    assert np.allclose(sharp[2:], right, atol=1e-6)
    assert left @ mean < left @ between[0, 1] < 1.0
    assert right @ mean < right @ between[2, 0] < 1.0


def test_what_is_outside_or_has_no_area_is_not_drawn():
    points = [(-9, -9, 0), (-1, -9, 0), (-1, -1, 0), (1, 1, 0), (3, 3, 0), (5, 5, 0)]
    _, front = drawn(points, [(0, 1, 2), (3, 4, 5), (3, 3, 4)], 8, 8)
    assert (front == z_buffer.NOTHING).all()
