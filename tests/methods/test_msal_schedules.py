"""The robust and the Wiener schedule: against their definitions, and where the paper's fails."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from msal_cli import methods
from msal_cli.analysis.noise_estimate import estimate_noise
from msal_cli.mesh import prepare_mesh
from tests.methods import plain_restoration as plain
from tests.methods.runs import SHAPES
from tests.shapes import ball, noisy, torus


def run(vertices, faces, name="msal", **given):
    method = methods.find(name)
    return method.denoise(prepare_mesh(vertices, faces).mesh, method.validate(given))


def textured_ball():
    """A sphere with waves of a third of an edge length, and a little noise."""
    vertices, faces = ball(96, 48)
    outward = vertices / np.linalg.norm(vertices, axis=1)[:, None]
    wave = 0.02 * np.sin(24 * outward[:, 0]) * np.sin(24 * outward[:, 2])
    heights = 0.004 * np.random.default_rng(0).normal(size=len(vertices))
    return vertices + (wave + heights)[:, None] * outward, faces


def spiked(vertices):
    """The same with one vertex far out."""
    result = vertices.copy()
    result[len(result) // 2] *= 3.0
    return result


def centred(shape):
    vertices, faces = SHAPES[shape]
    return vertices - (vertices.min(axis=0) + vertices.max(axis=0)) / 2, faces


@given(
    seed=st.integers(0, 10**6),
    level=st.floats(0.0, 0.5),
    quantile=st.floats(0.01, 1.0),
    K=st.floats(0.05, 1.0),
)
def test_lambda_stays_within_0_and_1_and_the_definition(seed, level, quantile, K):
    vertices, faces = torus(9, 7)
    vertices = noisy(vertices, seed, level)
    vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    result = run(vertices, faces, schedule="robust", quantile=quantile, K=K, n=3)
    expected = plain.robust(vertices, faces, 3, K, quantile, 1)
    assert np.abs(result.vertices - expected).max() <= 1e-12 * np.ptp(vertices)
    fidelity = result.fields["fidelity"]
    assert fidelity.min() >= 0.0
    assert 1.0 - 1e-15 <= fidelity.max() <= 1.0


def test_one_spike_takes_the_papers_lambda_and_not_the_robust_one():
    vertices, faces = textured_ball()
    spike = spiked(vertices)

    def fidelity(positions, schedule):
        return float(np.median(run(positions, faces, schedule=schedule).fields["fidelity"]))

    assert fidelity(spike, "multiscale") < 0.1 * fidelity(vertices, "multiscale")
    assert fidelity(spike, "robust") == pytest.approx(fidelity(vertices, "robust"), rel=0.05)


@pytest.mark.parametrize("shape", ["torus", "open grid", "tiny"])
@pytest.mark.parametrize(("noise", "caution"), [(0.1, 1.0), (0.02, 1.2), (0.05, 0.3)])
def test_wiener_is_what_its_definition_says(shape, noise, caution):
    vertices, faces = centred(shape)
    unit = prepare_mesh(vertices, faces).mesh.mean_edge_length
    expected = plain.wiener(vertices, faces, 3, noise * unit, caution, 1)
    given = {"schedule": "wiener", "noise": noise, "caution": caution, "n": 3}
    assert np.abs(run(vertices, faces, **given).vertices - expected).max() < 1e-12 * np.ptp(
        vertices
    )


def test_wiener_estimates_the_noise_unless_it_is_given():
    vertices, faces = torus(64, 32)
    vertices = noisy(vertices, 1)
    level = estimate_noise(prepare_mesh(vertices, faces).mesh).mean_edges
    by_itself = run(vertices, faces, schedule="wiener").vertices
    assert np.allclose(by_itself, run(vertices, faces, schedule="wiener", noise=level).vertices)
    assert not np.allclose(
        by_itself, run(vertices, faces, schedule="wiener", noise=3 * level).vertices
    )


@pytest.mark.parametrize("schedule", ["multiscale", "robust", "wiener"])
@pytest.mark.parametrize("name", ["msal", "umbrella"])
def test_trust_scales_the_pull_and_what_is_held_stays(schedule, name):
    vertices, faces = SHAPES["torus"]
    mesh = prepare_mesh(vertices, faces).mesh
    method = methods.find(name)
    parameters = method.validate({"schedule": schedule})
    assert method.has_data_term(parameters)
    trust = np.random.default_rng(0).random(len(vertices))
    whole = method.denoise(mesh, parameters)
    scaled = method.denoise(mesh.with_constraints(None, trust), parameters)
    assert np.allclose(
        scaled.fields["fidelity"], trust * whole.fields["fidelity"], rtol=1e-14, atol=0
    )
    held = np.arange(len(vertices)) % 5 == 0
    stays = method.denoise(mesh.with_constraints(held, None), parameters)
    assert (stays.vertices[held] == mesh.vertices[held]).all()
    assert (stays.vertices[~held] != mesh.vertices[~held]).any()
