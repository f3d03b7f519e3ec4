"""Vertices held against their surroundings: hand-worked cases on planes and cones."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels import outliers
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid

MIDDLE = 5 * 10 + 5


def uneven_grid(seed=0):
    """A flat grid of 10 by 10 vertices with uneven spacing."""
    vertices, faces = grid(10, 10)
    vertices[:, :2] += np.random.default_rng(seed).uniform(-0.15, 0.15, (len(vertices), 2))
    return prepare_mesh(vertices, faces).mesh


def agreements_of(mesh):
    found = np.ones(len(mesh.vertices))
    everything = np.ones(len(found), dtype=bool)
    outliers.measure_agreement(mesh.vertices, mesh.faces, mesh.topology, everything, found)
    return found


def judged(mesh, *chosen, is_known=False):
    chosen = np.array(chosen)
    return outliers.judge(
        chosen,
        mesh.vertices[chosen],
        mesh.vertices,
        mesh.faces,
        mesh.topology,
        agreements_of(mesh),
        mesh.mean_edge_length,
        is_known,
    )


def spiked(mesh, at, way):
    vertices = mesh.vertices.copy()
    vertices[at] += way
    return mesh.with_vertices(vertices)


def test_a_spike_goes_back_to_where_it_was():
    mesh = uneven_grid()
    scores, targets = judged(spiked(mesh, MIDDLE, (0.0, 0.0, 2.0)), MIDDLE)
    assert scores[0] > 2.0
    assert targets[0] == pytest.approx(mesh.vertices[MIDDLE], abs=1e-9)


def test_only_the_furthest_of_neighbours_is_picked():
    mesh = uneven_grid()
    scores = np.full(100, outliers.NOT_JUDGED)
    scores[[MIDDLE, MIDDLE + 1, MIDDLE + 11]] = 2.0, 3.0, 2.5
    assert outliers.pick(scores, 1.0, mesh.topology).tolist() == [MIDDLE + 1]
    scores[[MIDDLE, MIDDLE + 1]] = 3.0
    # Of two alike the one with the lower number.
    assert outliers.pick(scores, 2.6, mesh.topology).tolist() == [MIDDLE]
    assert not len(outliers.pick(scores, 3.0, mesh.topology))


def test_a_vertex_that_went_along_the_surface_goes_to_the_middle_of_its_neighbours():
    mesh = uneven_grid()
    # Sides that are flat to rounding are those of a design.
    rises = 0.02 * np.random.default_rng(1).standard_normal((len(mesh.vertices), 1))
    mesh = mesh.with_vertices(mesh.vertices + rises * np.array([0.0, 0.0, 1.0]))
    folded = spiked(mesh, MIDDLE, (1.7, 0.4, 0.0))
    scores, targets = judged(folded, MIDDLE)
    assert scores[0] > 2.0
    # Those whose faces it folds over count less, until it is back.
    back = spiked(folded, MIDDLE, targets[0] - folded.vertices[MIDDLE])
    _, targets = judged(back, MIDDLE, is_known=True)
    ring = mesh.topology.ring[
        mesh.topology.ring_start[MIDDLE] : mesh.topology.ring_start[MIDDLE + 1]
    ]
    assert targets[0] == pytest.approx(mesh.vertices[ring].mean(axis=0), abs=0.1)
