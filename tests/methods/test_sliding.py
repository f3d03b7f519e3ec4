"""Filters of normals whose sideways motion is undone."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.mesh import prepare_mesh
from msal_cli.methods._sliding import SIDEWAYS, sideways_share, undo_sliding
from tests.methods.runs import denoise, error_deg
from tests.shapes import grid, torus

SLIDING = [
    name
    for name in methods.names()
    if any(spec.name == "sliding" for spec in methods.find(name).parameters)
]


def scan():
    """A torus under noise along its normals, and the torus."""
    vertices, faces = torus(48, 24)
    normals = prepare_mesh(vertices, faces).mesh.vertex_normals()
    heights = 0.08 * np.random.default_rng(0).normal(size=len(vertices))
    ready = prepare_mesh(vertices + heights[:, None] * normals, faces)
    return ready.mesh, ready.mesh.with_vertices(vertices - ready.origin)


def test_what_slid_within_a_plane_comes_back_exactly():
    vertices, faces = grid(7, 6)
    mesh = prepare_mesh(vertices, faces).mesh
    slid = mesh.vertices.copy()
    slid[:, :2] += np.random.default_rng(0).uniform(-0.2, 0.2, (len(slid), 2))
    assert undo_sliding(mesh, slid, "kept", "free") is slid
    assert np.abs(undo_sliding(mesh, slid, "undone", "free") - mesh.vertices).max() < 1e-15


def test_heights_over_a_plane_stay():
    vertices, faces = grid(7, 6)
    mesh = prepare_mesh(vertices, faces).mesh
    raised = mesh.vertices + [0.1, -0.05, 0.3]
    back = undo_sliding(mesh, raised, "undone", "free")
    assert np.abs(back - mesh.vertices - [0.0, 0.0, 0.3]).max() < 1e-15


@pytest.mark.parametrize("name", SLIDING)
def test_it_comes_closer_where_the_noise_was_along_the_normals(name):
    mesh, true = scan()
    few = {"iterations": 3 if name != "l0" else 20}
    found = {sliding: denoise(name, mesh, sliding=sliding, **few) for sliding in ("kept", "undone")}
    by_itself = "undone" if name == "learned" else "kept"
    assert (found[by_itself] == denoise(name, mesh, **few)).all()
    kept, undone = (
        np.linalg.norm(found[way] - true.vertices, axis=1).mean() for way in ("kept", "undone")
    )
    assert undone < 0.97 * kept
    angles = {way: error_deg(true, positions) for way, positions in found.items()}
    assert angles["undone"] < 1.03 * angles["kept"]


@pytest.mark.parametrize("name", SLIDING)
def test_no_iterations_change_no_bit_and_what_is_held_stays(name):
    mesh, _ = scan()
    assert (denoise(name, mesh, iterations=0, sliding="undone") == mesh.vertices).all()
    held = np.arange(len(mesh.vertices)) % 3 == 0
    found = denoise(name, mesh.with_constraints(held, None), iterations=2, sliding="undone")
    assert np.abs(found[held] - mesh.vertices[held]).max() < 1e-14


def test_the_share_of_noise_within_the_surface():
    vertices, faces = torus(96, 48)
    normals = prepare_mesh(vertices, faces).mesh.vertex_normals()
    random = np.random.default_rng(0)
    heights = 0.04 * random.normal(size=len(vertices))[:, None] * normals
    ways = random.normal(size=vertices.shape)
    ways -= (ways * normals).sum(axis=1)[:, None] * normals
    for share in (0.0, 0.5, 1.0):
        mesh = prepare_mesh(vertices + heights + 0.04 * share * ways, faces).mesh
        # A torus has some of its own: its rings are uneven.
        assert sideways_share(mesh) == pytest.approx(share, rel=0.15, abs=0.15)
    assert 0.2 < SIDEWAYS < 0.8
    assert sideways_share(prepare_mesh(*grid(6, 6)).mesh) == np.inf
