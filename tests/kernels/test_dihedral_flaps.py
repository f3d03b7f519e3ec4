"""Flaps against a dictionary of edges, their angles, and dirt."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.faces import dihedral_angles, flaps
from tests.shapes import cube, grid, torus


def of(vertices, faces):
    return flaps(faces, connectivity(len(vertices), faces))


def by_dictionary(faces):
    """{(p1, p3): set of opposite vertices} of edges with exactly two faces."""
    facing = defaultdict(list)
    for face in faces.tolist():
        for k in range(3):
            facing[frozenset((face[k], face[(k + 1) % 3]))].append(face[(k + 2) % 3])
    return {
        (*sorted(edge), *sorted(opposite))
        for edge, opposite in facing.items()
        if len(opposite) == 2
    }


@pytest.mark.parametrize("shape", [torus, grid, cube])
def test_they_are_the_edges_with_two_faces(shape):
    vertices, faces = shape()
    found = of(vertices, faces)
    assert {(a, c, *sorted((b, d))) for a, b, c, d in found.tolist()} == by_dictionary(faces)
    assert len(found) == len(by_dictionary(faces))
    assert (found[:, 0] < found[:, 2]).all()
    assert (np.diff(found[:, 0]) >= 0).all()
    assert found.dtype == np.int32


def test_open_and_crowded_edges_are_left_out():
    # Three faces around the edge 0-1, and a fourth that shares 1-2 with the first.
    faces = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4], [2, 1, 5]], dtype=np.int32)
    found = flaps(faces, connectivity(6, faces))
    assert found.tolist() in ([[1, 0, 2, 5]], [[1, 5, 2, 0]])


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, np.pi / 2, 3.0, np.pi])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_angles_are_exact_and_unsigned(angle, side):
    vertices = np.array(
        [[0.0, 0, 0], [0, 1, 0], [1, 0, 0], [0.4, -np.cos(angle), side * np.sin(angle)]]
    )
    corners = np.array([[0, 1, 2, 3]], dtype=np.int32)
    assert dihedral_angles(vertices, corners)[0] == pytest.approx(angle, rel=1e-6, abs=1e-15)
