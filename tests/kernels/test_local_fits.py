"""What polynomials leave over, on surfaces that are polynomials, and of white noise."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.patch_fits import MOST_VERTICES, fit_patches
from msal_cli.mesh import prepared
from tests.shapes import fan, grid

PLANE, NEAR, FAR, CUBIC = range(4)


def graph_of(height, rows=14, columns=12, uneven=0.25, seed=0):
    """A mesh that is the graph of a function over an uneven grid."""
    vertices, faces = grid(rows, columns)
    vertices[:, :2] += np.random.default_rng(seed).uniform(-uneven, uneven, (len(vertices), 2))
    vertices[:, 2] = height(vertices[:, 0] / 10, vertices[:, 1] / 10)
    return prepared(vertices, faces).mesh


def fits_of(mesh, chosen=None):
    links = mesh.links
    up = np.zeros_like(mesh.vertices)
    up[:, 2] = 1.0
    chosen = np.arange(len(mesh.vertices)) if chosen is None else np.array(chosen)
    return fit_patches(chosen, mesh.vertices, up, links.ring_start, links.ring)


@pytest.mark.parametrize(
    ("height", "exact"),
    [
        (lambda x, y: 0.3 * x - y + 2, [PLANE, NEAR, FAR, CUBIC]),
        (lambda x, y: x * x - 2 * x * y + y, [NEAR, FAR, CUBIC]),
        (lambda x, y: x**3 - x * y * y + y, [CUBIC]),
    ],
)
def test_a_polynomial_leaves_nothing_over(height, exact):
    variances, freedoms, _, _ = fits_of(graph_of(height))
    for fit in range(4):
        largest = variances[:, fit].max()
        assert largest < 1e-14 if fit in exact else largest > 1e-8
    assert (freedoms[:, CUBIC] > 0).any()


def test_degrees_of_freedom():
    # Inside a grid with one diagonal: 6 neighbours, and 18 up to the second ring.
    _, freedoms, _, _ = fits_of(graph_of(lambda x, y: x * y), [5 * 12 + 5])
    assert freedoms.tolist() == [[7 - 3, 7 - 6, 19 - 6, 19 - 10]]


@pytest.mark.parametrize("uneven", [0.0, 0.35])
def test_white_noise_leaves_its_variance(uneven):
    draw = np.random.default_rng(3)
    mesh = graph_of(lambda x, y: 0.1 * draw.standard_normal(len(x)), 120, 100, uneven)
    variances, freedoms, gaps, ratios = fits_of(mesh)
    for fit in range(4):
        has = freedoms[:, fit] > 0
        mean = np.average(variances[has, fit], weights=freedoms[has, fit])
        assert mean == pytest.approx(0.01, rel=0.04)
    # Of Student's distribution: with 12 degrees of freedom 1 in 100 is beyond 3.055.
    inner = freedoms[:, FAR] == 13
    assert (ratios[inner] > 3.055).mean() == pytest.approx(0.01, abs=0.003)
    assert gaps[inner].std() > 0.1


def test_a_spike_is_told_by_how_far_it_stands_out():
    mesh = graph_of(lambda x, y: 0.0 * x)
    mesh.vertices[77, 2] += 0.4
    _, _, gaps, ratios = fits_of(mesh, [77, 76])
    assert gaps[0] == pytest.approx(0.4)
    # All of it is the spike's: nothing is left of the others.
    assert ratios[0] > 1e5
    assert ratios[1] < 3.0


def test_patches_that_tell_nothing():
    triangle = prepared(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]])).mesh
    variances, freedoms, gaps, ratios = fits_of(triangle)
    assert not variances.any() and not freedoms.any() and not gaps.any()
    assert (ratios == -1.0).all()


def test_a_long_needle_is_a_patch_with_fewer_columns():
    vertices, faces = grid(8, 6)
    vertices[:, 1] *= 1e-9
    vertices[:, 2] = 0.01 * np.sin(np.arange(len(vertices)))
    variances, _, _, _ = fits_of(prepared(vertices, faces).mesh)
    assert np.isfinite(variances).all()


def test_a_vertex_with_very_many_neighbours():
    vertices, faces = fan(0.01 * np.sin(np.arange(3 * MOST_VERTICES)))
    variances, freedoms, _, _ = fits_of(prepared(vertices, faces).mesh, [0])
    # On a circle around the vertex two of the cubic monomials are not their own.
    assert freedoms[0].tolist() == [MOST_VERTICES - k for k in (3, 6, 6, 8)]
    assert np.isfinite(variances).all()
