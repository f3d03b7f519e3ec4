"""What is more than noise in a residual: against the definition, and by its properties."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.restoration import NOISE_SHARES, restoration
from msal_cli.mesh import prepare_mesh
from tests.methods.plain_restoration import noise_shares, returned
from tests.paper import one_rings
from tests.shapes import grid, torus

SHAPES = {"closed": torus(), "open": grid(9, 8)}


def found(shape, residual, noise=1.0, caution=1.0):
    links = prepare_mesh(*SHAPES[shape]).mesh.topology
    return restoration(residual, links.ring_start, links.ring, noise, caution)


def white(shape, seed=0):
    return np.random.default_rng(seed).normal(size=len(SHAPES[shape][0]))


def test_the_shares_are_those_of_the_lattice():
    assert noise_shares(len(NOISE_SHARES)) == pytest.approx(NOISE_SHARES, rel=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(("noise", "caution"), [(1.0, 0.3), (0.5, 1.0), (0.0, 1.0), (0.3, 0.0)])
def test_it_is_what_the_definition_says(shape, noise, caution):
    vertices, faces = SHAPES[shape]
    residual = white(shape) + 2.0 * np.sin(vertices[:, 0])
    rings = one_rings(len(vertices), faces)
    expected = returned(residual, rings, noise, caution, len(NOISE_SHARES))
    actual = found(shape, residual, noise, caution)
    assert np.abs(actual.returned - expected).max() < 1e-12
    assert ((actual.share >= 0.0) & (actual.share <= 1.0)).all()
    assert np.abs(actual.returned).max() > 0.1


@pytest.mark.parametrize("shape", SHAPES)
def test_without_noise_all_comes_back_and_under_much_nothing(shape):
    residual = white(shape)
    everything, nothing = found(shape, residual, noise=0.0), found(shape, residual, noise=1e3)
    assert np.abs(everything.returned - residual).max() < 1e-14
    assert (everything.share == 1.0).all()
    assert not nothing.returned.any()
    assert not nothing.share.any()


def test_of_white_noise_little_comes_back_and_of_shape_nearly_all():
    vertices, faces = torus(96, 48)
    links = prepare_mesh(vertices, faces).mesh.topology
    noise = np.random.default_rng(1).normal(size=len(vertices))
    shape = 4.0 * np.sin(2.0 * vertices[:, 0])

    def back(residual):
        one = restoration(residual, links.ring_start, links.ring, 1.0)
        return one.returned

    assert (back(noise) ** 2).mean() < 0.02 * (noise**2).mean()
    assert ((back(shape) - shape) ** 2).mean() < 0.02 * (shape**2).mean()
    # Of both together the shape comes back, and most of the noise does not.
    assert ((back(noise + shape) - shape) ** 2).mean() < 0.2 * (noise**2).mean()


def test_what_did_not_move_gets_nothing():
    residual = white("closed")
    residual[::3] = 0.0
    assert not found("closed", residual, noise=0.0).returned[::3].any()


@pytest.mark.parametrize("factor", [1e-60, 1e60])
def test_it_is_free_of_scale(factor):
    residual = white("open")
    one, other = found("open", residual, 0.7), found("open", factor * residual, 0.7 * factor)
    assert other.returned / factor == pytest.approx(one.returned, rel=1e-12)
    assert other.share == pytest.approx(one.share, rel=1e-12)
