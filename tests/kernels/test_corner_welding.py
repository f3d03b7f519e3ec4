"""Soup into an indexed mesh."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from msal_cli.kernels.welding import weld_corners


def by_dictionary(corners: np.ndarray) -> tuple[list[tuple[float, ...]], list[int]]:
    """The same the plain way; a dictionary takes minus zero for zero as well."""
    number: dict[tuple[float, ...], int] = {}
    numbers = [number.setdefault(tuple(p), len(number)) for p in corners.reshape(-1, 3).tolist()]
    return list(number), numbers


@settings(deadline=None)
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


def test_views_into_a_file_are_read():
    facets = np.zeros(700, dtype=[("normal", "<f4", 3), ("corners", "<f4", 9), ("word", "<u2")])
    facets["corners"] = np.random.default_rng(2).integers(0, 9, (700, 9))
    shifted = np.frombuffer(b"xx" + facets.tobytes(), dtype=facets.dtype, offset=2)
    vertices, faces, bad = weld_corners(shifted["corners"])
    assert bad == -1
    assert np.array_equal(vertices[faces].reshape(-1, 9), facets["corners"])
    assert len(vertices) == len(by_dictionary(facets["corners"])[0])


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("facet", [0, 255, 256, 999])
def test_the_first_facet_that_is_not_finite_is_told(wrong, facet):
    corners = np.zeros((1000, 9))
    corners[facet, 8] = wrong
    corners[999, 0] = wrong
    assert weld_corners(corners)[2] == facet
