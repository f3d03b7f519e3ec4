"""Tangent planes that disagree, and steps towards them."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.geometry import vertex_normals
from msal_cli.kernels.projections import normal_spread, towards_planes
from tests.shapes import fan, grid, noisy, torus


def roof(slope):
    """A grid folded along x = 3, with both sides falling off at ``slope`` radians."""
    vertices, faces = grid(7, 7)
    out = vertices[:, 0] - 3.0
    vertices[:, 0] = 3.0 + out * np.cos(slope)
    vertices[:, 2] = -np.abs(out) * np.sin(slope)
    return vertices, faces


@pytest.mark.parametrize("slope", [0.05, 0.4, 1.2])
def test_the_spread_of_an_edge_is_that_of_half_its_angle(slope):
    vertices, faces = roof(slope)
    links = connectivity(len(vertices), faces)
    normals = vertex_normals(vertices, faces, "uniform")
    spread = normal_spread(vertices, faces, links, normals).reshape(7, 7)
    assert spread[1:-1, 3] == pytest.approx(1 - np.cos(slope), rel=1e-12)
    assert np.abs(spread[:, [0, 1, 5, 6]]).max() < 1e-15


def test_faces_without_area_and_vertices_without_faces_have_no_spread():
    vertices, faces = roof(0.5)
    vertices = np.concatenate([vertices, [(vertices[0] + vertices[1]) / 2], [[9.0, 9.0, 9.0]]])
    faces = np.concatenate([faces, [[0, 49, 1]]]).astype(np.int32)
    links = connectivity(len(vertices), faces)
    normals = vertex_normals(vertices, faces, "uniform")
    spread = normal_spread(vertices, faces, links, normals)
    assert np.abs(spread[[0, 1, 49, 50]]).max() < 1e-15


def test_one_step_worked_by_hand():
    # Four neighbours, two with planes x = 0.3, two with planes z = 0.4: half of each step.
    vertices, faces = fan([0.4] * 4)
    vertices[[1, 3], 0] = 0.3
    normals = np.zeros((5, 3))
    normals[[1, 3]] = [1.0, 0.0, 0.0]
    normals[[2, 4]] = [0.0, 0.0, -1.0]
    links = connectivity(5, faces)
    move = towards_planes(vertices, normals, links.ring_start, links.ring)[0]
    assert move == pytest.approx([0.15, 0.0, 0.2], abs=1e-15)


def test_steps_lead_to_the_edge_of_two_planes():
    vertices, faces = roof(0.6)
    links = connectivity(len(vertices), faces)
    normals = vertex_normals(vertices, faces, "uniform")
    middle = 3 * 7 + 3
    x = vertices.copy()
    x[middle] += [0.25, 0.0, -0.3]
    for _ in range(400):
        x[middle] += towards_planes(x, normals, links.ring_start, links.ring)[middle]
    assert x[middle, [0, 2]] == pytest.approx(vertices[middle, [0, 2]], abs=1e-9)


def test_a_plain_twin():
    x, faces = torus()
    x = noisy(x, 4, 0.2)
    links = connectivity(len(x), faces)
    normals = vertex_normals(x, faces, "uniform")
    spread = normal_spread(x, faces, links, normals)
    moves = towards_planes(x, normals, links.ring_start, links.ring)
    for i in range(len(x)):
        around = faces[(faces == i).any(axis=1)]
        crossed = np.cross(x[around[:, 1]] - x[around[:, 0]], x[around[:, 2]] - x[around[:, 0]])
        unit = crossed / np.linalg.norm(crossed, axis=1)[:, None]
        assert spread[i] == pytest.approx(np.mean(1 - unit @ normals[i]), abs=1e-14)
        steps = [normals[k] * ((x[k] - x[i]) @ normals[k]) for k in set(around.ravel()) - {i}]
        assert moves[i] == pytest.approx(np.mean(steps, axis=0), abs=1e-14)
