"""Diffusion of normals: a literal twin, what the parameters do, and measured figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.kernels.faces import face_rings
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.normal_filters import difference_width
from msal_cli.mesh import prepare_mesh
from tests.methods import plain_normals as plain
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
        n, areas = plain.normals_and_areas(x, faces)
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
            n = plain.unit(new)
        x = plain.moved(x, n, faces, free, passes)
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


def test_progress_is_told_within_rounds():
    told = []
    METHOD.denoise(scan(), METHOD.validate({}), lambda *at: told.append(at))
    assert len(told) == 3 * (15 + 7 + 1)
    assert told == sorted(told)
    assert {done for done, _ in told} == {0, 1, 2, 3}
