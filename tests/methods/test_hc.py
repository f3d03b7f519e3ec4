"""The HC algorithm against its plain twin, hand-worked cases and reference figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import area_and_volume
from msal_cli.mesh import prepare_mesh
from tests.methods.plain_rings import hc, rows
from tests.shapes import fan, grid, noisy, torus

METHOD = methods.find("hc")


def run(vertices, faces, **given):
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, METHOD.denoise(mesh, METHOD.validate(given)).vertices


def test_one_step_worked_by_hand():
    # With a fixed rim only vertex 0 moves: p = 0.3 up, b = 0.3, pushed back by 0.6 of it.
    vertices, faces = fan([0.3] * 6)
    mesh, out = run(vertices, faces, iterations=1, boundary="fixed")
    assert out[0, 2] - mesh.vertices[0, 2] == pytest.approx(0.4 * 0.3)
    # Then p = 0.18 up again, b = 0.3 - (0.1 * 0 + 0.9 * 0.12) = 0.192.
    _, out = run(vertices, faces, iterations=2, boundary="fixed")
    assert out[0, 2] - mesh.vertices[0, 2] == pytest.approx(0.3 - 0.6 * 0.192)


@pytest.mark.parametrize("boundary", ["curve", "free", "fixed"])
@pytest.mark.parametrize(("alpha", "beta"), [(0.1, 0.6), (0.0, 0.5), (0.7, 0.9)])
def test_it_agrees_with_the_plain_twin(boundary, alpha, beta):
    vertices, faces = grid(9, 8)
    vertices = noisy(vertices, 2, 0.2)
    mesh, out = run(vertices, faces, boundary=boundary, alpha=alpha, beta=beta)
    expected = hc(mesh.vertices, rows(len(vertices), faces, boundary), 10, alpha, beta)
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(mesh.vertices)
    assert np.abs(out - mesh.vertices).max() > 1e-2


def test_pushing_back_its_own_correction_alone_undoes_everything():
    # beta = 1, alpha = 0: q = p - (p - q).
    vertices, faces = torus()
    mesh, out = run(noisy(vertices), faces, alpha=0.0, beta=1.0)
    assert np.abs(out - mesh.vertices).max() < 1e-13


def test_it_shrinks_less_than_the_umbrella():
    vertices, faces = torus(60, 30)
    mesh, out = run(noisy(vertices, 0, 0.03), faces)
    umbrella = methods.find("umbrella")
    other = umbrella.denoise(mesh, umbrella.validate({"iterations": 10})).vertices

    def volume(positions):
        return area_and_volume(mesh.with_vertices(positions))[1]

    lost, by_umbrella = (1 - volume(one) / volume(mesh.vertices) for one in (out, other))
    assert abs(lost) < by_umbrella / 10
