"""The static/dynamic filter: edges, its energy, a literal twin, and measured figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import normal_statistics
from msal_cli.mesh import prepare_mesh
from tests.methods import plain_normals as plain
from tests.shapes import grid, noisy, roof, torus

METHOD = methods.find("static_dynamic")


def run(vertices, faces, **given):
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, METHOD.denoise(mesh, METHOD.validate(given)).vertices


def twin(
    mesh,
    free,
    iterations=5,
    strength=2.0,
    closeness=1.5,
    guidance=1.5,
    similarity=0.3,
    tolerance_deg=0.2,
    vertex_iterations=10,
):
    """As the paper writes it: with dense matrices of weights, and a sum over unordered pairs."""
    x, faces = mesh.vertices, mesh.faces
    touching, across = plain.sharing(faces, 1), plain.sharing(faces, 2)
    for _ in range(iterations):
        n0, areas = plain.normals_and_areas(x, faces)
        g = plain.guides(n0, areas, touching, across)
        c = x[faces].mean(axis=1)
        eta = closeness * plain.mean_distance(c, across)
        is_near = np.zeros((len(faces), len(faces)))
        for i, others in enumerate(plain.near(c, touching, 3 * eta)):
            is_near[i, list(others)] = 1
        assert (is_near == is_near.T).all()

        def squares(field):
            return ((field[:, None] - field[None, :]) ** 2).sum(axis=2)

        spatial = (areas[:, None] + areas) * is_near * np.exp(-squares(c) / (2 * eta**2))
        weights = spatial * np.exp(-squares(g) / (2 * guidance**2))
        scaled = strength * areas.sum() / np.triu(spatial).sum()
        n = n0
        for _ in range(100):
            sums = (2 * similarity**2 / scaled * areas)[:, None] * n0
            sums = sums + (weights * np.exp(-squares(n) / (2 * similarity**2))) @ n
            new = sums / np.linalg.norm(sums, axis=1)[:, None]
            change = np.sqrt((areas * ((new - n) ** 2).sum(axis=1)).sum() / areas.sum())
            n = new
            if change <= 2 * np.sin(np.radians(tolerance_deg) / 2):
                break
        x = plain.moved(x, n, faces, free, vertex_iterations)
    return x


def test_a_sharp_edge_stays():
    # Across the ridge a pair weighs exp(-|n_i - n_j|^2 / (2 nu^2)) = exp(-100).
    mesh, out = run(*roof(24, 25), similarity=0.1)
    assert np.abs(out - mesh.vertices).max() < 1e-13


def test_a_sharp_edge_comes_back_under_noise():
    vertices, faces = roof(24, 25)
    clean = prepare_mesh(vertices, faces)
    mesh = clean.mesh.with_vertices(noisy(clean.mesh.vertices, 4, 0.2))
    out = METHOD.denoise(mesh, METHOD.validate({})).vertices

    def error(positions):
        return normal_statistics(clean.mesh, mesh.with_vertices(positions)).mean_angular_error_deg

    assert error(mesh.vertices) > 11.0
    assert error(out) < 1.0


@pytest.mark.parametrize("shape", ["torus", "sheet", "fixed"])
def test_it_agrees_with_the_plain_twin(shape):
    vertices, faces = torus(14, 8) if shape == "torus" else grid(9, 8)
    vertices = noisy(vertices, 2, 0.1)
    given = {"iterations": 2, "vertex_iterations": 4}
    if shape != "sheet":
        given |= {"strength": 0.7, "closeness": 0.8, "guidance": 0.4, "similarity": 0.5}
        given |= {"tolerance_deg": 0.05}
    boundary = "fixed" if shape == "fixed" else "free"
    mesh, out = run(vertices, faces, boundary=boundary, **given)
    free = ~mesh.topology.boundary if shape == "fixed" else np.ones(len(vertices), bool)
    expected = twin(mesh, free, **given)
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(mesh.vertices)
    assert np.abs(out - mesh.vertices).max() > 1e-2
    if shape == "fixed":
        assert (out[~free] == mesh.vertices[~free]).all()
