"""Rings, edges, winding, components, points at one place, the order in space; faces that touch."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.errors import TooLargeError
from msal_cli.kernels import faces as module
from msal_cli.kernels import spatial_order
from msal_cli.kernels.connectivity import connectivity, count_components, faces_to_flip
from msal_cli.kernels.faces import MAX_AROUND, face_centroids, face_rings, faces_within
from msal_cli.kernels.welding import first_alike, weld_corners
from tests.methods.plain_normals import neighbours
from tests.paper import one_rings
from tests.shapes import cube, fan, grid, torus


def rings(links):
    return [
        links.ring[links.ring_start[i] : links.ring_start[i + 1]].tolist()
        for i in range(len(links.ring_start) - 1)
    ]


@st.composite
def triangle_sets(draw):
    n = draw(st.integers(3, 12))
    triangle = st.lists(st.integers(0, n - 1), min_size=3, max_size=3, unique=True)
    faces = draw(st.lists(triangle, min_size=1, max_size=30))
    return n, np.array(faces, dtype=np.int32)


@given(triangle_sets())
def test_rings_and_edges_of_any_triangle_set(case):
    n, faces = case
    links = connectivity(n, faces)
    assert [sorted(ring) for ring in rings(links)] == one_rings(n, faces)
    around: dict[tuple[int, int], list[bool]] = {}
    for face in faces.tolist():
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            around.setdefault((min(a, b), max(a, b)), []).append(a < b)
    assert links.boundary_edges == sum(len(uses) == 1 for uses in around.values())
    assert links.non_manifold_edges == sum(len(uses) > 2 for uses in around.values())
    assert links.inconsistent_edges == sum(
        len(uses) == 2 and uses[0] == uses[1] for uses in around.values()
    )
    ends = {i for edge, uses in around.items() if len(uses) == 1 for i in edge}
    assert set(np.flatnonzero(links.boundary)) == ends
    face_start, entries = links.incidence
    incident = [sorted(entries[face_start[i] : face_start[i + 1]].tolist()) for i in range(n)]
    assert incident == [[f for f, face in enumerate(faces.tolist()) if i in face] for i in range(n)]


@given(triangle_sets())
def test_components_of_any_triangle_set(case):
    n, faces = case
    used = np.zeros(n, dtype=bool)
    used[faces] = True
    parts = [{i} for i in range(n) if used[i]]
    for face in faces.tolist():
        touched = [part for part in parts if part & set(face)]
        parts = [part for part in parts if not part & set(face)] + [set().union(*touched)]
    assert count_components(n, faces, used) == len(parts)


@given(st.integers(0, 2**20), st.sampled_from(["torus", "grid", "cube"]))
def test_any_turned_faces_are_turned_back(seed, shape):
    vertices, faces = {"torus": torus, "grid": grid, "cube": cube}[shape]()
    rng = np.random.default_rng(seed)
    turned = rng.random(len(faces)) < 0.3
    mixed = np.where(turned[:, None], faces[:, ::-1], faces)
    flip, unorientable = faces_to_flip(mixed, connectivity(len(vertices), mixed))
    again = np.where(flip[:, None], mixed[:, ::-1], mixed)
    assert unorientable == 0
    assert connectivity(len(vertices), again).inconsistent_edges == 0
    assert flip.sum() * 2 <= len(faces)


def test_a_moebius_band_is_left_alone():
    count = 11
    rows = [(2 * k, 2 * k + 1) for k in range(count)]
    rows.append((1, 0))
    faces = []
    for (a, b), (c, d) in itertools.pairwise(rows):
        faces += [(a, b, d), (a, d, c)]
    faces = np.array(faces, dtype=np.int32)
    links = connectivity(2 * count, faces)
    flip, unorientable = faces_to_flip(faces, links)
    assert unorientable == 1
    assert not flip.any()


@pytest.mark.parametrize("facet", [0, 255, 256, 999])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_the_first_facet_that_is_not_finite_is_reported(wrong, facet):
    corners = np.zeros((1000, 9))
    corners[facet, 8] = corners[999, 0] = wrong
    assert weld_corners(corners)[2] == facet


@given(
    st.lists(st.sampled_from([0.0, -0.0, 1.0, 1e-300, np.nextafter(1.0, 2)]), min_size=9),
    st.integers(0, 5),
)
def test_welding_is_by_exact_position(values, skip):
    points = np.array(values[: len(values) // 3 * 3]).reshape(-1, 3)
    used = np.arange(len(points)) % 6 != skip
    seen: dict[tuple[float, ...], int] = {}
    expected = [
        seen.setdefault(tuple(point), i) if use else i
        for i, (point, use) in enumerate(zip((points + 0.0).tolist(), used, strict=True))
    ]
    assert first_alike(points, used)[0].tolist() == expected


@pytest.mark.parametrize("share", [0.001, 0.5, 0.9, 1.0])
def test_everything_grows_where_more_is_found_than_usual(share):
    # A closed surface has a sixth as many vertices as corners; these have up to all of them.
    rng = np.random.default_rng(1)
    positions = rng.integers(-(2**20), 2**20, (int(share * 30_000), 3)) / 2.0**10
    order = np.concatenate(
        [np.arange(len(positions)), rng.integers(0, len(positions), 30_000 - len(positions))]
    )
    corners = positions[rng.permutation(order)].reshape(-1, 9)
    vertices, faces, bad = weld_corners(corners)
    assert bad == -1
    assert np.array_equal(vertices[faces].reshape(-1, 9), corners)
    assert len(np.unique(vertices, axis=0)) == len(vertices)


# The order of vertices in space


def test_the_order_is_that_of_the_cells_and_the_numbers(monkeypatch):
    monkeypatch.setattr(spatial_order, "BLOCK_BYTES", 50)
    # Corners of the unit cube: the code of a cell has the bits of x below those of y and z.
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    faces = np.array([[7, 6, 4], [0, 1, 2]], dtype=np.int32)
    vertices, ordered, ranks = spatial_order.sort_in_space(corners, faces)
    assert vertices.tolist() == [
        [0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [1, 0, 1], [0, 1, 1], [1, 1, 1]
    ]  # fmt: skip
    assert ranks.tolist() == [0, 4, 2, 6, 1, 5, 3, 7]
    assert ordered.tolist() == [[0, 4, 2], [7, 3, 1]]


def test_faces_that_follow_one_another_tell_the_order():
    n = 350
    faces = np.stack([np.arange(n * n - n - 1) + k for k in (0, 1, n)], axis=1).astype(np.int32)
    assert not spatial_order.is_random(faces)
    draw = np.random.default_rng(1)
    assert spatial_order.is_random(draw.permutation(n * n).astype(np.int32)[faces])
    assert spatial_order.is_random(faces[draw.permutation(len(faces))])


def rows(faces, sharing, n=None):
    faces = np.asarray(faces, dtype=np.int32)
    links = connectivity(int(faces.max()) + 1 if n is None else n, faces)
    start, ring = face_rings(faces, links, sharing)
    assert start.dtype == ring.dtype == np.int32
    assert start[0] == 0
    assert start[-1] == len(ring)
    return [ring[start[f] : start[f + 1]].tolist() for f in range(len(faces))]


def book(pages):
    """Faces that all share the edge from vertex 0 to vertex 1."""
    return [[0, 1, 2 + page] for page in range(pages)]


def test_books_and_bow_ties_by_hand():
    for sharing in ("edge", "vertex"):
        assert [sorted(row) for row in rows(book(3), sharing)] == [[1, 2], [0, 2], [0, 1]]
    # Faces that touch at one vertex only, and one face apart.
    ties = [[0, 1, 2], [2, 3, 4], [4, 5, 0], [6, 7, 8]]
    assert rows(ties, "edge") == [[]] * 4
    assert [sorted(row) for row in rows(ties, "vertex")] == [[1, 2], [0, 2], [0, 1], []]


def test_an_edge_with_too_many_faces_makes_no_neighbours():
    assert rows(book(MAX_AROUND + 1), "vertex") == [[] for _ in range(MAX_AROUND + 1)]


def test_around_a_hub_the_neighbours_are_those_across_edges():
    count = MAX_AROUND + 1
    found = rows(fan([0.0] * count)[1], "vertex")
    # The rim's vertices have two faces each, which share an edge anyway.
    assert [sorted(row) for row in found] == [
        sorted({(f - 1) % count, (f + 1) % count}) for f in range(count)
    ]


def test_small_meshes_keep_their_rows(monkeypatch):
    _, faces = grid(5, 4)
    links = connectivity(20, faces)
    kept = face_rings(faces, links, "vertex")
    assert face_rings(faces, links, "vertex") is kept
    assert len(face_rings(faces, links, "edge")[1]) < len(kept[1])
    monkeypatch.setattr("msal_cli.kernels.connectivity.KEPT_FACES", len(faces) - 1)
    assert face_rings(faces, links, "vertex") is not kept


def test_too_many_neighbours_are_refused(monkeypatch):
    _, faces = grid(5, 4)
    links = connectivity(20, faces)
    _, ring = face_rings(faces, links, "vertex")
    monkeypatch.setattr(module, "MAX_PAIRS", len(ring))
    face_rings(faces, connectivity(20, faces), "vertex")
    monkeypatch.setattr(module, "MAX_PAIRS", len(ring) - 1)
    links = connectivity(20, faces)  # the others keep their rings
    with pytest.raises(TooLargeError, match=f"{len(ring)} neighbours"):
        face_rings(faces, links, "vertex")


def near_rows(vertices, faces, radius, most):
    ring = face_rings(faces, connectivity(len(vertices), faces), "vertex")
    start, near = faces_within(face_centroids(vertices, faces), *ring, radius, most)
    return [row.tolist() for row in np.split(near, start[1:-1])]


def test_it_does_not_jump_gaps():
    # The far strip is within the radius, the one between it and the near one was taken away.
    vertices, faces = grid(4, 4)
    centroids = vertices[faces].mean(axis=1)
    faces = faces[np.abs(centroids[:, 1] - 1.5) > 0.5]
    low = np.flatnonzero(vertices[faces].mean(axis=1)[:, 1] < 1)
    found = near_rows(vertices, faces, 100.0, 1000)
    for f in low:
        assert set(found[f]) == set(low) - {f}


def test_it_stops_at_the_most():
    vertices, faces = grid(20, 20)
    found = near_rows(vertices, faces, 100.0, 30)
    assert {len(row) for row in found} == {30}
    # The first are those that share a vertex.
    for row, others in zip(found, neighbours(faces, "vertex"), strict=True):
        assert sorted(row[: len(others)]) == others
