"""The maker of giant meshes: closed, and the same surface in every order."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import giant_mesh
from msal_cli import codecs
from msal_cli.mesh import prepare_mesh


def read(path):
    return codecs.open_mesh(path.read_bytes(), path.name)


@pytest.mark.parametrize("order", giant_mesh.ORDERS)
def test_the_surface_is_the_same_in_every_order(order, tmp_path, monkeypatch):
    monkeypatch.setattr(giant_mesh, "_AT_ONCE", 1000)
    monkeypatch.setattr(giant_mesh, "_BLOCK", 256)
    path = tmp_path / "giant.ply"
    giant_mesh.main([str(path), "--millions", "0.0048", "--order", order])
    rows = giant_mesh.GiantMesh(40)
    mesh = read(path)
    n = rows.n_vertices
    expected = rows.positions(np.arange(n))
    assert len(mesh.vertices) == n == 4800
    ready = prepare_mesh(mesh.vertices, mesh.faces)
    assert ready.defects.boundary_edges == ready.defects.inconsistent_edges == 0
    assert ready.defects.components == 1 and ready.defects.duplicate_faces == 0
    assert (np.unique(mesh.vertices, axis=0) == np.unique(expected, axis=0)).all()
    triangles = mesh.vertices[mesh.faces].reshape(-1, 9)
    same = expected[rows.corners(np.arange(2 * n))].reshape(-1, 9)
    assert (np.unique(triangles, axis=0) == np.unique(same, axis=0)).all()
    if order == "rows":
        assert (mesh.vertices == expected).all()
    else:
        assert not (mesh.vertices == expected).all()
