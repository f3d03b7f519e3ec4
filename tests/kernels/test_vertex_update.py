"""Sun's vertex update: identities, a hand-worked pass, and a plain twin."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.geometry import face_normals
from msal_cli.kernels.vertex_update import updated_vertices
from msal_cli.mesh import prepared
from tests.kernels.plain_faces import rim, unit, updated
from tests.shapes import fan, grid, noisy, torus


def run(vertices, normals, faces, passes=1, fixed=(), on_pass=None):
    mesh = prepared(vertices, faces).mesh
    free = np.ones(len(vertices), dtype=bool)
    free[list(fixed)] = False
    return updated_vertices(vertices, normals, mesh.faces, mesh.links, free, passes, on_pass)


def test_one_pass_worked_by_hand():
    # A vertex 0.6 above a flat ring: the centroids lie at 0.2, the planes want to be level, so it
    # goes down by 0.4; a rim vertex, with two faces, goes up to 0.2.
    vertices, faces = fan([0.0] * 6)
    vertices[0, 2] = 0.6
    up = np.tile([0.0, 0.0, 1.0], (6, 1))
    out = run(vertices, up, faces)
    assert np.allclose(out[:, 2], 0.2, rtol=0, atol=1e-15)
    assert (out[:, :2] == vertices[:, :2]).all()


def test_normals_that_the_faces_have_move_nothing():
    vertices, faces = torus()
    vertices = noisy(vertices, 1, 0.2)
    out = run(vertices, face_normals(vertices, faces), faces, passes=20)
    assert np.abs(out - vertices).max() < 1e-13


def test_a_level_sheet_keeps_every_bit():
    vertices, faces = grid(7, 6)
    vertices[:, 2] = 0.1  # not a binary fraction: a third of three of them need not be one of them
    up = np.tile([0.0, 0.0, 1.0], (len(faces), 1))
    assert (run(vertices, up, faces, passes=10) == vertices).all()


@pytest.mark.parametrize("shape", [torus(9, 6), grid(6, 5), fan([0.2] * 7)])
def test_it_is_the_formula(shape):
    vertices, faces = shape
    vertices = noisy(vertices, 2, 0.1)
    wanted = unit(face_normals(noisy(vertices, 3, 0.2), faces))
    wanted[::4] = 0.0
    fixed = rim(faces)
    before = vertices.copy()
    out = run(vertices, wanted, faces, passes=5, fixed=fixed)
    expected = updated(vertices, wanted, faces, 5, fixed)
    assert np.abs(out - expected).max() <= 1e-12 * np.ptp(vertices)
    assert (vertices == before).all()


def test_faces_without_a_normal_have_no_say():
    vertices, faces = fan([0.0] * 6)
    vertices[0, 2] = 0.6
    normals = np.zeros((6, 3))
    assert (run(vertices, normals, faces, passes=3) == vertices).all()
    normals[0] = [0.0, 0.0, 1.0]
    out = run(vertices, normals, faces)
    assert out[0, 2] == pytest.approx(0.2)  # its whole way to the one plane that counts
    assert (out[3:6] == vertices[3:6]).all()


def test_fixed_vertices_stay():
    vertices, faces = torus()
    wanted = face_normals(noisy(vertices, 4, 0.3), faces)
    out = run(vertices, wanted, faces, passes=4, fixed=[5, 17])
    assert sorted(np.flatnonzero((out == vertices).all(axis=1))) == [5, 17]


def test_faces_come_nearer_to_their_normals():
    vertices, faces = torus(40, 20)
    wanted = face_normals(vertices, faces)
    rough = noisy(vertices, 5, 0.02)
    out = run(rough, wanted, faces, passes=50)

    def misfit(x):
        return 1.0 - (face_normals(x, faces) * wanted).sum(axis=1).mean()

    assert misfit(out) < 0.05 * misfit(rough)


def test_every_pass_is_told_and_can_end_the_run():
    vertices, faces = torus()
    wanted = face_normals(noisy(vertices, 6, 0.1), faces)
    told = []
    run(vertices, wanted, faces, passes=3, on_pass=lambda: told.append(1))
    assert len(told) == 3

    def stop():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(vertices, wanted, faces, passes=3, on_pass=stop)


def test_threads_do_not_change_a_bit(monkeypatch):
    vertices, faces = torus(60, 30)
    wanted = face_normals(noisy(vertices, 7, 0.1), faces)
    monkeypatch.setattr("msal_cli.kernels.parallel.SMALLEST_RANGE", 100)
    results = []
    for count in ("1", "2", "5"):
        monkeypatch.setenv("MSAL_THREADS", count)
        results.append(run(vertices, wanted, faces, passes=5))
    assert (results[0] == results[1]).all()
    assert (results[0] == results[2]).all()
