"""Mean curvature flow: exact solutions, identities, a literal twin, and measured figures."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from msal_cli.kernels.geometry import area_and_volume, restore_volume
from msal_cli.mesh import prepare_mesh
from tests.methods.runs import denoise, free_vertices, small_scan
from tests.shapes import cube, grid, noisy, torus

flowed = functools.partial(denoise, "mean_curvature_flow")


def twin_laplacian(vertices, faces):
    """Stiffness matrix and mixed areas, face by face."""
    n = len(vertices)
    stiffness, areas = np.zeros((n, n)), np.zeros(n)
    for face in faces:
        p = vertices[face]
        cot, edge = np.zeros(3), np.zeros(3)
        for k in range(3):
            u, v = p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]
            cot[k] = (u @ v) / np.linalg.norm(np.cross(u, v))
            edge[k] = np.linalg.norm(u - v)
        area = np.linalg.norm(np.cross(p[1] - p[0], p[2] - p[0])) / 2
        stiff = cot * min(1.0, 2 * area / (0.05 * edge.max() ** 2))
        for k in range(3):
            i, j = face[(k + 1) % 3], face[(k + 2) % 3]
            stiffness[i, j] -= stiff[k] / 2
            stiffness[j, i] -= stiff[k] / 2
            stiffness[i, i] += stiff[k] / 2
            stiffness[j, j] += stiff[k] / 2
            if cot.min() < 0:
                areas[face[k]] += area / 2 if cot[k] < 0 else area / 4
            else:
                q, r = (k + 1) % 3, (k + 2) % 3
                areas[face[k]] += (edge[q] ** 2 * cot[q] + edge[r] ** 2 * cot[r]) / 8
    return stiffness, areas


def twin(mesh, variant, time_step, iterations, free):
    x = mesh.vertices.copy()
    tau = time_step * mesh.mean_edge_length**2
    first, _ = twin_laplacian(x, mesh.faces)
    for _ in range(iterations):
        stiffness, areas = twin_laplacian(x, mesh.faces)
        if variant == "explicit":
            beside = np.abs(2 * (stiffness - np.diag(np.diag(stiffness)))).sum(axis=1)
            step = np.minimum(tau, 2 * areas / beside)
            moved = x - (step / areas)[:, None] * (stiffness @ x)
        else:
            system = np.diag(areas) + tau * first
            right = areas[:, None] * x - system[:, ~free] @ x[~free]
            moved = x.copy()
            moved[free] = np.linalg.solve(system[np.ix_(free, free)], right[free])
        x = np.where(free[:, None], moved, x)
    return x


@pytest.mark.parametrize("variant", ["explicit", "implicit"])
@pytest.mark.parametrize(
    ("shape", "boundary"), [("torus", "free"), ("grid", "fixed"), ("grid", "free")]
)
@pytest.mark.parametrize(("time_step", "iterations"), [(0.1, 1), (0.25, 2), (2.0, 3)])
def test_it_agrees_with_the_literal_twin(variant, shape, boundary, time_step, iterations):
    mesh = small_scan(shape)
    expected = twin(mesh, variant, time_step, iterations, free_vertices(mesh, boundary))
    given = {"variant": variant, "time_step": time_step, "iterations": iterations}
    found = flowed(mesh, boundary=boundary, **given)
    size = np.ptp(mesh.vertices, axis=0).max()
    assert np.abs(found - expected).max() < (1e-12 if variant == "explicit" else 1e-8) * size
    assert np.abs(found - mesh.vertices).max() > 0.01


def test_long_steps_and_many_are_stable():
    vertices, faces = torus()
    mesh = prepare_mesh(noisy(vertices, 2, 0.3), faces).mesh
    for given in (
        {"variant": "explicit", "iterations": 300, "time_step": 1000.0},
        {"variant": "implicit", "iterations": 10, "time_step": 1000.0},
    ):
        out = flowed(mesh, **given)
        assert np.isfinite(out).all()
        assert np.abs(out).max() <= np.abs(mesh.vertices).max()


def test_volume_is_restored_about_the_centre_of_mass():
    vertices, faces = torus(40, 20)
    mesh = prepare_mesh(noisy(vertices, 6, 0.05) + [5.0, 1.0, 0.0], faces).mesh
    free = flowed(mesh, iterations=3)
    restored = flowed(mesh, iterations=3, volume="restore")
    before = area_and_volume(mesh.vertices, faces)[1]
    assert area_and_volume(free, faces)[1] < 0.97 * before
    assert area_and_volume(restored, faces)[1] == pytest.approx(before, rel=1e-12)
    grown = (restored - restored.mean(axis=0)) / (free - free.mean(axis=0))
    assert np.ptp(grown) < 1e-9 * grown.mean()


def test_an_open_surface_is_not_scaled():
    vertices, faces = grid(9, 8)
    mesh = prepare_mesh(noisy(vertices, 5, 0.1), faces).mesh
    assert (flowed(mesh, volume="restore") == flowed(mesh)).all()
    # Nor is one that passed through itself.
    vertices, faces = cube()
    assert (restore_volume(-2.0 * vertices, vertices, faces) == vertices).all()
