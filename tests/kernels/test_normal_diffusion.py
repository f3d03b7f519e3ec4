"""Diffusion of face normals: conservation, cases worked by hand, and faces without area."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.face_rings import face_rings
from msal_cli.kernels.geometry import face_normals, face_normals_and_areas
from msal_cli.kernels.normal_diffusion import difference_width, diffused_normals
from msal_cli.mesh import prepare_mesh
from tests.shapes import cube, grid, noisy, torus


def rings_of(vertices, faces):
    return face_rings(faces, prepare_mesh(vertices, faces).mesh.topology, "edge")


def roof(angle):
    """Two equilateral triangles of side 2 that share an edge along y; ``angle`` of the normals."""
    half = angle / 2
    down = np.sqrt(3) * np.array([np.cos(half), 0.0, -np.sin(half)])
    vertices = np.array([[0, -1, 0], down, [0, 1, 0], down * [-1, 1, 1]], dtype=float)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


@pytest.mark.parametrize("angle", [0.2, 1.0, 2.0])
@pytest.mark.parametrize("similarity", [0.3, 0.7])
def test_one_step_across_one_edge(angle, similarity):
    vertices, faces = roof(angle)
    tau = 0.01
    chord = 2 * np.sin(angle / 2)
    way = 2 * np.cos(angle / 2) / np.sqrt(3)  # between centroids 1 / sqrt(3) off the edge
    share = tau * (2 / way) / np.sqrt(3) * np.exp(-(chord**2) / (2 * similarity**2))
    old = np.array([[np.sin(angle / 2), 0, np.cos(angle / 2)]]) * [[1, 1, 1], [-1, 1, 1]]
    expected = old + share * (old[::-1] - old)
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    found = diffused_normals(vertices, faces, *rings_of(vertices, faces), similarity, tau, 1)
    assert np.allclose(found, expected, rtol=0, atol=1e-15)
    assert np.abs(found - old).max() > 1e-10


def test_a_long_step_goes_three_quarters_of_the_way():
    vertices, faces = roof(1.0)
    old = face_normals(vertices, faces)
    expected = old / 4 + 3 / 4 * old[::-1]
    expected /= np.linalg.norm(expected, axis=1)[:, None]
    found = diffused_normals(vertices, faces, *rings_of(vertices, faces), 1e3, 1e9, 1)
    assert np.allclose(found, expected, rtol=0, atol=1e-6)


def test_what_leaves_one_face_enters_another():
    # Before they are normalised, normals times areas keep their sum, as heat does.
    vertices, faces = torus(20, 11)
    vertices = noisy(vertices, 5, 0.03)
    normals, areas = face_normals_and_areas(vertices, faces)
    tau = 1e-7
    found = diffused_normals(vertices, faces, *rings_of(vertices, faces), 0.5, tau, 1)
    change = (found - normals) / tau
    # The part along the normal is lost in normalising: it is -|change|^2 tau / 2, far less.
    along = (change * normals).sum(axis=1)
    assert np.abs(along).max() < 1e-4 * np.abs(change).max()
    _, ways = conductances(vertices, faces, normals, 0.5)
    flux = ways - (ways * normals).sum(axis=1)[:, None] * normals
    assert np.allclose(change, flux / areas[:, None], rtol=0, atol=1e-5 * np.abs(change).max())
    assert np.abs(ways.sum(axis=0)).max() < 1e-12 * np.abs(ways).sum()


def conductances(vertices, faces, normals, similarity):
    """Edges by their faces, and the sum of l / d g (n_j - n_i) for every face, by dictionary."""
    sides = {}
    for f, face in enumerate(faces.tolist()):
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            sides.setdefault(frozenset((a, b)), []).append(f)
    total = np.zeros_like(normals)
    middle = vertices[faces].mean(axis=1)
    for edge, both in sides.items():
        if len(both) == 2:
            f, g = both
            a, b = edge
            jump = normals[g] - normals[f]
            flow = (
                np.linalg.norm(vertices[a] - vertices[b])
                / np.linalg.norm(middle[f] - middle[g])
                * np.exp(-(jump @ jump) / (2 * similarity**2))
                * jump
            )
            total[f] += flow
            total[g] -= flow
    return sides, total


@pytest.mark.parametrize("height", [0.0, 1e-13])
def test_a_face_without_area_has_no_say(height):
    vertices, faces = roof(1.0)
    vertices = np.concatenate([vertices, [vertices[1] / 2 + vertices[2] / 2 + [0, 0, height]]])
    faces = np.concatenate([faces, [[2, 1, 4]]]).astype(np.int32)
    rings = rings_of(vertices, faces)
    found = diffused_normals(vertices, faces, *rings, 0.5, 0.01, 1)
    alone = diffused_normals(vertices, faces[:2], *rings_of(vertices, faces[:2]), 0.5, 0.01, 1)
    assert (found[2] == 0.0).all()
    assert np.allclose(found[:2], alone, rtol=0, atol=1e-15)


def test_the_width_is_the_spread_of_the_differences():
    vertices, faces = cube()  # 6 flat diagonals, 12 edges of a right angle: median sqrt(2)
    rings = rings_of(vertices, faces)
    assert difference_width(face_normals(vertices, faces), *rings) == 0.0
    vertices, faces = torus(20, 11)
    vertices = noisy(vertices, 5, 0.1)
    normals = face_normals(vertices, faces)
    sides, _ = conductances(vertices, faces, normals, 1.0)
    lengths = [np.linalg.norm(normals[f] - normals[g]) for f, g in sides.values()]
    spread = 1.4826 * np.median(np.abs(lengths - np.median(lengths)))
    assert difference_width(normals, *rings_of(vertices, faces)) == pytest.approx(spread)


def test_there_may_be_no_neighbours():
    vertices = np.eye(3)
    faces = np.array([[0, 1, 2]], dtype=np.int32)
    rings = rings_of(vertices, faces)
    assert difference_width(face_normals(vertices, faces), *rings) == 0.0
    found = diffused_normals(vertices, faces, *rings, 0.0, 0.1, 3)
    assert np.allclose(found, face_normals(vertices, faces))
    vertices, faces = grid(4, 4)
    flat = diffused_normals(vertices, faces, *rings_of(vertices, faces), 0.0, 0.1, 3)
    assert (flat == [0, 0, 1]).all()
