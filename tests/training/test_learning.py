"""What the learned filter is trained on, and how."""

import numpy as np
import pytest

pytest.importorskip("manifold3d")
pytest.importorskip("skimage")
pytest.importorskip("fast_simplification")
pytest.importorskip("fcpw")

from msal_cli.kernels.normal_descriptors import NUMBERS, WIDE_FILTERED
from msal_cli.kernels.normal_regression import GLOBALS, STATISTICS, count_vectors
from msal_cli.mesh import prepare_mesh
from tests.shapes import torus
from training import regression
from training.samples import carve, collect_samples, draw_meshes
from training.scans import SHARES, draw_scan

SHAPES = [("torus", *torus(40, 20)), ("thin", *torus(40, 16, 3.0, 0.5))]


def draw(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def samples():
    meshes = draw_meshes(SHAPES, 3, draw())
    return meshes, collect_samples(meshes, 400, draw(1))


@pytest.mark.parametrize("scanner", SHARES)
def test_scans_know_their_true_normals(scanner, monkeypatch):
    monkeypatch.setattr("training.scans.SHARES", {scanner: 1.0})
    mesh = prepare_mesh(*torus(60, 30)).mesh
    vertices, faces, true_vertices, truth = draw_scan(mesh, draw(3))
    assert vertices.shape == true_vertices.shape
    assert truth.shape == faces.shape
    has_truth = truth.any(axis=1)
    assert has_truth.mean() > 0.8
    # The normals of a torus point away from its middle circle, of radius 3.
    centres = true_vertices[faces[has_truth]].mean(axis=1)
    around = centres * [1, 1, 0]
    away = centres - 3.0 * around / np.linalg.norm(around, axis=1)[:, None]
    away /= np.linalg.norm(away, axis=1)[:, None]
    assert np.median(np.einsum("ij,ij->i", truth[has_truth], away)) > 0.97


@pytest.mark.ci
def test_samples_have_targets_along_the_axes_of_their_inputs(samples):
    meshes, (inputs, targets, weights, n_vectors) = samples
    assert inputs.shape[1] == 3 * count_vectors(0) + NUMBERS + STATISTICS + GLOBALS
    assert n_vectors == count_vectors(0)
    assert len(inputs) == len(targets) == len(weights)
    assert np.abs(np.linalg.norm(targets, axis=1) - 1).max() < 1e-5
    assert weights.mean() == pytest.approx(1.0, abs=1e-5)
    filtered = inputs[:, 3 * WIDE_FILTERED : 3 * WIDE_FILTERED + 3]
    assert np.median(np.einsum("ij,ij->i", filtered, targets)) > 0.9
    assert len({mesh.weight for mesh in meshes}) > 1


def test_gradients_are_those_of_the_loss():
    generator = draw(2)
    inputs = generator.standard_normal((5, 9 + 4)).astype(np.float64)
    targets = generator.standard_normal((5, 3))
    targets /= np.linalg.norm(targets, axis=1)[:, None]
    weights = generator.uniform(0.5, 2.0, 5)
    matrices = [generator.standard_normal(size) for size in ((13, 6), (6, 6), (6, 3))]
    biases = [generator.standard_normal(n) for n in (6, 6, 3)]
    vectors = inputs[:, :9].reshape(5, 3, 3)

    def loss():
        values = regression._forward(inputs, matrices, biases)
        return values, *regression._loss(values[-1], vectors, targets, weights, 0.01)

    values, before, gradient = loss()
    gradients = regression._backward(values, matrices, gradient)
    for parameter, slope in zip(matrices + biases, gradients, strict=True):
        for place in [(0,) * parameter.ndim, (-1,) * parameter.ndim]:
            parameter[place] += 1e-6
            assert (loss()[1] - before) / 1e-6 == pytest.approx(slope[place], rel=1e-3, abs=1e-5)
            parameter[place] -= 1e-6


@pytest.mark.ci
def test_training_lowers_the_error_and_repeats_bit_for_bit(samples, monkeypatch):
    meshes, (inputs, targets, weights, n_vectors) = samples
    monkeypatch.setattr(regression, "BATCH", 128)

    def train():
        losses = []
        network = regression.train_network(
            inputs,
            targets,
            weights,
            n_vectors,
            16,
            WIDE_FILTERED,
            seed=1,
            schedule=regression.Schedule(epochs=12),
            report=lambda text: losses.append(float(text.split()[-1])),
        )
        return network, losses

    network, losses = train()
    assert losses[-1] < 0.9 * losses[0]
    for layer, same in zip(network.layers, train()[0].layers, strict=True):
        assert (layer[0] == same[0]).all()
        assert (layer[1] == same[1]).all()
    # What was trained on standardised inputs is what the kernel gives for raw ones.
    before = np.mean([mesh.mean_angle(mesh.scanned) for mesh in meshes])
    for mesh in meshes:
        mesh.advance(network)
    assert np.mean([mesh.mean_angle(mesh.earlier) for mesh in meshes]) < before


def test_relief_leaves_a_mesh_with_three_faces_on_an_edge():
    vertices, faces = torus()
    corners = np.append(faces[0, :2], len(vertices))
    vertices = np.vstack([vertices, [[0.0, 0.0, 9.0]]])
    faces = np.vstack([faces, corners[None]]).astype(np.int32)
    carved = carve(vertices, faces, np.random.default_rng(1))
    assert carved[0] is vertices and carved[1] is faces
