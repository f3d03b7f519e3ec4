"""L0 minimisation: what it must leave alone, a literal twin, and measured figures."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import normal_statistics
from msal_cli.kernels.connectivity import connectivity
from msal_cli.kernels.faces import dihedral_angles, flaps
from msal_cli.mesh import prepare_mesh
from msal_cli.methods import l0
from tests.shapes import grid, noisy, torus

METHOD = methods.find("l0")


def denoised(mesh, **given):
    return METHOD.denoise(mesh, METHOD.validate(given)).vertices


def box(side=8):
    """The surface of a cube of edge 2, ``side`` squares along each edge, welded by ``prepared``."""
    square, triangles = grid(side + 1, side + 1)
    square = 2 * square / side - 1
    square[:, 2] = 1.0
    vertices, faces = [], []
    for turn in range(3):
        for sign in (1, -1):
            one = np.roll(square * [sign, 1, sign], turn, axis=1)
            faces.append(triangles + sum(map(len, vertices)))
            vertices.append(one)
    ready = prepare_mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32))
    return ready.mesh.vertices, ready.mesh.faces


def twin(mesh, iterations, sparsity, regularity, free):
    """The method with dense matrices, and coefficients as the paper prints them."""
    n = len(mesh.vertices)
    corners = flaps(mesh.faces, mesh.topology)
    edge = mesh.mean_edge_length
    p = mesh.vertices.copy()

    def normals(e):
        p1, p2, p3, p4 = mesh.vertices[corners[e]]
        one, two = np.cross(p2 - p1, p3 - p1), np.cross(p3 - p1, p4 - p1)
        return one / np.linalg.norm(one), two / np.linalg.norm(two)

    angles = [np.arccos(np.clip(np.dot(*normals(e)), -1, 1)) for e in range(len(corners))]
    gamma = np.mean(angles)
    price = sparsity * gamma * edge**2
    regular = np.zeros((len(corners), n))
    for e, flap in enumerate(corners):
        regular[e, flap] = [1, -1, 1, -1]
    for step in range(iterations):
        beta = 1e-3 * 1e6 ** (step / iterations)
        alpha = regularity * gamma * (1e-3 / beta) ** 2
        bends = np.zeros((len(corners), n))
        for e, flap in enumerate(corners):
            p1, p2, p3, p4 = p[flap]
            s123 = np.linalg.norm(np.cross(p2 - p1, p3 - p1))
            s134 = np.linalg.norm(np.cross(p3 - p1, p4 - p1))
            whole = ((p3 - p1) @ (p3 - p1)) * (s123 + s134)
            bends[e, flap] = [
                (s123 * (p4 - p3) @ (p3 - p1) + s134 * (p1 - p3) @ (p3 - p2)) / whole,
                s134 / (s123 + s134),
                (s123 * (p3 - p1) @ (p1 - p4) + s134 * (p2 - p1) @ (p1 - p3)) / whole,
                s123 / (s123 + s134),
            ]
        delta = bends @ p
        delta[(delta**2).sum(axis=1) < price / beta] = 0.0
        system = np.eye(n) + alpha * regular.T @ regular + beta * bends.T @ bends
        right = mesh.vertices + beta * bends.T @ delta - system[:, ~free] @ p[~free]
        p[free] = np.linalg.solve(system[np.ix_(free, free)], right[free])
    return p


@pytest.mark.parametrize(
    ("shape", "boundary", "given"),
    [
        ("torus", "free", {"iterations": 40}),
        ("torus", "free", {"iterations": 7, "sparsity": 1.0, "regularity": 2.0}),
        ("grid", "free", {"iterations": 20}),
        ("grid", "fixed", {"iterations": 20, "regularity": 0.0}),
    ],
)
def test_it_agrees_with_the_literal_twin(monkeypatch, shape, boundary, given):
    monkeypatch.setattr(l0, "TOLERANCE", 1e-14)
    monkeypatch.setattr(l0, "MAX_ITERATIONS", 5000)
    vertices, faces = torus(12, 8) if shape == "torus" else grid(9, 8)
    mesh = prepare_mesh(noisy(vertices, 3, 0.12), faces).mesh
    free = ~mesh.topology.boundary if boundary == "fixed" else np.ones(len(vertices), dtype=bool)
    settled = METHOD.validate(given)
    expected = twin(mesh, settled["iterations"], settled["sparsity"], settled["regularity"], free)
    found = denoised(mesh, boundary=boundary, **given)
    assert np.abs(found - expected).max() < 1e-11 * np.ptp(mesh.vertices)
    assert np.abs(found - mesh.vertices).max() > 0.02
    # As fast as it is run by users it ends close by.
    monkeypatch.undo()
    quick = denoised(mesh, boundary=boundary, **given)
    assert np.abs(quick - expected).max() < 1e-2 * mesh.mean_edge_length


def test_a_noisy_box_becomes_flat_faces_and_sharp_edges():
    vertices, faces = box(10)
    clean = prepare_mesh(vertices, faces).mesh
    rough = prepare_mesh(noisy(vertices, 1, 0.1 * clean.mean_edge_length), faces).mesh
    out = rough.with_vertices(denoised(rough))
    corners = flaps(faces, connectivity(len(vertices), faces))
    true, found, noise = (
        np.degrees(dihedral_angles(mesh.vertices, corners)) for mesh in (clean, out, rough)
    )
    assert ((true < 1e-6) | (np.abs(true - 90) < 1e-6)).all()
    assert np.median(noise[true < 45]) > 6
    assert (found[true < 45] < 1.0).mean() > 0.99
    assert (np.abs(found[true > 45] - 90) < 3.0).mean() > 0.9
    assert normal_statistics(clean, out).mean_angular_error_deg < 0.8


def test_a_price_of_nothing_changes_nothing():
    vertices, faces = torus()
    mesh = prepare_mesh(noisy(vertices, 2, 0.1), faces).mesh
    out = denoised(mesh, sparsity=0.0, regularity=0.0)
    assert np.abs(out - mesh.vertices).max() < 1e-3 * mesh.mean_edge_length


def test_a_higher_price_leaves_fewer_edges():
    vertices, faces = torus(40, 20)
    mesh = prepare_mesh(noisy(vertices, 3, 0.03), faces).mesh
    corners = flaps(mesh.faces, mesh.topology)
    bent, moved = [], []
    for sparsity in (0.002, 0.02, 0.2):
        out = denoised(mesh, sparsity=sparsity)
        bent.append((dihedral_angles(out, corners) > np.radians(1)).mean())
        moved.append(np.abs(out - mesh.vertices).mean())
    assert bent[0] > bent[1] + 0.05 > bent[2] + 0.1
    assert moved[0] < moved[1] < moved[2]


def test_a_long_solve_reports_and_can_be_ended():
    vertices, faces = torus()
    mesh = prepare_mesh(noisy(vertices, 8, 0.1), faces).mesh
    told = []
    METHOD.denoise(mesh, METHOD.validate({}), lambda *at: told.append(at))
    assert {done for done, _ in told} == set(range(41))
    assert told == sorted(told)
    assert len(told) > 200
