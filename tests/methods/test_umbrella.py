"""The umbrella operator against its formula, hand-worked cases and reference figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.mesh import prepare_mesh
from tests import paper
from tests.methods.plain_rings import rows, umbrella
from tests.shapes import fan, grid, noisy, torus

METHOD = methods.find("umbrella")


def run(vertices, faces, **given):
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, METHOD.denoise(mesh, METHOD.validate(given)).vertices


SHAPES = {
    "torus": (noisy(torus()[0], 1), torus()[1]),
    "open": (noisy(grid(9, 8)[0], 2, 0.2), grid(9, 8)[1]),
}


def test_a_full_step_goes_to_the_mean_of_the_neighbours():
    vertices, faces = fan([0.2, 0.4, 0.9, 0.5])
    mesh, out = run(vertices, faces, iterations=1, time_step=1.0, boundary="fixed")
    assert out[0] - mesh.vertices[0] == pytest.approx([0.0, 0.0, 0.5], abs=1e-15)
    assert (out[1:] == mesh.vertices[1:]).all()


def test_a_rim_is_a_curve():
    # The inner vertex of a regular fan stands over the plane of its rim.  Averaged along the rim
    # only, the rim's vertices of a hexagon move towards its centre by half a step of 1 - cos 60,
    # whatever the inner vertex does.
    vertices, faces = fan([0.0] * 6)
    vertices[0, 2] = 5.0
    mesh, out = run(vertices, faces, iterations=1)
    radii = np.linalg.norm((out - mesh.vertices[0])[1:, :2], axis=1)
    assert radii == pytest.approx([0.75] * 6)
    assert np.ptp(out[1:, 2]) == 0.0
    assert (out[1:, 2] == mesh.vertices[1:, 2]).all()
    _, free = run(vertices, faces, iterations=1, boundary="free")
    assert (free[1:, 2] > mesh.vertices[1:, 2] + 0.5).all()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("boundary", ["curve", "free", "fixed"])
@pytest.mark.parametrize("schedule", ["plain", "constant", "multiscale"])
def test_it_agrees_with_the_plain_twin(shape, boundary, schedule):
    vertices, faces = SHAPES[shape]
    mesh, out = run(
        *(vertices, faces), iterations=4, boundary=boundary, schedule=schedule, K=0.6, fidelity=0.3
    )
    v = mesh.vertices
    x = v.copy()
    rings = paper.one_rings(len(v), faces)
    normals = paper.normal_field(v, faces, 1)
    for sweep in range(4):
        tau, pull = 0.5, np.zeros(len(v))
        if schedule == "constant":
            pull += 0.3
        if schedule == "multiscale":
            heights = [(x[ring] - x[i]) @ normals[i] for i, ring in enumerate(rings)]
            sigma = np.array([2 * np.mean(np.abs(h - np.mean(h))) for h in heights])
            tau, pull = 0.5 * 0.6**sweep, sigma / sigma.max()
        x = x + tau * umbrella(x, rows(len(v), faces, boundary)) + pull[:, None] * (v - x)
    assert np.abs(out - x).max() <= 1e-12 * np.ptp(v)
    assert np.abs(out - v).max() > 1e-2
