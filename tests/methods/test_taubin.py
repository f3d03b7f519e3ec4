"""Taubin's filter against its transfer function, its plain twin and reference figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import area_and_volume
from msal_cli.errors import UsageError
from msal_cli.mesh import prepare_mesh
from tests.methods.plain_rings import rows, umbrella
from tests.shapes import grid, noisy, torus

METHOD = methods.find("taubin")


def run(vertices, faces, **given):
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, METHOD.denoise(mesh, METHOD.validate(given)).vertices


def step_of(**given):
    return METHOD.module.Parameters(**METHOD.validate(given)).outward_step


def test_the_steps_are_the_common_ones():
    assert METHOD.validate({})["shrink"] == 0.5
    assert step_of() == pytest.approx(-0.53, abs=5e-5)
    assert step_of(pass_band=0.1, shrink=0.6307) == pytest.approx(-0.6732, abs=5e-5)
    assert step_of(mu=-0.6) == -0.6
    assert step_of(pass_band=0.0) == -0.5


def test_a_wave_is_multiplied_by_the_transfer_function():
    # On the regular torus grid z = cos(2 pi w u) is an eigenvector of the umbrella operator.
    around, across, wave = 24, 12, 5
    vertices, faces = torus(around, across)
    u = np.repeat(np.arange(around), across)
    vertices = np.stack([u, np.tile(np.arange(across), around), np.zeros(len(u))], axis=1) * 1.0
    vertices[:, 2] = np.cos(2 * np.pi * wave * u / around)
    # Of the six neighbours two keep u, two have u + 1 and two u - 1.
    k = 1 - (2 + 4 * np.cos(2 * np.pi * wave / around)) / 6
    mesh, out = run(vertices, faces, iterations=3, mu=-0.53)
    expected = ((1 - 0.5 * k) * (1 + 0.53 * k)) ** 3
    assert out[:, 2] == pytest.approx(expected * mesh.vertices[:, 2], abs=1e-14)


@pytest.mark.parametrize("boundary", ["curve", "free", "fixed"])
def test_it_agrees_with_the_plain_twin(boundary):
    vertices, faces = grid(9, 8)
    vertices = noisy(vertices, 2, 0.2)
    mesh, out = run(vertices, faces, iterations=7, mu=-0.7, shrink=0.6, boundary=boundary)
    x = mesh.vertices
    ring = rows(len(x), faces, boundary)
    for _ in range(7):
        x = x + 0.6 * umbrella(x, ring)
        x = x - 0.7 * umbrella(x, ring)
    assert np.abs(out - x).max() <= 1e-12 * np.ptp(mesh.vertices)


def test_it_keeps_the_volume_that_the_umbrella_loses():
    vertices, faces = torus(60, 30)
    mesh, out = run(noisy(vertices, 0, 0.03), faces, iterations=20)
    shrunken = methods.find("umbrella").denoise(
        mesh, methods.find("umbrella").validate({"iterations": 20})
    )

    def volume(positions):
        return area_and_volume(mesh.with_vertices(positions))[1]

    before = volume(mesh.vertices)
    assert abs(volume(out) / before - 1) < 0.025
    assert volume(shrunken.vertices) / before < 0.9


@pytest.mark.parametrize(("shrink", "inflate"), [(0.1, -1.0), (0.3, -0.6), (0.49, -1.0)])
def test_steps_that_amplify_noise_are_refused(shrink, inflate):
    with pytest.raises(UsageError, match=f"mu = {inflate:g} amplify noise") as caught:
        METHOD.validate({"lambda": shrink, "mu": inflate})
    assert f"{-1.06 * shrink:.4g}" in caught.value.hint


@pytest.mark.parametrize(("shrink", "inflate"), [(0.5, -1.0), (2 / 3, -1.0), (0.5, -0.5)])
def test_steps_that_are_allowed_damp_noise(shrink, inflate):
    METHOD.validate({"lambda": shrink, "mu": inflate})
    k = np.linspace(1, 2, 101)
    assert np.abs((1 - shrink * k) * (1 - inflate * k)).max() <= 1 + 1e-12
