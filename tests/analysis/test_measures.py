"""Displacement, normals, volume, curvature and intersections of faces, by hand and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.analysis.measures import (
    DisplacementStatistics,
    count_self_intersections,
    displacement_statistics,
    is_negative,
    local_scale,
    mean_curvature,
    normal_statistics,
    relative_volume_change,
    self_intersection_change,
)
from msal_cli.mesh import prepare_mesh
from tests.shapes import fan, grid, torus


def test_displacement_by_hand():
    before = np.zeros((20, 3))
    after = before.copy()
    after[:, 0] = np.arange(20)
    statistics = displacement_statistics(before, after)
    assert statistics.mean == pytest.approx(9.5)
    assert statistics.rms == pytest.approx(np.sqrt((np.arange(20) ** 2).mean()))
    assert statistics.p95 == 18.0  # the 19th of 20: 95 % of the vertices moved no farther
    assert statistics.max == 19.0
    assert statistics.moved_vertices == 19


def test_displacement_counts_only_what_is_asked_for():
    before, after = np.zeros((4, 3)), np.ones((4, 3))
    none = displacement_statistics(before, after, np.zeros(4, dtype=bool))
    assert none == DisplacementStatistics(0.0, 0.0, 0.0, 0.0, 0)
    statistics = displacement_statistics(before, after, np.array([True, False, True, False]))
    assert statistics.moved_vertices == 2


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


def test_a_volume_that_is_rounding_is_none():
    flat = 8.0 * 1e-9  # the area is 4, and 4 ** 1.5 is 8
    above = np.nextafter(flat, 1.0)
    assert is_negative(-above, 4.0) and not is_negative(-flat, 4.0)
    assert relative_volume_change(flat, 1.0, 4.0) is None
    assert relative_volume_change(above, 0.0, 4.0) == -1.0
    assert relative_volume_change(-2.0, -3.0, 4.0) == 0.5


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_curvature_of_a_torus(scale):
    vertices, faces = torus(160, 80)
    mesh = prepare_mesh(scale * vertices, faces).mesh
    beta = np.arctan2(vertices[:, 2], np.hypot(vertices[:, 0], vertices[:, 1]) - 3.0)
    expected = (3.0 + 2.0 * np.cos(beta)) / (2.0 * (3.0 + np.cos(beta)))
    assert scale * mean_curvature(mesh) == pytest.approx(expected, rel=0.01, abs=0.005)


def test_the_sign_follows_the_winding():
    vertices, faces = torus(40, 20)
    outward = mean_curvature(prepare_mesh(vertices, faces).mesh)
    inward = mean_curvature(prepare_mesh(vertices, faces[:, ::-1]).mesh)
    assert outward == pytest.approx(-inward, rel=1e-9)
    assert (outward > 0.0).mean() > 0.9


def test_sigma_by_hand():
    # Heights 1, -1, ... above the plane z = 0: mean 0, mean deviation 1, sigma 2.
    mesh = prepare_mesh(*fan([1.0, -1.0, 1.0, -1.0])).mesh
    normals = np.tile([0.0, 0.0, 1.0], (5, 1))
    assert local_scale(mesh, normals)[0] == pytest.approx(2.0)
    assert local_scale(prepare_mesh(*grid()).mesh, np.tile([0.0, 0.0, 1.0], (30, 1))).max() < 1e-6


def test_what_is_created_is_neither_the_difference_nor_all():
    vertices, faces = torus(10, 6)
    # A vertex on the other side of the tube, or of the whole.
    before, after = vertices.copy(), vertices.copy()
    before[0] *= -0.9
    after[30] *= -0.9
    ready = prepare_mesh(before, faces)
    moved = ready.mesh.with_vertices(after - ready.origin)
    change = self_intersection_change(ready.mesh, moved)
    assert change.before == count_self_intersections(ready.mesh) > 0
    assert change.after == count_self_intersections(moved) > 0
    assert change.after - change.before < change.created <= change.after
    still = self_intersection_change(
        ready.mesh, ready.mesh.with_vertices(ready.mesh.vertices.copy())
    )
    assert (still.before, still.after, still.created) == (change.before, change.before, 0)


def test_faces_without_area_are_left_out():
    # The third face closes a gap that has no width, and touches the first all along an edge.
    vertices = np.array([(0, 0, 0), (2, 0, 0), (1, 2, 0), (1, 0, 0), (1, -2, 0)], dtype=float)
    faces = np.array([(0, 1, 2), (3, 0, 4), (0, 3, 1)], dtype=np.int32)
    ready = prepare_mesh(vertices, faces)
    assert ready.defects.degenerate_faces == 1
    # Those with an area touch along half an edge, and share a vertex only.
    assert count_self_intersections(ready.mesh) == 1
