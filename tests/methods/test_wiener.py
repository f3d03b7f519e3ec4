"""The Wiener-filtered residual with the normals that follow it."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.analysis.measures import normal_statistics
from msal_cli.mesh import prepare_mesh
from tests.methods import plain_normals as plain
from tests.shapes import cube, grid, noisy, torus

WIENER = methods.find("wiener")


def run(mesh, name="wiener", **given):
    method = methods.find(name)
    return method.denoise(mesh, method.validate(given)).vertices


def scan(around=24, across=12, level=0.05):
    vertices, faces = torus(around, across)
    return prepare_mesh(noisy(vertices, 1, level), faces).mesh


def wavy():
    """A torus with waves, and the same under noise of a tenth of an edge length."""
    vertices, faces = torus(96, 48)
    normals = prepare_mesh(vertices, faces).mesh.vertex_normals()
    true = (
        vertices
        + (0.06 * np.sin(4 * vertices[:, 0]) * np.sin(4 * vertices[:, 1]))[:, None] * normals
    )
    heights = 0.02 * np.random.default_rng(0).normal(size=len(vertices))
    ready = prepare_mesh(true + heights[:, None] * normals, faces)
    return ready.mesh, ready.mesh.with_vertices(true - ready.origin)


def follows(mesh, guide, sigma_s, closeness, share, passes, vertex_passes):
    """Step 3, face by face, from its definition."""
    faces = mesh.faces
    like, areas = plain.normals_and_areas(guide, faces)
    c = guide[faces].mean(axis=1)
    width = closeness * plain.mean_distance(c, plain.sharing(faces, 2))
    scan_normals, _ = plain.normals_and_areas(mesh.vertices, faces)
    n = plain.unit(share * scan_normals + (1 - share) * like)
    for _ in range(passes):
        n = plain.joint(n, like, areas, c, plain.sharing(faces, 1), width, sigma_s)
    return plain.moved(guide, n, faces, np.ones(len(guide), bool), vertex_passes)


def test_without_the_normals_it_is_the_schedule_of_al():
    mesh = scan()
    for given in ({}, {"noise": 0.1}, {"mollify": 1, "n": 3, "boundary": "fixed"}):
        chosen = {"n": 6, "mollify": 2, "caution": 0.75} | given
        expected = run(mesh, "al", schedule="wiener", **chosen)
        assert (run(mesh, normal_iterations=0, **given) == expected).all()


@pytest.mark.parametrize("share", [1.0, 0.3])
@pytest.mark.parametrize("shape", [torus(9, 7), grid(6, 6), cube()])
def test_the_normals_follow_as_the_definition_says(shape, share):
    vertices, faces = shape
    mesh = prepare_mesh(noisy(vertices, 2, 0.1), faces).mesh
    guide = run(mesh, normal_iterations=0, noise=0.2)
    expected = follows(mesh, guide, 2.0 * 0.2, 1.5, share, 2, 3)
    actual = run(
        mesh,
        noise=0.2,
        similarity=2.0,
        closeness=1.5,
        scan_share=share,
        normal_iterations=2,
        vertex_iterations=3,
    )
    assert np.abs(actual - expected).max() < 1e-12 * np.ptp(vertices)
    assert np.abs(actual - guide).max() > 1e-3


def test_it_comes_closer_than_its_parts_in_positions_and_in_normals():
    mesh, true = wavy()

    def errors(name, **given):
        found = run(mesh, name, **given)
        angle = normal_statistics(true, mesh.with_vertices(found)).mean_angular_error_deg
        return np.array([np.linalg.norm(found - true.vertices, axis=1).mean(), angle])

    whole = errors("wiener")
    for name, given in (
        ("msal", {}),
        ("al", {"n": 2}),
        ("msal", {"schedule": "wiener"}),
    ):
        assert (whole < errors(name, **given)).all(), name
    assert (whole < 0.6 * errors("wiener", n=0)).all()


def test_it_has_no_data_term_that_trust_could_scale():
    assert not WIENER.has_data_term(WIENER.validate({}))
