"""Vertices held against their surroundings, and vertices fitted to normals."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels import outliers
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.vertex_update import untangle, update_vertices
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


def run(vertices, normals, faces, passes=1, fixed=(), on_pass=None):
    mesh = prepare_mesh(vertices, faces).mesh
    free = np.ones(len(vertices), dtype=bool)
    free[list(fixed)] = False
    return update_vertices(vertices, normals, mesh.faces, mesh.topology, free, passes, on_pass)


def test_a_level_sheet_keeps_every_bit():
    vertices, faces = grid(7, 6)
    vertices[:, 2] = 0.1  # not a binary fraction: a third of three of them need not be one of them
    up = np.tile([0.0, 0.0, 1.0], (len(faces), 1))
    assert (run(vertices, up, faces, passes=10) == vertices).all()


def untangled(mesh, positions, wanted, free=None):
    everywhere = np.ones(len(positions), dtype=bool)
    return untangle(
        positions, wanted, mesh.faces, mesh.topology, everywhere if free is None else free
    )


def angles_deg(mesh, positions, wanted):
    cosines = np.einsum("ij,ij->i", face_normals(positions, mesh.faces), wanted)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def folded():
    """A flat sheet of which single vertices lie beyond their neighbours, and its true normals."""
    mesh = prepare_mesh(*grid(13, 13)).mesh
    wanted = face_normals(mesh.vertices, mesh.faces)
    inner = np.flatnonzero(~mesh.topology.boundary)
    strayed = inner[::17]
    positions = mesh.vertices.copy()
    positions[strayed] += 1.3 * mesh.mean_edge_length * np.array([1.0, 0.4, 0.0])
    return mesh, positions, wanted, strayed


def test_folds_are_opened():
    mesh, positions, wanted, strayed = folded()
    assert angles_deg(mesh, positions, wanted).max() > 170
    out = untangled(mesh, positions, wanted)
    assert angles_deg(mesh, out, wanted).max() < 1e-6
    # Far from them nothing moves, and nothing leaves the plane.
    touched = np.isin(mesh.faces, strayed).any(axis=1)
    rim = np.unique(mesh.faces[touched])
    second = np.unique(mesh.faces[np.isin(mesh.faces, rim).any(axis=1)])
    others = np.setdiff1d(np.arange(len(positions)), second)
    assert len(others) > 20
    assert (out[others] == positions[others]).all()
    assert np.abs(out[:, 2] - mesh.vertices[:, 2]).max() == 0.0
