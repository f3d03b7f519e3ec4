"""Rings, edges, winding and components; points at one place, a soup, and the order in space."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.kernels import spatial_order
from msal_cli.kernels.connectivity import (
    connectivity,
    count_components,
    faces_to_flip,
)
from msal_cli.kernels.welding import first_alike, weld_corners
from tests.paper import one_rings
from tests.shapes import cube, grid, torus


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
    vertices, ordered, ranks = spatial_order.sort_in_space(corners, faces, np.zeros(3), 1.0)
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
