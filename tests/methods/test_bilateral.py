"""The bilateral filters and that of Jones et al.: hand-worked, and against plain twins."""

import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.errors import UsageError
from tests import paper
from tests.methods.plain_normals import flood, normals_and_areas, sharing
from tests.methods.runs import SHAPES, run_in_file
from tests.shapes import grid, noisy

run = functools.partial(run_in_file, "bilateral")


def mean_edge(v, rings):
    return np.mean([np.linalg.norm(v[k] - v[i]) for i, ring in enumerate(rings) for k in ring])


def twin(
    v, faces, iterations, variant, mollify=1, closeness=0.0, similarity=0.0, radius=0.0, K=None
):
    """Both variants as their papers have them, vertex by vertex; under eqs. (6), (7) with K."""
    rings = paper.one_rings(len(v), faces)
    unit = mean_edge(v, rings)
    fixed = paper.normal_field(v, faces, mollify)
    x = v.copy()
    for j in range(iterations):
        n = fixed if variant == "one_ring" else paper.normal_field(x, faces, 0)
        start, d, sigma = x, np.zeros(len(v)), np.zeros(len(v))
        for i, ring in enumerate(rings):
            over = (x[ring] - x[i]) @ fixed[i]
            sigma[i] = 2 * np.mean(np.abs(over - np.mean(over)))
            if variant == "one_ring":
                near, sigma_c = ring, (closeness or 1.0) * unit
                h = (x[near] - x[i]) @ n[i]
                sigma_s = similarity * unit or np.std(h)
            else:
                sigma_c = (closeness or radius / 2) * unit
                if not sigma_c:
                    sigma_c = min(np.linalg.norm(x[k] - x[i]) for k in ring)
                near = sorted(flood(i, rings, x, x[i], radius * unit or 2 * sigma_c))
                h = (x[near] - x[i]) @ n[i]
                sigma_s = similarity * unit or np.std(np.abs(h))
            if sigma_s <= 1e-9 * unit:
                sigma_s = 1e-9 * unit  # a limit that the papers leave out
            exponent = ((x[near] - x[i]) ** 2).sum(axis=1) / (2 * sigma_c**2) + h**2 / (
                2 * sigma_s**2
            )
            w = np.exp(exponent.min() - exponent)
            d[i] = (w * h).sum() / w.sum()
        move = d[:, None] * n
        x = x + (1.0 if K is None else K**j) * move
        if K is not None:
            x = x + (sigma / sigma.max())[:, None] * (v - start)
    return x


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "given",
    [
        {"variant": "one_ring"},
        {"variant": "one_ring", "mollify": 0, "closeness": 0.4},
        {"variant": "one_ring", "similarity": 0.05},
        {"variant": "fleishman"},
        {"variant": "fleishman", "closeness": 0.8},
        {"variant": "fleishman", "radius": 2.5},
        {"variant": "fleishman", "radius": 1.2, "closeness": 1.5, "similarity": 0.1},
    ],
    ids=lambda given: "-".join(map(str, given.values())),
)
def test_kernels_agree_with_the_papers(shape, given):
    vertices, faces = SHAPES[shape]
    expected = twin(vertices, faces, 2, **given)
    actual = run(vertices, faces, iterations=2, **given)
    size = np.ptp(vertices, axis=0).max()
    assert np.abs(actual - expected).max() <= 1e-12 * size
    assert np.abs(actual - vertices).max() > 1e-3 * size  # it did something


def test_a_radius_needs_the_variant_that_has_one():
    with pytest.raises(UsageError, match="radius") as caught:
        methods.find("bilateral").validate({"radius": "2"})
    assert "fleishman" in caught.value.hint
    methods.find("bilateral").validate({"rho": "2", "variant": "fleishman"})


run_jones = functools.partial(run_in_file, "bilateral_non_iterative")


def gauss(t, width):
    return np.exp(-(t**2) / (2 * width**2))


def jones_twin(v, faces, sigma_f, sigma_g):
    """One pass as the paper has it, vertex by vertex; widths in mean edge lengths."""
    unit = mean_edge(v, paper.one_rings(len(v), faces))
    sigma_f, sigma_g = sigma_f * unit, sigma_g * unit
    c = v[faces].mean(axis=1)
    _, area = normals_and_areas(v, faces)
    touching, around = sharing(faces, 1), []
    for i, centre in enumerate(v):
        is_near = np.linalg.norm(c - centre, axis=1) <= 2 * sigma_f
        first = np.flatnonzero((faces == i).any(axis=1) & is_near).tolist()
        floods = (flood(f, touching, c, centre, 2 * sigma_f) for f in first)
        around.append(sorted(set().union(*floods)))
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
def test_jones_agrees_with_the_paper(shape, widths):
    vertices, faces = SHAPES[shape]
    expected = jones_twin(vertices, faces, *widths)
    actual = run_jones(vertices, faces, closeness=widths[0], similarity=widths[1])
    size = np.ptp(vertices, axis=0).max()
    assert np.abs(actual - expected).max() <= 1e-12 * size
    assert np.abs(actual - vertices).max() > 1e-3 * size  # it did something


def test_a_vertex_far_from_every_centroid_stays():
    # A strip of small triangles with one very long one at its end.
    vertices, faces = grid(3, 12)
    vertices = noisy(vertices, 1, 0.1)
    vertices = np.concatenate([vertices, [[-30.0, 0.0, 5.0]]])
    faces = np.concatenate([faces, [[0, 12, 36]]]).astype(np.int32)
    out = run_jones(vertices, faces)
    assert (out[36] == vertices[36]).all()
    assert (out[:36] != vertices[:36]).any(axis=1).all()


@pytest.mark.parametrize("width", [1e-300, 1e-12])
def test_tiny_widths_do_not_underflow(width):
    mesh = SHAPES["torus"]
    for variant in ("one_ring", "fleishman"):
        assert np.isfinite(run(*mesh, variant=variant, closeness=width, similarity=width)).all()
    assert (run_jones(*mesh, closeness=width) == mesh[0]).all()
    assert np.isfinite(run_jones(*mesh, similarity=width)).all()


def test_triangles_that_nothing_touches_are_their_own_planes():
    # Each shrinks to a point when it is mollified, up to rounding: no direction may come of that.
    corners = np.random.default_rng(0).normal(size=(200, 3, 3))
    vertices = (corners + 50.0 * np.arange(200)[:, None, None]).reshape(-1, 3)
    out = run_jones(vertices, np.arange(600, dtype=np.int32).reshape(-1, 3))
    assert np.abs(out - vertices).max() < 1e-9
