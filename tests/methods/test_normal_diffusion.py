"""Diffusion of normals: a literal twin, what the parameters do, and measured figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.normal_filters import difference_width
from msal_cli.mesh import prepare_mesh
from tests.shapes import cube, grid, noisy, torus

METHOD = methods.find("normal_diffusion")


def diffused(mesh, **given):
    return METHOD.denoise(mesh, METHOD.validate(given)).vertices


def scan(level=0.12, seed=3, shape=torus, **size):
    vertices, faces = shape(**size)
    return prepare_mesh(noisy(vertices, seed, level), faces).mesh


def twin(mesh, rounds, steps, passes, similarity, time_step, free):
    """Face by face and vertex by vertex, from the formulas."""
    x, faces = mesh.vertices.copy(), mesh.faces
    tau = time_step * mesh.mean_edge_length**2
    beside = [
        [
            (g, sorted(set(face) & set(other)))
            for g, other in enumerate(faces.tolist())
            if len(set(face) & set(other)) == 2
        ]
        for face in faces.tolist()
    ]
    for _ in range(rounds):
        cross = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        areas = np.linalg.norm(cross, axis=1) / 2
        n = cross / (2 * areas[:, None])
        middle = x[faces].mean(axis=1)
        for _ in range(steps):
            new = n.copy()
            for i, row in enumerate(beside):
                share = [
                    np.linalg.norm(x[a] - x[b]) / np.linalg.norm(middle[i] - middle[j])
                    for j, (a, b) in row
                ]
                step = min(tau / areas[i], 0.75 / sum(share))
                for s, (j, _) in zip(share, row, strict=True):
                    jump = n[j] - n[i]
                    new[i] += step * s * np.exp(-(jump @ jump) / (2 * similarity**2)) * jump
            n = new / np.linalg.norm(new, axis=1)[:, None]
        for _ in range(passes):
            middle = x[faces].mean(axis=1)
            moved = x.copy()
            for i in np.flatnonzero(free):
                around = np.flatnonzero((faces == i).any(axis=1))
                moved[i] += np.mean([(n[f] @ (middle[f] - x[i])) * n[f] for f in around], axis=0)
            x = moved
    return x


@pytest.mark.parametrize(
    ("shape", "boundary"), [("torus", "fixed"), ("grid", "fixed"), ("grid", "free")]
)
@pytest.mark.parametrize(("similarity", "time_step"), [(0.4, 0.1), (0.8, 0.02)])
def test_it_agrees_with_the_literal_twin(shape, boundary, similarity, time_step):
    mesh = scan(around=14, across=9) if shape == "torus" else scan(shape=grid, rows=9, columns=8)
    free = (
        ~mesh.topology.boundary if boundary == "fixed" else np.ones(len(mesh.vertices), dtype=bool)
    )
    found = diffused(
        mesh,
        iterations=2,
        normal_iterations=3,
        vertex_iterations=2,
        similarity=similarity,
        time_step=time_step,
        boundary=boundary,
    )
    expected = twin(mesh, 2, 3, 2, similarity, time_step, free)
    assert np.abs(found - expected).max() < 1e-12 * np.ptp(mesh.vertices)
    assert np.abs(found - mesh.vertices).max() > 0.01


def test_the_automatic_width_is_that_by_hand():
    mesh = scan()
    rings = face_rings(mesh.faces, mesh.topology, "edge")
    width = difference_width(face_normals(mesh.vertices, mesh.faces), *rings)
    assert (diffused(mesh) == diffused(mesh, similarity=width)).all()
    assert np.abs(diffused(mesh) - diffused(mesh, similarity=width / 2)).max() > 0.01


def test_a_clean_cube_stays_as_it_is():
    vertices, faces = cube()
    mesh = prepare_mesh(vertices, faces).mesh
    assert np.abs(diffused(mesh) - mesh.vertices).max() < 1e-15


def test_a_wider_gaussian_rounds_off_a_cube():
    vertices, faces = cube()
    mesh = prepare_mesh(vertices, faces).mesh
    moved = [np.abs(diffused(mesh, similarity=mu) - mesh.vertices).max() for mu in (0.2, 0.5, 1.0)]
    assert moved[0] < 1e-9 < moved[1] < moved[2]


def test_without_diffusion_or_without_fitting_nothing_moves():
    mesh = scan()
    assert np.abs(diffused(mesh, normal_iterations=0) - mesh.vertices).max() < 1e-14
    assert (diffused(mesh, vertex_iterations=0) == mesh.vertices).all()


def test_progress_is_told_within_rounds():
    told = []
    METHOD.denoise(scan(), METHOD.validate({}), lambda *at: told.append(at))
    assert len(told) == 3 * (15 + 7 + 1)
    assert told == sorted(told)
    assert {done for done, _ in told} == {0, 1, 2, 3}
