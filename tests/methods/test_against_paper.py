"""AL and MSAL against the literal transcription of the paper, and the variants of AL."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import ground_truth
from msal_cli.kernels.operators import DEVIATIONS, SCALINGS, WEIGHTS, AnisotropicLaplacian
from msal_cli.mesh import prepare_mesh
from tests import paper
from tests.methods.runs import SHAPES, denoise, errors, opened
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


def test_the_flattest_neighbours_count_where_sigma_is_tiny():
    # exp(-h^2 / (2 sigma^2)) is 1e-7000 and less; the quotient of eq. (5) is that of the others.
    mesh = prepare_mesh(*fan([1.0] * 5 + [1.01])).mesh
    up, free = np.tile([0.0, 0.0, 1.0], (7, 1)), np.ones(7, dtype=bool)
    step = AnisotropicLaplacian(up, *mesh.topology.one_ring, free, 1.0)(mesh.vertices)
    assert step.move[0] == pytest.approx(1.0, abs=1e-9)


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


SAMPLES = Path(__file__).resolve().parents[2] / "sample_meshes"
BEAR = opened(SAMPLES / "bear_noisy.obj", SAMPLES / "bear_clean.obj")


def weights_of(kind, h, sigma):
    """g(h) as Black et al. define it, scaled so that h g(h) is greatest at sigma."""
    if kind == "gauss":  # the largest made 1, which changes no quotient: sigma may be tiny
        return np.exp((np.min(h**2) - h**2) / (2 * sigma**2))
    if kind == "tukey":
        s = np.sqrt(5) * sigma
        return np.where(np.abs(h) < s, (1 - (h / s) ** 2) ** 2, 0.0)
    if kind == "lorentz":
        s = sigma / np.sqrt(2)
        return 1 / (1 + h**2 / (2 * s**2))
    if kind == "huber":
        return np.where(np.abs(h) <= sigma, 1.0, sigma / np.maximum(np.abs(h), 1e-300))
    return np.ones_like(h)


def twin(v, faces, iterations, kind, deviation, scaling, tau):
    """AL with the chosen weights, vertex by vertex; tau in squared units."""
    normals = paper.normal_field(v, faces, 1)
    rings = paper.one_rings(len(v), faces)
    x = v.copy()
    for _ in range(iterations):
        d = np.zeros(len(v))
        areas = np.zeros(len(v))
        for face in faces.tolist():
            a, b, c = x[face]
            areas[face] += np.linalg.norm(np.cross(b - a, c - a)) / 2
        for i, ring in enumerate(rings):
            e = x[ring] - x[i]
            h, length = e @ normals[i], np.linalg.norm(e, axis=1)
            if deviation == "mean":
                sigma = 2 * np.mean(np.abs(h - np.mean(h)))
            else:
                sigma = 1.4826 * np.median(np.abs(h - np.median(h)))
            g = weights_of(kind, h, sigma)
            if not g.any():  # all beyond Tukey's reach
                g = np.ones_like(h)
            if scaling == "none":
                d[i] = (g * h).sum() / g.sum()
            elif scaling == "mass":
                limit = areas[i] / 3
                d[i] = min(tau, limit) * (g * h).sum() / g.sum() / (areas[i] / 3)
            else:
                limit = (g * length).sum() / (g / length).sum()
                d[i] = min(tau, limit) * (g * h / length).sum() / (g * length).sum()
        x = x + d[:, None] * normals
    return x


@pytest.mark.parametrize("scaling", SCALINGS)
@pytest.mark.parametrize("deviation", DEVIATIONS)
@pytest.mark.parametrize("kind", WEIGHTS)
def test_every_combination_agrees_with_the_plain_twin(kind, deviation, scaling):
    vertices, faces = SHAPES["torus"]
    mesh = prepare_mesh(vertices, faces).mesh
    given = {"weights": kind, "deviation": deviation, "scaling": scaling}
    out = denoise("al", mesh, iterations=2, **given)
    tau = 0.25 * mesh.mean_edge_length**2
    expected = twin(mesh.vertices, faces, 2, kind, deviation, scaling, tau)
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(vertices)
    assert np.abs(out - mesh.vertices).max() > 1e-2


@pytest.mark.parametrize("kind", WEIGHTS)
@pytest.mark.parametrize("deviation", DEVIATIONS)
@pytest.mark.parametrize("scaling", SCALINGS)
def test_equal_heights_give_their_mean_and_nothing_underflows(kind, deviation, scaling):
    for heights in ([0.3] * 6, [0.3, 0.3, 0.3 + 1e-9, 0.3, 0.3, 0.3 - 1e-9]):
        mesh = prepare_mesh(*fan(heights)).mesh
        given = {"weights": kind, "deviation": deviation, "scaling": scaling, "scaled_step": 100}
        out = denoise("al", mesh, iterations=1, mollify=0, **given)
        assert np.isfinite(out).all()
        assert out[0, 2] - mesh.vertices[0, 2] == pytest.approx(0.3, abs=1e-6)


@pytest.mark.parametrize("scaling", ["mass", "edge"])
def test_no_scaled_step_overshoots(scaling):
    # On triangles of very different sizes even half a squared mean edge is too long a step for
    # most vertices; without the limit of each, the sweeps would make noise.
    noisy_bear, clean = BEAR
    before, _ = errors(noisy_bear, clean, "al", n=0)
    for c in (0.25, 100.0):
        after, _ = errors(noisy_bear, clean, "al", n=8, scaling=scaling, scaled_step=c)
        assert after < 0.4 * before


@pytest.mark.parametrize(
    ("deviation", "expected"),
    [("mean", [9.74, 9.30, 8.13, 8.40, 8.43]), ("median", [9.74, 7.33, 5.55, 5.28, 5.64])],
)
def test_weights_keep_edges_under_weak_noise(real_data, deviation, expected):
    # Fandisk with normal noise of a tenth of the mean edge: degrees after three sweeps.
    clean = ground_truth.opened(real_data / "clean" / "fandisk.obj")
    rng = np.random.default_rng(0)
    along = rng.normal(0, 0.1 * clean.mean_edge_length, (len(clean.vertices), 1))
    rough = clean.with_vertices(clean.vertices + along * clean.vertex_normals())
    found = [
        errors(rough, clean, "al", n=3, weights=kind, deviation=deviation)[0]
        for kind in ("none", "huber", "lorentz", "gauss", "tukey")
    ]
    assert found == pytest.approx(expected, rel=0.015)
    assert found[0] > found[1] > max(found[2:])
