"""L0 minimisation and mean curvature flow: identities, literal twins and limits."""

import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.kernels.faces import flaps
from msal_cli.kernels.geometry import area_and_volume, restore_volume
from msal_cli.mesh import prepare_mesh
from msal_cli.methods import l0
from tests.methods.runs import assert_twin, denoise, free_vertices, small_scan
from tests.shapes import cube, grid, noisy, torus

denoised = functools.partial(denoise, "l0")


def twin(mesh, iterations, sparsity, regularity, free):
    """The method with dense matrices, and coefficients as the paper prints them."""
    n = len(mesh.vertices)
    corners = flaps(mesh.faces, mesh.topology)
    edge = mesh.mean_edge_length
    p = mesh.vertices.copy()

    def normals(e):
        p1, p2, p3, p4 = mesh.vertices[corners[e]]
        first, second = np.cross(p2 - p1, p3 - p1), np.cross(p3 - p1, p4 - p1)
        return first / np.linalg.norm(first), second / np.linalg.norm(second)

    angles = [np.arccos(np.clip(np.dot(*normals(e)), -1, 1)) for e in range(len(corners))]
    gamma = np.mean(angles)
    price = sparsity * gamma * edge**2
    regular = np.zeros((len(corners), n))
    for e, flap in enumerate(corners):
        regular[e, flap] = [1, -1, 1, -1]
    for step in range(iterations):
        beta = 1e-3 * 1e6 ** (step / iterations)
        alpha = regularity * gamma * (1e-3 / beta) ** 2
        bends = np.zeros((len(corners), n))
        for e, flap in enumerate(corners):
            p1, p2, p3, p4 = p[flap]
            s123 = np.linalg.norm(np.cross(p2 - p1, p3 - p1))
            s134 = np.linalg.norm(np.cross(p3 - p1, p4 - p1))
            whole = ((p3 - p1) @ (p3 - p1)) * (s123 + s134)
            bends[e, flap] = [
                (s123 * (p4 - p3) @ (p3 - p1) + s134 * (p1 - p3) @ (p3 - p2)) / whole,
                s134 / (s123 + s134),
                (s123 * (p3 - p1) @ (p1 - p4) + s134 * (p2 - p1) @ (p1 - p3)) / whole,
                s123 / (s123 + s134),
            ]
        delta = bends @ p
        delta[(delta**2).sum(axis=1) < price / beta] = 0.0
        system = np.eye(n) + alpha * regular.T @ regular + beta * bends.T @ bends
        right = mesh.vertices + beta * bends.T @ delta - system[:, ~free] @ p[~free]
        p[free] = np.linalg.solve(system[np.ix_(free, free)], right[free])
    return p


@pytest.mark.parametrize(
    ("shape", "boundary", "given"),
    [
        ("torus", "free", {"iterations": 10}),
        ("torus", "free", {"iterations": 7, "sparsity": 1.0, "regularity": 2.0}),
        ("grid", "free", {"iterations": 10}),
        ("grid", "fixed", {"iterations": 10, "regularity": 0.0}),
    ],
)
def test_it_agrees_with_the_literal_twin(monkeypatch, shape, boundary, given):
    monkeypatch.setattr(l0, "TOLERANCE", 1e-14)
    monkeypatch.setattr(l0, "MAX_ITERATIONS", 5000)
    mesh = small_scan(shape)
    values = methods.find("l0").validate(given)
    steps = (values[name] for name in ("iterations", "sparsity", "regularity"))
    expected = twin(mesh, *steps, free_vertices(mesh, boundary))
    found = denoised(mesh, boundary=boundary, **given)
    assert_twin(mesh, found, expected, 1e-11, least=0.02)
    # As fast as it is run by users it ends close by.
    monkeypatch.undo()
    quick = denoised(mesh, boundary=boundary, **given)
    assert np.abs(quick - expected).max() < 1e-2 * mesh.mean_edge_length


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


def flow_twin(mesh, variant, time_step, iterations, free):
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
    ("shape", "boundary", "time_step", "iterations"),
    [("torus", "free", 0.25, 2), ("grid", "fixed", 2.0, 3), ("grid", "free", 0.1, 1)],
)
def test_the_flow_agrees_with_the_literal_twin(variant, shape, boundary, time_step, iterations):
    mesh = small_scan(shape)
    expected = flow_twin(mesh, variant, time_step, iterations, free_vertices(mesh, boundary))
    given = {"variant": variant, "time_step": time_step, "iterations": iterations}
    found = flowed(mesh, boundary=boundary, **given)
    assert_twin(mesh, found, expected, 1e-12 if variant == "explicit" else 1e-8, least=0.01)


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
