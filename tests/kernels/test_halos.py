"""Depths, rings and numbering of tiles, against plain loops."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli.kernels import halos
from msal_cli.kernels.connectivity import connectivity, incidence
from tests.shapes import grid, torus

SOUPS = st.lists(st.tuples(*[st.integers(0, 19)] * 3), min_size=1, max_size=60)


def to_records(faces, numbers=None) -> np.ndarray:
    faces = np.array(faces, dtype=np.uint32).reshape(-1, 3)
    numbers = np.arange(len(faces)) if numbers is None else np.array(numbers)
    return np.column_stack([numbers, faces]).astype(np.uint32)


def distances(faces, sources: set[int], n: int) -> list[float]:
    """Edges from the nearest source to each of n vertices."""
    far = [0.0 if i in sources else np.inf for i in range(n)]
    for _ in range(n):
        for face in faces:
            least = min(far[i] for i in face)
            for i in face:
                far[i] = min(far[i], least + 1)
    return far


@given(SOUPS, st.integers(0, 20), st.integers(0, 20), st.integers(1, 5))
def test_rims_have_what_is_near_to_others(faces, low, high, rings):
    first, stop = min(low, high), max(low, high)
    own = [face for face in faces if any(first <= i < stop for i in face)]
    records = to_records(own)
    far = distances(own, {i for i in range(20) if not first <= i < stop}, 20)
    near = [
        f for f, face in enumerate(own) if any(first <= i < stop and far[i] < rings for i in face)
    ]
    assert halos.border_records(records, first, stop - first, rings).tolist() == near
    crossing = [not all(first <= i < stop for i in face) for face in own]
    found = halos.crossing_records(records, first, stop - first)
    assert found.tolist() == records[np.array(crossing, dtype=bool)].tolist()
    count = sum(first <= face[0] < stop for face in own)
    assert halos.count_first_corners(records, first, stop - first) == count


@given(SOUPS, st.sets(st.integers(0, 19)), st.integers(0, 5))
def test_rings_are_distances(faces, own, most):
    is_own = np.array([i in own for i in range(20)])
    found = halos.spread_rings(np.array(faces, dtype=np.int32), is_own, most)
    far = distances(faces, own, 20)
    assert found.tolist() == [halos.FAR if far[i] > most else far[i] for i in range(20)]


@given(st.sets(st.integers(0, 50)), st.sets(st.integers(0, 50)))
def test_triangles_are_merged_in_the_order_of_the_file(one, other):
    other = other - one
    lists = [to_records([(n, n + 1, n + 2) for n in sorted(k)], sorted(k)) for k in (one, other)]
    merged = halos.merge_records(*lists)
    assert merged[:, 0].tolist() == sorted(one | other)
    assert (merged[:, 1] == merged[:, 0]).all()
    assert (merged[:, 3] == merged[:, 0] + 2).all()


def test_repeated_corners_are_dropped():
    records = to_records([(0, 1, 2), (1, 1, 2), (3, 4, 3), (5, 6, 6), (2, 1, 0)])
    assert halos.drop_repeated(records)[:, 0].tolist() == [0, 4]
    clean = records[[0, 4]].copy()
    assert halos.drop_repeated(clean) is clean


def test_vertices_get_other_numbers():
    records = to_records([(10, 11, 3), (12, 90, 11), (90, 7, 10)])
    others = np.array([3, 7, 90], dtype=np.uint32)
    own_numbers = np.array([0, 4, 5], dtype=np.int32)
    other_numbers = np.array([1, 2, 9], dtype=np.int32)
    faces = halos.relabel(records, 10, own_numbers, others, other_numbers)
    assert faces.tolist() == [[0, 4, 1], [5, 9, 4], [9, 2, 0]]


@pytest.mark.parametrize("cut", [0, 3, 17, 30])
def test_each_edge_counts_in_one_part(cut):
    _, faces = grid()
    # Open, twisted and crowded edges.
    faces[3] = faces[3, ::-1]
    faces = np.concatenate([faces, [[0, 1, 29], [7, 8, 29]]]).astype(np.int32)
    links = connectivity(30, faces)
    first = np.arange(30) < cut
    rows = incidence(30, faces)
    totals = np.sum([halos.count_own_edges(faces, rows, own) for own in (first, ~first)], axis=0)
    expected = links.boundary_edges, links.inconsistent_edges, links.non_manifold_edges
    assert tuple(totals) == expected
    assert min(expected) > 0


def test_own_flat_faces_are_counted():
    vertices, faces = torus(6, 5)
    vertices[faces[4]] = vertices[faces[4, 0]]
    own = np.zeros(len(faces), dtype=bool)
    assert halos.count_flat_faces(vertices, faces, own) == 0
    own[4] = True
    assert halos.count_flat_faces(vertices, faces, own) == 1


def test_shared_faces_have_vertices_of_both():
    own = np.array([True, True, True, False, False, False])
    faces = np.array([[0, 1, 2], [1, 2, 3], [5, 0, 4], [3, 4, 5]], dtype=np.int32)
    assert halos.shared_faces(faces, own).tolist() == [1, 2]
