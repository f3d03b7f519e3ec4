"""Vertices fitted to normals, and evened out where their faces are strained."""

from __future__ import annotations

import numpy as np

from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.vertex_update import untangle, update_vertices
from msal_cli.mesh import prepare_mesh
from tests.shapes import grid


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
