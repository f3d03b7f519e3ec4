"""The windowed sinc against its transfer function, VTK's and its promises."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import area_and_volume
from msal_cli.kernels.umbrellas import sinc_coefficients
from msal_cli.mesh import prepare_mesh
from tests.shapes import noisy, torus

METHOD = methods.find("windowed_sinc")

AROUND, ACROSS = 240, 12


def run(vertices, faces, **given):
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, METHOD.denoise(mesh, METHOD.validate(given)).vertices


def wave_on_torus(wave):
    """Heights that are an eigenvector of the umbrella operator, and its frequency k."""
    vertices, faces = torus(AROUND, ACROSS)
    u = np.repeat(np.arange(AROUND), ACROSS)
    vertices = np.stack([u, np.tile(np.arange(ACROSS), AROUND), np.zeros(len(u))], axis=1) * 1.0
    vertices[:, 2] = np.cos(2 * np.pi * wave * u / AROUND)
    # Of the six neighbours two keep u, two have u + 1 and two u - 1.
    return vertices, faces, 1 - (2 + 4 * np.cos(2 * np.pi * wave / AROUND)) / 6


def transfer(coefficients, k):
    return float(coefficients @ np.cos(np.arange(len(coefficients)) * np.arccos(1 - k / 2)))


@pytest.mark.parametrize("wave", [3, 20, 40, 100])
def test_a_wave_is_multiplied_by_the_transfer_function(wave):
    vertices, faces, k = wave_on_torus(wave)
    mesh, out = run(vertices, faces)
    expected = transfer(sinc_coefficients(0.1, 20), k)
    assert out[:, 2] == pytest.approx(expected * mesh.vertices[:, 2], abs=1e-12)


@pytest.mark.parametrize(
    ("passes", "pass_band", "expected"),
    [
        # Measured with VTK 9.7 at waves 16, 24 and 40 of the torus above.
        (20, 0.1, [1.0, 0.9971, 0.8829]),
        (30, 0.05, [0.9981, 0.9488, 0.3404]),
        (50, 0.01, [0.7693, 0.1617, 0.0]),
    ],
)
def test_the_transfer_function_is_that_of_vtk(passes, pass_band, expected):
    coefficients = sinc_coefficients(pass_band, passes)
    at = [transfer(coefficients, wave_on_torus(wave)[2]) for wave in (16, 24, 40)]
    assert at == pytest.approx(expected, abs=1e-3)
    assert transfer(coefficients, 0.0) == pytest.approx(1.0, abs=1e-15)
    assert transfer(coefficients, pass_band) == pytest.approx(0.99904, abs=1e-9)


def test_the_surface_does_not_shrink_and_the_noise_goes():
    vertices, faces = torus(60, 30)
    clean = prepare_mesh(vertices, faces).mesh
    mesh, out = run(noisy(vertices, 0, 0.03), faces)
    before = area_and_volume(clean)[1]
    assert area_and_volume(mesh.with_vertices(out))[1] == pytest.approx(before, rel=0.003)

    def error(positions):
        return np.linalg.norm(positions - clean.vertices, axis=1).mean()

    assert error(out) < 0.6 * error(mesh.vertices)
