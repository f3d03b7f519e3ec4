"""Fujiwara's operator against its formula, hand-worked cases and its limit of stability."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.kernels.umbrellas import ScaleDependentUmbrella
from msal_cli.mesh import prepare_mesh
from tests.methods.plain_rings import rows, scale_dependent_umbrella
from tests.shapes import grid, noisy, torus

METHOD = methods.find("scale_dependent_umbrella")


def run(vertices, faces, **given):
    mesh = prepare_mesh(vertices, faces).mesh
    return mesh, METHOD.denoise(mesh, METHOD.validate(given)).vertices


def stretched(seed=3):
    """An open sheet whose edge lengths differ by a factor of about a hundred."""
    vertices, faces = grid(12, 12)
    vertices[:, :2] = 1.55 ** vertices[:, :2]
    rng = np.random.default_rng(seed)
    vertices[:, 2] = rng.normal(0, 0.1, len(vertices)) * vertices[:, :2].min(axis=1)
    return vertices, faces


def test_one_step_worked_by_hand():
    # Edges of length 1, 1 and 2 along +x, -x and +y: L = 2/4 (0, 1).
    x = np.array([[0.0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 2, 0]])
    start, ring = np.array([0, 3, 3, 3, 3], np.int32), np.array([1, 2, 3], np.int32)
    moves = ScaleDependentUmbrella(start, ring, 0.1)(x).move
    assert moves[0] == pytest.approx([0.0, 0.05, 0.0], abs=1e-16)
    assert (moves[1:] == 0.0).all()
    # The limit is 4 / (2 (1 + 1 + 1/2)) = 0.8: there it is at the mean with weights 1/l.
    moves = ScaleDependentUmbrella(start, ring, 7.0)(x).move
    assert moves[0] == pytest.approx([0.0, 0.4, 0.0], abs=1e-16)


def test_edges_without_length_are_left_out():
    x = np.array([[0.0, 0, 0], [0, 0, 0], [0, 3, 0]])
    both = ScaleDependentUmbrella(np.array([0, 2, 2, 2], np.int32), np.array([1, 2], np.int32), 9.0)
    assert both(x).move[0] == pytest.approx([0.0, 3.0, 0.0])
    only = ScaleDependentUmbrella(np.array([0, 1, 1, 1], np.int32), np.array([1], np.int32), 9.0)
    assert (only(x).move == 0.0).all()


@pytest.mark.parametrize("shape", ["torus", "stretched"])
@pytest.mark.parametrize("boundary", ["curve", "free", "fixed"])
@pytest.mark.parametrize("time_step", [0.05, 0.25, 50.0])
def test_it_agrees_with_the_plain_twin(shape, boundary, time_step):
    vertices, faces = (noisy(torus()[0], 1), torus()[1]) if shape == "torus" else stretched()
    mesh, out = run(vertices, faces, iterations=3, boundary=boundary, time_step=time_step)
    x = mesh.vertices
    ring = rows(len(x), faces, boundary)
    for _ in range(3):
        x = x + scale_dependent_umbrella(x, ring, time_step * mesh.mean_edge_length**2)
    assert np.abs(out - x).max() <= 1e-12 * np.ptp(mesh.vertices)
    assert np.abs(out - mesh.vertices).max() > 1e-3


def test_no_step_overshoots():
    # Without the limit of each vertex the default step would throw the small triangles about.
    vertices, faces = stretched()
    mesh, out = run(vertices, faces, iterations=200, time_step=100.0)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert (out >= low - 1e-9).all()
    assert (out <= high + 1e-9).all()
    x = mesh.vertices
    ring = rows(len(x), faces, "curve")
    for _ in range(8):
        move = np.zeros_like(x)
        for i, row in enumerate(ring):
            e = x[row] - x[i]
            length = np.linalg.norm(e, axis=1)
            move[i] = 2 / length.sum() * (e / length[:, None]).sum(axis=0)
        x = x + 0.25 * mesh.mean_edge_length**2 * move
    assert np.abs(x[:, 2]).max() > 5 * np.abs(mesh.vertices[:, 2]).max()
