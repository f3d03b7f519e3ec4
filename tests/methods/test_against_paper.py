"""The fast kernels against the literal transcription, and against hand-worked cases."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.operators import AnisotropicLaplacian
from msal_cli.mesh import prepare_mesh
from tests import paper
from tests.methods.runs import SHAPES, denoise
from tests.methods.runs import run_in_file as run
from tests.shapes import fan, grid, noisy, torus

ALL_SHAPES = SHAPES | {
    "far away": (SHAPES["torus"][0] + [4.65e6, 1.2e6, 300.0], SHAPES["torus"][1])
}


@pytest.mark.parametrize("shape", ALL_SHAPES)
@pytest.mark.parametrize("mollify", [0, 1, 2])
@pytest.mark.parametrize("iterations", [1, 4])
def test_kernels_agree_with_the_paper(shape, mollify, iterations):
    vertices, faces = ALL_SHAPES[shape]
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    size = np.ptp(vertices, axis=0).max()
    rounding = np.abs(vertices).max() * np.finfo(float).eps
    for name, K, chosen in [
        ("al", None, {}),
        ("msal", 0.5, {"K": 0.5}),
        ("msal", 0.2, {"K": 0.2}),
    ]:
        expected = paper.algorithm_1(vertices - centre, faces, iterations, K, mollify) + centre
        actual = run(name, vertices, faces, iterations=iterations, mollify=mollify, **chosen)
        assert np.abs(actual - expected).max() <= 1e-12 * size + 2 * rounding
        assert np.abs(actual - vertices).max() > 1e-3 * size  # it did something


def test_one_sweep_worked_by_hand():
    # Ring heights 1, 1, 1, 5 about an upright normal: mean 2, sigma = 2 * (1+1+1+3)/4 = 3,
    # g = e^(-1/18) three times and e^(-25/18), d = sum(g h) / sum(g).
    vertices, faces = fan([1.0, 1.0, 1.0, 5.0])
    ready = prepare_mesh(vertices, faces)
    links = ready.mesh.topology
    up = np.tile([0.0, 0.0, 1.0], (5, 1))
    free = np.ones(5, dtype=bool)
    step = AnisotropicLaplacian(up, links.ring_start, links.ring, free, 1.0)(ready.mesh.vertices)
    near, far = np.exp(-1 / 18), np.exp(-25 / 18)
    assert step.sigma[0] == pytest.approx(3.0, rel=1e-15)
    assert step.move[0] == pytest.approx((3 * near + 5 * far) / (3 * near + far), rel=1e-14)


def test_sigma_zero_is_the_plain_mean():
    # All heights equal: eq. (5) is 0/0 only in a careless exponential.
    vertices, faces = fan([0.3] * 6)
    out = run("al", vertices, faces, iterations=1, mollify=0)
    assert out[0] == pytest.approx([0.0, 0.0, 0.3], abs=1e-15)


def test_tiny_sigma_does_not_underflow():
    # Heights far from zero and almost equal: exp(-h^2 / 2 sigma^2) is zero for every neighbour.
    vertices, faces = fan(np.array([1.0, 1.0 + 1e-7, 1.0, 1.0 - 1e-7, 1.0, 1.0]))
    out = run("al", vertices, faces, iterations=1, mollify=0)
    assert np.isfinite(out).all()
    assert out[0, 2] == pytest.approx(1.0, abs=1e-6)


def test_zero_area_faces_have_no_normal():
    # A face with three different but collinear corners must not bend its neighbours' normals.
    vertices, faces = grid(4, 4)
    vertices = np.concatenate([vertices, [[0.5, 0.0, 0.0]]])
    faces = np.concatenate([faces, [[0, 16, 1]]]).astype(np.int32)
    ready = prepare_mesh(vertices, faces)
    assert ready.defects.degenerate_faces == 1
    normals = ready.mesh.vertex_normals()
    assert np.allclose(normals[:16], [0, 0, 1], atol=0)
    assert (normals[16] == 0).all()
    assert (run("al", vertices, faces) == vertices).all()


def test_opposed_normals_leave_the_vertex_in_place():
    # Two flat squares folded onto each other share an edge: their normals cancel along it, with
    # both weightings, and no direction is better than another.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.0, 1, 0], [1, 1, 0], [0.5, 1, 0]], dtype=float)
    faces = np.array([[0, 1, 2], [1, 0, 4]], dtype=np.int32)
    ready = prepare_mesh(vertices, faces)
    normals = ready.mesh.vertex_normals()
    assert (normals[:2] == 0).all()
    assert (run("al", vertices, faces, mollify=0)[:2] == vertices[:2]).all()


def test_normals_stay_those_of_the_input():
    # After many sweeps every vertex is still on the line through its start along its normal.
    vertices, faces = torus()
    vertices = noisy(vertices, 11, 0.2)
    ready = prepare_mesh(vertices, faces)
    normals = ready.mesh.vertex_normals("uniform", 1)
    for name in ("al", "msal"):
        out = denoise(name, ready.mesh, n=50)
        drift = np.cross(out - ready.mesh.vertices, normals)
        assert np.abs(drift).max() <= 2 * np.finfo(float).eps * np.abs(ready.mesh.vertices).max()


def test_rotation_and_scale_change_nothing_else():
    vertices, faces = torus()
    vertices = noisy(vertices, 13, 0.15)
    turn, _ = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))
    for name in ("al", "msal"):
        plain = run(name, vertices, faces)
        assert np.allclose(run(name, 1000 * vertices @ turn, faces), 1000 * plain @ turn, atol=1e-9)


def test_multiscale_over_al_is_msal():
    vertices, faces = torus()
    vertices = noisy(vertices, 14, 0.1)
    composed = run("al", vertices, faces, schedule="multiscale", K=0.3)
    assert (composed == run("msal", vertices, faces, K=0.3)).all()


def test_constant_fidelity_worked_by_hand():
    # One vertex with heights 0.3: d = 0.3, then x <- x + d - 0.25 t with t the offset so far.
    vertices, faces = fan([0.3] * 6)
    given = {"schedule": "constant", "fidelity": 0.25, "mollify": 0, "boundary": "fixed"}
    first = run("al", vertices, faces, n=1, **given)
    second = run("al", vertices, faces, n=2, **given)
    assert first[0, 2] == pytest.approx(0.3)
    assert second[0, 2] == pytest.approx(0.3 + 0.0 - 0.25 * 0.3)
