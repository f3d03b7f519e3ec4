"""L0 minimisation: what it must leave alone, a literal twin, and measured figures."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.kernels.faces import dihedral_angles, flaps
from msal_cli.mesh import prepare_mesh
from msal_cli.methods import l0
from tests.methods.runs import denoise, error_deg, free_vertices, small_scan
from tests.shapes import box, noisy

denoised = functools.partial(denoise, "l0")


def twin(mesh, iterations, sparsity, regularity, free):
    """The method with dense matrices, and coefficients as the paper prints them."""
    n = len(mesh.vertices)
    corners = flaps(mesh.faces, mesh.topology)
    edge = mesh.mean_edge_length
    p = mesh.vertices.copy()

    def normals(e):
        p1, p2, p3, p4 = mesh.vertices[corners[e]]
        first, second = np.cross(p2 - p1, p3 - p1), np.cross(p3 - p1, p4 - p1)
        return first / np.linalg.norm(first), second / np.linalg.norm(second)

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
        ("torus", "free", {"iterations": 10}),
        ("torus", "free", {"iterations": 7, "sparsity": 1.0, "regularity": 2.0}),
        ("grid", "free", {"iterations": 10}),
        ("grid", "fixed", {"iterations": 10, "regularity": 0.0}),
    ],
)
def test_it_agrees_with_the_literal_twin(monkeypatch, shape, boundary, given):
    monkeypatch.setattr(l0, "TOLERANCE", 1e-14)
    monkeypatch.setattr(l0, "MAX_ITERATIONS", 5000)
    mesh = small_scan(shape)
    values = methods.find("l0").validate(given)
    steps = (values[name] for name in ("iterations", "sparsity", "regularity"))
    expected = twin(mesh, *steps, free_vertices(mesh, boundary))
    found = denoised(mesh, boundary=boundary, **given)
    assert np.abs(found - expected).max() < 1e-11 * np.ptp(mesh.vertices)
    assert np.abs(found - mesh.vertices).max() > 0.02
    # As fast as it is run by users it ends close by.
    monkeypatch.undo()
    quick = denoised(mesh, boundary=boundary, **given)
    assert np.abs(quick - expected).max() < 1e-2 * mesh.mean_edge_length


def test_a_noisy_box_becomes_flat_faces_and_sharp_edges():
    clean = prepare_mesh(*box(10, 10, 10)).mesh
    rough = clean.with_vertices(noisy(clean.vertices, 1, 0.1 * clean.mean_edge_length))
    out = rough.with_vertices(denoised(rough))
    corners = flaps(clean.faces, clean.topology)
    true, found, noise = (
        np.degrees(dihedral_angles(mesh.vertices, corners)) for mesh in (clean, out, rough)
    )
    assert ((true < 1e-6) | (np.abs(true - 90) < 1e-6)).all()
    assert np.median(noise[true < 45]) > 5
    assert (found[true < 45] < 1.0).mean() > 0.99
    assert (np.abs(found[true > 45] - 90) < 3.0).mean() > 0.9
    assert error_deg(clean, out.vertices) < 0.8
