"""The filter of Jones et al.: hand-worked, against a plain twin, and with published figures."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from tests import paper
from tests.methods.plain_normals import normals_and_areas
from tests.methods.runs import SHAPES, run_in_file
from tests.methods.test_bilateral import mean_edge
from tests.shapes import grid, noisy

run = functools.partial(run_in_file, "bilateral_non_iterative")


def flooded(i, x, faces, centroids, radius):
    """Faces within the radius of i that meet it, or a face found, at a vertex."""
    near = np.linalg.norm(centroids - x[i], axis=1) <= radius
    corners, found = {i}, set()
    while True:
        more = {
            f
            for f in np.flatnonzero(near).tolist()
            if f not in found and corners & set(faces[f].tolist())
        }
        if not more:
            return sorted(found)
        found |= more
        corners |= set(faces[sorted(more)].reshape(-1).tolist())


def gauss(t, width):
    return np.exp(-(t**2) / (2 * width**2))


def twin(v, faces, sigma_f, sigma_g):
    """One pass as the paper has it, vertex by vertex; widths in mean edge lengths."""
    unit = mean_edge(v, paper.one_rings(len(v), faces))
    sigma_f, sigma_g = sigma_f * unit, sigma_g * unit
    c = v[faces].mean(axis=1)
    _, area = normals_and_areas(v, faces)
    around = [flooded(i, v, faces, c, 2 * sigma_f) for i in range(len(v))]
    smooth = v.copy()
    for i, near in enumerate(around):
        if near:  # a limit that the paper leaves out
            w = area[near] * gauss(np.linalg.norm(c[near] - v[i], axis=1), sigma_f / 2)
            smooth[i] = (w[:, None] * c[near]).sum(axis=0) / w.sum()
    n, _ = normals_and_areas(smooth, faces)
    out = v.copy()
    for i, near in enumerate(around):
        if near:
            s = ((v[i] - c[near]) * n[near]).sum(axis=1)
            w = area[near] * gauss(np.linalg.norm(c[near] - v[i], axis=1), sigma_f)
            w *= gauss(s, sigma_g)
            out[i] = (w[:, None] * (v[i] - s[:, None] * n[near])).sum(axis=0) / w.sum()
    return out


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("widths", [(1.0, 1.0), (0.5, 0.2), (1.8, 0.7)])
def test_kernels_agree_with_the_paper(shape, widths):
    vertices, faces = SHAPES[shape]
    expected = twin(vertices, faces, *widths)
    actual = run(vertices, faces, closeness=widths[0], similarity=widths[1])
    size = np.ptp(vertices, axis=0).max()
    assert np.abs(actual - expected).max() <= 1e-12 * size
    assert np.abs(actual - vertices).max() > 1e-3 * size  # it did something


def test_a_vertex_far_from_every_centroid_stays():
    # A strip of small triangles with one very long one at its end.
    vertices, faces = grid(3, 12)
    vertices = noisy(vertices, 1, 0.1)
    vertices = np.concatenate([vertices, [[-30.0, 0.0, 5.0]]])
    faces = np.concatenate([faces, [[0, 12, 36]]]).astype(np.int32)
    out = run(vertices, faces)
    assert (out[36] == vertices[36]).all()
    assert (out[:36] != vertices[:36]).any(axis=1).all()


@pytest.mark.parametrize("width", [1e-300, 1e-12])
def test_tiny_widths_do_not_underflow(width):
    vertices, faces = SHAPES["torus"]
    assert (run(vertices, faces, closeness=width) == vertices).all()
    assert np.isfinite(run(vertices, faces, similarity=width)).all()


def test_triangles_that_nothing_touches_are_their_own_planes():
    # Each shrinks to a point when it is mollified, up to rounding: no direction may come of that.
    corners = np.random.default_rng(0).normal(size=(200, 3, 3))
    vertices = (corners + 50.0 * np.arange(200)[:, None, None]).reshape(-1, 3)
    out = run(vertices, np.arange(600, dtype=np.int32).reshape(-1, 3))
    assert np.abs(out - vertices).max() < 1e-9
