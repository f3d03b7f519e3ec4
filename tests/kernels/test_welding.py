"""Points at one place, faces with the same corners, and soup into an indexed mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from msal_cli.kernels.welding import first_alike, number_groups, weld_corners


def by_dictionary(corners: np.ndarray) -> tuple[list[tuple[float, ...]], list[int]]:
    """The same the plain way; a dictionary takes minus zero for zero as well."""
    number: dict[tuple[float, ...], int] = {}
    numbers = [number.setdefault(tuple(p), len(number)) for p in corners.reshape(-1, 3).tolist()]
    return list(number), numbers


@given(
    arrays.arrays(
        np.float64,
        st.integers(0, 12).map(lambda m: (m, 9)),
        elements=st.sampled_from([0.0, -0.0, 1.0, -1.0, 5e-324, 1e300, 0.1]),
    )
)
def test_corners_are_numbered_in_order_of_appearance(corners):
    vertices, faces, bad = weld_corners(corners)
    wanted, numbers = by_dictionary(corners)
    assert bad == -1
    assert vertices.tolist() == [list(p) for p in wanted]
    assert faces.reshape(-1).tolist() == numbers
    assert not np.signbit(vertices[vertices == 0.0]).any()


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


@given(st.lists(st.tuples(st.integers(-2, 5), st.integers(-2, 5)), min_size=1, max_size=60))
def test_pairs_are_numbered_in_order_of_appearance(pairs):
    order = list(dict.fromkeys(pairs))
    left, right = np.array(pairs, dtype=np.int32).T.copy()
    number, first = number_groups(left, right)
    assert number.tolist() == [order.index(pair) for pair in pairs]
    assert first.tolist() == [pairs.index(pair) for pair in order]


@pytest.mark.parametrize("share", [0.001, 0.5, 1.0])
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
