"""Normals, areas, volumes, angles and the recomputation of stored normals."""

import numpy as np

from msal_cli.kernels.geometry import (
    count_parallel,
    face_normals_and_areas,
    normals_and_flat_faces,
    regroup_normals,
    surface_change,
    vertex_normals,
)
from msal_cli.mesh import prepare_mesh
from tests.shapes import noisy, torus


def test_area_weighting():
    # One large upward and three small tilted faces: area weighting leans to the large one.
    vertices = np.array([[0, 0, 0], [4, 0, 0], [0, 4, 0], [-1, 0, 1], [0, -1, 1]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1]], dtype=np.int32)
    mesh = prepare_mesh(vertices, faces).mesh
    units, areas = face_normals_and_areas(mesh.vertices, mesh.faces)
    for weighting, weights in (("uniform", np.ones(3)), ("area", areas)):
        total = (weights[:, None] * units).sum(axis=0)
        expected = total / np.linalg.norm(total)
        assert np.allclose(mesh.vertex_normals(weighting)[0], expected, atol=1e-15)
    uniform, area = mesh.vertex_normals("uniform")[0], mesh.vertex_normals("area")[0]
    assert area[2] > uniform[2]


def test_where_unit_normals_cancel_the_areas_decide():
    # Two faces back to back around the same edge, one of them larger; and two that cancel wholly.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 2, 0]], dtype=float)
    back_to_back = np.array([[0, 1, 3], [1, 0, 2]], dtype=np.int32)
    normals, flat = normals_and_flat_faces(vertices, back_to_back, "uniform")
    assert normals.tolist() == [[0, 0, 1], [0, 0, 1], [0, 0, -1], [0, 0, 1]]
    assert flat == 0
    alike = np.array([[0, 1, 2], [1, 0, 2]], dtype=np.int32)
    assert vertex_normals(vertices, alike, "uniform").tolist() == [[0, 0, 0]] * 4


def test_a_seam_with_equal_normals_stays_smooth_and_a_crease_stays_sharp():
    # Two strips that share their edge's points but not their vertices.
    vertices = np.array(
        [[0, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [1, 0, 0], [1, 1, 0], [2, 0, 0], [2, 1, 0]],
        dtype=float,
    )
    faces = np.array([[0, 2, 3], [0, 3, 1], [4, 6, 7], [4, 7, 5]], dtype=np.int32)
    moved = vertices.copy()
    moved[6:, 2] = 1.0
    smooth = np.tile([0.0, 0.0, 1.0], (8, 1))
    normals, _ = regroup_normals(vertices, moved, faces, faces, smooth)
    assert np.allclose(normals[2], normals[4])
    assert np.allclose(normals[3], normals[5])
    crease = smooth.copy()
    crease[4:] = [0.1, 0.0, 1.0]
    normals, _ = regroup_normals(vertices, moved, faces, faces, crease)
    assert np.allclose(normals[2], [0, 0, 1])
    assert np.allclose(normals[4], np.array([-1, 0, 1]) / np.sqrt(2))


def test_faces_without_a_normal_before_or_after_have_no_angle():
    # One face turns by 60 degrees; the corners of the other are in a line.
    before = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0]], dtype=float)
    after = before.copy()
    after[2] = [0.0, 0.5, np.sqrt(0.75)]
    faces = np.array([[0, 1, 2], [0, 1, 3]], dtype=np.int32)
    for vertices in ((before, after), (after, before)):
        _, _, *angles, flipped = surface_change(*vertices, faces)
        assert flipped == 0
        np.testing.assert_allclose(angles, np.pi / 3.0, rtol=1e-12)
    # A face becomes a line, or a line a face.
    after[2] = [-1.0, 0.0, 0.0]
    for vertices in ((before, after), (after, before)):
        assert surface_change(*vertices, faces[:1])[2:] == (0.0, 0.0, 0)
    after[2] = [0.0, -1.0, 0.0]
    assert surface_change(before, after, faces)[2:] == (np.pi, np.pi, 1)


def test_parallel_normals_are_those_that_numpy_finds():
    vertices, faces = torus()
    normals = prepare_mesh(noisy(vertices, level=0.02), faces).mesh.vertex_normals()
    counts, turned = np.empty(9, dtype=np.int64), np.ascontiguousarray(normals.T)
    count_parallel(normals[:9].copy(), turned, 0.9, counts)
    assert counts.tolist() == (np.abs(normals[:9] @ turned) > 0.9).sum(axis=1).tolist()
