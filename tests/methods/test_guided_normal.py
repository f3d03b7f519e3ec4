"""Guided normal filtering: edges that it keeps, a literal twin, and the authors' figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import normal_statistics
from msal_cli.mesh import prepare_mesh
from tests.methods import plain_normals as plain
from tests.shapes import fan, grid, noisy, roof, torus

METHOD = methods.find("guided_normal")


def run(vertices, faces, **given):
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, METHOD.denoise(mesh, METHOD.validate(given)).vertices


def twin(
    mesh, free, iterations=20, similarity=0.35, closeness=1.0, radius=2.0, vertex_iterations=10
):
    x, faces = mesh.vertices, mesh.faces
    touching, across = plain.sharing(faces, 1), plain.sharing(faces, 2)
    centroids = x[faces].mean(axis=1)
    near = plain.near(centroids, touching, radius * plain.mean_distance(centroids, across))
    for _ in range(iterations):
        n, areas = plain.normals_and_areas(x, faces)
        g = plain.guides(n, areas, touching, across)
        c = x[faces].mean(axis=1)
        sigma = closeness * plain.mean_distance(c, across)
        wanted = plain.joint(n, g, areas, c, near, sigma, similarity)
        x = plain.moved(x, wanted, faces, free, vertex_iterations)
    return x


def test_a_sharp_edge_stays():
    # Beside the ridge there is always a patch on one side, and the other side weighs exp(-100).
    mesh, out = run(*roof(12, 13), similarity=0.1)
    assert np.abs(out - mesh.vertices).max() < 1e-13


def test_a_sharp_edge_comes_back_under_noise():
    vertices, faces = roof(24, 25)
    clean = prepare_mesh(vertices, faces)
    mesh = clean.mesh.with_vertices(noisy(clean.mesh.vertices, 4, 0.2))
    out = METHOD.denoise(mesh, METHOD.validate({})).vertices

    def error(positions):
        moved = mesh.with_vertices(positions)
        return normal_statistics(clean.mesh, moved).mean_angular_error_deg

    assert error(mesh.vertices) > 11.0
    assert error(out) < 2.0
    al = methods.find("al")
    assert error(out) < 0.4 * error(al.denoise(mesh, al.validate({})).vertices)


def test_one_patch_has_one_guide():
    # All faces of a fan touch, so that each is guided by the mean, upright by symmetry; with a
    # wide reach and one pass the rim stays and the hub goes to the mean height of the centroids.
    mesh, out = run(
        *fan([0.2, -0.2] * 3),
        iterations=1,
        vertex_iterations=1,
        closeness=10,
        radius=10,
        boundary="fixed",
    )
    assert out == pytest.approx(mesh.vertices, abs=1e-15)
    mesh, out = run(
        *fan([0.3] * 6),
        iterations=1,
        vertex_iterations=1,
        closeness=10,
        radius=10,
        boundary="fixed",
    )
    # The filtered normals are upright but for the Gaussian of distances; centroids are 0.2 up.
    assert out[0, 2] - mesh.vertices[0, 2] == pytest.approx(0.2, abs=2e-3)
    assert out[1:] == pytest.approx(mesh.vertices[1:], abs=0)


@pytest.mark.parametrize("shape", ["torus", "sheet", "fixed", "roof"])
def test_it_agrees_with_the_plain_twin(shape):
    vertices, faces = {"torus": torus(14, 8), "roof": roof(7, 9)}.get(shape) or grid(9, 8)
    vertices = noisy(vertices, 2, 0.15)
    given = {"iterations": 3, "vertex_iterations": 4}
    if shape != "sheet":
        given |= {"similarity": 0.5, "closeness": 1.5, "radius": 3.0}
    boundary = "fixed" if shape == "fixed" else "free"
    mesh, out = run(vertices, faces, boundary=boundary, **given)
    free = ~mesh.topology.boundary if shape == "fixed" else np.ones(len(vertices), bool)
    expected = twin(mesh, free, **given)
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(mesh.vertices)
    assert np.abs(out - mesh.vertices).max() > 1e-2
    if shape == "fixed":
        assert (out[~free] == mesh.vertices[~free]).all()
