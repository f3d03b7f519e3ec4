"""Strained faces are evened out, and nothing else moves."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels import parallel
from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.vertex_update import untangle
from msal_cli.mesh import prepared
from tests.shapes import grid, noisy, torus


def run(mesh, positions, wanted, free=None):
    everywhere = np.ones(len(positions), dtype=bool)
    return untangle(positions, wanted, mesh.faces, mesh.links, everywhere if free is None else free)


def angles_deg(mesh, positions, wanted):
    cosines = np.einsum("ij,ij->i", face_normals(positions, mesh.faces), wanted)
    return np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def folded():
    """A flat sheet of which single vertices lie beyond their neighbours, and its true normals."""
    mesh = prepared(*grid(13, 13)).mesh
    wanted = face_normals(mesh.vertices, mesh.faces)
    inner = np.flatnonzero(~mesh.links.boundary)
    strayed = inner[::17]
    positions = mesh.vertices.copy()
    positions[strayed] += 1.3 * mesh.mean_edge_length * np.array([1.0, 0.4, 0.0])
    return mesh, positions, wanted, strayed


def test_folds_are_opened():
    mesh, positions, wanted, strayed = folded()
    assert angles_deg(mesh, positions, wanted).max() > 170
    out = run(mesh, positions, wanted)
    assert angles_deg(mesh, out, wanted).max() < 1e-6
    # Far from them nothing moves, and nothing leaves the plane.
    touched = np.isin(mesh.faces, strayed).any(axis=1)
    rim = np.unique(mesh.faces[touched])
    second = np.unique(mesh.faces[np.isin(mesh.faces, rim).any(axis=1)])
    others = np.setdiff1d(np.arange(len(positions)), second)
    assert len(others) > 20
    assert (out[others] == positions[others]).all()
    assert np.abs(out[:, 2] - mesh.vertices[:, 2]).max() == 0.0


def test_what_fits_keeps_its_bits():
    vertices, faces = torus(30, 14)
    mesh = prepared(noisy(vertices, 1, 0.02), faces).mesh
    wanted = face_normals(mesh.vertices, mesh.faces)
    assert (run(mesh, mesh.vertices, wanted) == mesh.vertices).all()
    # Normals that are not known ask for nothing.
    assert (run(mesh, mesh.vertices, np.zeros_like(wanted)) == mesh.vertices).all()


def test_normals_are_met_better_on_a_surface():
    vertices, faces = torus(60, 30)
    mesh = prepared(vertices, faces).mesh
    wanted = face_normals(mesh.vertices, mesh.faces)
    amount = 0.35 * mesh.mean_edge_length
    scanned = mesh.vertices + amount * np.random.default_rng(0).normal(size=vertices.shape)
    before = angles_deg(mesh, scanned, wanted)
    after = angles_deg(mesh, run(mesh, scanned, wanted), wanted)
    assert after.mean() < 0.3 * before.mean()


def test_what_must_stay_stays():
    mesh, positions, wanted, strayed = folded()
    free = np.ones(len(positions), dtype=bool)
    free[strayed] = False
    assert (run(mesh, positions, wanted, free)[strayed] == positions[strayed]).all()


@pytest.mark.parametrize("count", ["2", "3"])
def test_threads_do_not_change_a_bit(count, monkeypatch):
    mesh, positions, wanted, _ = folded()
    alone = run(mesh, positions, wanted)
    monkeypatch.setattr(parallel, "SMALLEST_RANGE", 31)
    monkeypatch.setenv("MSAL_THREADS", count)
    assert (run(mesh, positions, wanted) == alone).all()
