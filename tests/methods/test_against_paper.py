"""The fast kernels against the literal transcription, and against hand-worked cases."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.mesh import prepare_mesh
from tests import paper
from tests.methods.runs import SHAPES
from tests.methods.runs import run_in_file as run
from tests.shapes import fan, grid, noisy, torus

ALL_SHAPES = SHAPES | {
    "far away": (SHAPES["torus"][0] + [4.65e6, 1.2e6, 300.0], SHAPES["torus"][1])
}


@pytest.mark.parametrize("shape", ALL_SHAPES)
@pytest.mark.parametrize("mollify", [0, 2])
@pytest.mark.parametrize("iterations", [3])
def test_kernels_agree_with_the_paper(shape, mollify, iterations):
    vertices, faces = ALL_SHAPES[shape]
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    size = np.ptp(vertices, axis=0).max()
    rounding = np.abs(vertices).max() * np.finfo(float).eps
    for name, K, chosen in [("al", None, {}), ("msal", 0.5, {"K": 0.5}), ("msal", 0.2, {"K": 0.2})]:
        expected = paper.algorithm_1(vertices - centre, faces, iterations, K, mollify) + centre
        actual = run(name, vertices, faces, iterations=iterations, mollify=mollify, **chosen)
        assert np.abs(actual - expected).max() <= 1e-12 * size + 2 * rounding
        assert np.abs(actual - vertices).max() > 1e-3 * size  # it did something


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
