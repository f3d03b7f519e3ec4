"""Displacement, normal change and volume, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.measures import area_and_volume, displacement_statistics, normal_statistics
from msal_cli.mesh import prepare_mesh
from tests.shapes import cube, fan, torus


def test_displacement_by_hand():
    before = np.zeros((20, 3))
    after = before.copy()
    after[:, 0] = np.arange(20)
    one = displacement_statistics(before, after)
    assert one.mean == pytest.approx(9.5)
    assert one.rms == pytest.approx(np.sqrt((np.arange(20) ** 2).mean()))
    assert one.p95 == 18.0  # the 19th of 20: 95 % of the vertices moved no farther
    assert one.max == 19.0
    assert one.moved_vertices == 19


def test_displacement_counts_only_what_is_asked_for():
    before, after = np.zeros((4, 3)), np.ones((4, 3))
    assert displacement_statistics(before, after, np.zeros(4, dtype=bool)).max == 0.0
    one = displacement_statistics(before, after, np.array([True, False, True, False]))
    assert one.moved_vertices == 2


def test_normals_by_hand():
    # Flatten a pyramid: every face turns by the same angle.
    vertices, faces = fan([0.0] * 4)
    vertices[0, 2] = 1.0
    tip, flat = prepare_mesh(vertices, faces).mesh, prepare_mesh(vertices * [1, 1, 0], faces).mesh
    turned = normal_statistics(tip, flat)
    angle = np.degrees(np.arccos(1 / np.sqrt(3)))
    assert turned.mean_angular_error_deg == pytest.approx(angle)
    assert turned.max_angular_error_deg == pytest.approx(angle)
    assert turned.flipped_faces == 0


def test_flips_are_counted():
    vertices, faces = torus()
    mesh = prepare_mesh(vertices, faces).mesh
    mirrored = mesh.with_vertices(mesh.vertices * [-1.0, 1.0, 1.0] * [-1.0, 1.0, 1.0])
    assert normal_statistics(mesh, mirrored).flipped_faces == 0
    folded = mesh.vertices.copy()
    ring = mesh.topology.ring[: mesh.topology.ring_start[1]]
    folded[0] = 3 * folded[ring[0]] - 2 * folded[0]
    assert normal_statistics(mesh, mesh.with_vertices(folded)).flipped_faces > 0


def test_volume_of_a_cube_anywhere():
    vertices, faces = cube()
    area, volume = area_and_volume(prepare_mesh(vertices + 1e6, faces).mesh)
    assert area == pytest.approx(6.0)
    assert volume == pytest.approx(1.0)
