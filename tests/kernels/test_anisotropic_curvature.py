"""Edge curvature vectors: their identity, edges worked by hand, and the automatic threshold."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.anisotropic_curvature import (
    AnisotropicCurvature,
    curvature_threshold,
    edge_curvatures,
)
from msal_cli.kernels.dihedral_flaps import flaps
from msal_cli.mesh import prepare_mesh
from tests.shapes import cube, grid, noisy, torus


def flaps_of(vertices, faces):
    return flaps(faces, prepare_mesh(vertices, faces).mesh.topology)


def area_gradient(vertices, faces):
    """Gradient of the area by the product rule on |cross product|, face by face."""
    gradient = np.zeros_like(vertices)
    for face in faces:
        for k in range(3):
            p, q, r = vertices[np.roll(face, -k)]
            normal = np.cross(q - p, r - p)
            gradient[face[k]] += np.cross(normal / np.linalg.norm(normal), r - q) / 2
    return gradient


def roof(angle):
    """A ridge of length 2 along y whose two faces make ``angle`` with each other."""
    half = angle / 2
    down = np.array([np.cos(half), 0.0, -np.sin(half)])
    vertices = np.array([[0, -1, 0], down, [0, 1, 0], down * [-1, 1, 1]], dtype=float)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def test_half_their_sum_is_the_gradient_of_the_area():
    vertices, faces = torus(20, 11)
    vertices = noisy(vertices, 5, 0.2)
    corners = flaps_of(vertices, faces)
    total = np.zeros_like(vertices)
    for end in (0, 2):
        np.add.at(total, corners[:, end], edge_curvatures(vertices, corners) / 2)
    expected = area_gradient(vertices, faces)
    assert np.abs(total - expected).max() < 1e-14 * np.abs(expected).max() * 10
    assert np.abs(expected).max() > 0.1


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.3, 1.0, np.pi / 2, 3.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_ridge_points_out_and_a_valley_in(angle, side):
    vertices, faces = roof(angle)
    vertices *= [1, 1, side]
    if side < 0:
        faces = faces[:, ::-1].copy()
    found = edge_curvatures(vertices, np.array([[0, 1, 2, 3]], dtype=np.int32))
    assert np.allclose(found, [[0, 0, side * 2 * 2 * np.sin(angle / 2)]], rtol=1e-6, atol=1e-15)


def test_an_edge_beside_a_face_without_area_has_none():
    vertices, _ = roof(1.0)
    corners = np.array([[0, 1, 2, 3]], dtype=np.int32)
    for beside in ([0, 0.3, 0], [0, 1, 0], [-1e-13, 0.3, 0]):
        vertices[3] = beside
        assert (edge_curvatures(vertices, corners) == 0.0).all()
    vertices[3] = [-1e-9, 0.3, 0]
    assert (edge_curvatures(vertices, corners) != 0.0).any()


def test_the_threshold_is_the_median_and_deviations_above_it():
    vertices, faces = cube()  # 12 edges of length sqrt(2), 6 diagonals of flat faces
    corners = flaps_of(vertices, faces)
    assert curvature_threshold(vertices, corners, 0.0) == pytest.approx(np.sqrt(2))
    assert curvature_threshold(vertices, corners, 9.0) == pytest.approx(np.sqrt(2))
    uneven = np.concatenate([corners[:1]] * 7 + [corners])
    lengths = np.linalg.norm(edge_curvatures(vertices, uneven), axis=1)
    spread = np.median(np.abs(lengths - np.median(lengths)))
    assert curvature_threshold(vertices, uneven, 2.0) == pytest.approx(
        np.median(lengths) + 2 * 1.4826 * spread
    )
    assert curvature_threshold(vertices, np.empty((0, 4), dtype=np.int32), 1.0) == 0.0


@pytest.mark.parametrize(
    ("times", "weight"), [(0.5, 1.0), (1.0, 1.0), (2.0, 1 / 11), (3.0, 1 / 41)]
)
def test_the_weight_falls_beyond_the_threshold(times, weight):
    # Both ends of the ridge have this one edge: H_A is half of w H, and w (2 lambda) < 0.1.
    vertices, faces = roof(1.0)
    links = prepare_mesh(vertices, faces).mesh.topology
    length = 4 * np.sin(0.5)
    operator = AnisotropicCurvature(
        faces,
        links,
        flaps(faces, links),
        np.array([True, False, True, True]),
        length / times,
        10.0,
        1e-6,
        prescribed=False,
    )
    area = 2 * 1 / 2 * 2  # of both faces
    expected = -1e-6 / (area / 3) * weight * length / 2
    move = operator(vertices).move
    assert move[0] == pytest.approx([0, 0, expected], rel=1e-12)
    assert move[2] == pytest.approx([0, 0, expected], rel=1e-12)
    assert (move[[1, 3]] == 0.0).all()  # one is not free, the other has open edges only


def test_open_and_crowded_edges_count_not():
    vertices, faces = grid(2, 2)
    vertices = np.concatenate([vertices, [[0.5, 0.5, 1.0]]])
    faces = np.concatenate([faces, [[0, 3, 4]]]).astype(np.int32)  # a third face on the diagonal
    mesh = prepare_mesh(vertices, faces).mesh
    corners = flaps(mesh.faces, mesh.topology)
    everywhere = np.ones(5, dtype=bool)
    operator = AnisotropicCurvature(
        mesh.faces, mesh.topology, corners, everywhere, 1.0, 10.0, 0.1, prescribed=True
    )
    assert (operator(mesh.vertices).move == 0.0).all()
