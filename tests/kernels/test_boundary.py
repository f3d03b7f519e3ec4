"""Which neighbours a vertex is averaged with at open edges."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msal_cli.kernels.connectivity import averaged_ring, boundary_curves, connectivity
from tests.methods.plain_rings import rows
from tests.shapes import grid, torus


def listed(start, row):
    return [sorted(row[a:b].tolist()) for a, b in itertools.pairwise(start)]


def test_the_rim_of_a_grid_worked_by_hand():
    # 0 1 2
    # 3 4 5   with diagonals 0-4, 1-5, 3-7 and 4-8
    # 6 7 8
    vertices, faces = grid(3, 3)
    links = connectivity(len(vertices), faces)
    rim = [[1, 3], [0, 2], [1, 5], [0, 6], [], [2, 8], [3, 7], [6, 8], [5, 7]]
    assert listed(*boundary_curves(faces, links)) == rim
    middle = [0, 1, 3, 5, 7, 8]
    rim[4] = middle
    assert listed(*averaged_ring(faces, links, "curve")) == rim
    fixed = [[]] * 4 + [middle] + [[]] * 4
    assert listed(*averaged_ring(faces, links, "fixed")) == fixed


@pytest.mark.parametrize("boundary", ["free", "fixed", "curve"])
def test_a_closed_surface_keeps_its_rings(boundary):
    vertices, faces = torus(9, 7)
    links = connectivity(len(vertices), faces)
    start, ring = averaged_ring(faces, links, boundary)
    assert (start == links.ring_start).all()
    assert (ring == links.ring).all()


@settings(max_examples=60, deadline=None)
@given(
    chosen=st.lists(
        st.tuples(st.integers(0, 9), st.integers(0, 9), st.integers(0, 9)).filter(
            lambda face: len(set(face)) == 3
        ),
        min_size=1,
        max_size=25,
        unique_by=lambda face: tuple(sorted(face)),
    ),
    boundary=st.sampled_from(["free", "fixed", "curve"]),
)
def test_any_set_of_faces_gives_the_rows_of_the_plain_twin(chosen, boundary):
    # Non-manifold edges, bow-ties, lone faces and unreferenced vertices all come up.
    faces = np.array(chosen, dtype=np.int32)
    links = connectivity(10, faces)
    expected = [sorted(row) for row in rows(10, faces, boundary)]
    assert listed(*averaged_ring(faces, links, boundary)) == expected
