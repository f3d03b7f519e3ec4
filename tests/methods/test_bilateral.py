"""The bilateral filters: hand-worked, against a plain twin, and with published figures."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from msal_cli import methods
from msal_cli.errors import UsageError
from tests import paper
from tests.methods.runs import SHAPES, run_in_file
from tests.shapes import fan

run = functools.partial(run_in_file, "bilateral")


def mean_edge(v, rings):
    return np.mean([np.linalg.norm(v[k] - v[i]) for i, ring in enumerate(rings) for k in ring])


def flooded(x, rings, i, radius):
    """Vertices that edges join to i through vertices within the radius, i itself among them."""
    found, waiting = {i}, [i]
    while waiting:
        for k in rings[waiting.pop()]:
            if k not in found and np.linalg.norm(x[k] - x[i]) <= radius:
                found.add(k)
                waiting.append(k)
    return sorted(found)


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
                near = flooded(x, rings, i, radius * unit or 2 * sigma_c)
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


@pytest.mark.parametrize("variant", ["one_ring", "fleishman"])
@pytest.mark.parametrize("width", [1e-300, 1e-12])
def test_tiny_widths_do_not_underflow(variant, width):
    vertices, faces = SHAPES["torus"]
    out = run(vertices, faces, variant=variant, closeness=width, similarity=width)
    assert np.isfinite(out).all()


def test_a_short_edge_stops_the_automatic_width_but_not_a_given_one():
    # The middle of a fan stands out by 0.2 and has one neighbour at a hundredth of an edge.
    vertices, faces = fan([0.0] * 8)
    vertices[0, 2] = 0.2
    vertices[1] = [0.01, 0.0, 0.2]
    automatic = run(vertices, faces, variant="fleishman", iterations=1)
    given = run(vertices, faces, variant="fleishman", iterations=1, closeness=1)
    assert abs(automatic[0, 2] - 0.2) < 0.01
    assert given[0, 2] < 0.18


def test_a_radius_needs_the_variant_that_has_one():
    with pytest.raises(UsageError, match="radius") as caught:
        methods.find("bilateral").validate({"radius": "2"})
    assert "fleishman" in caught.value.hint
    methods.find("bilateral").validate({"rho": "2", "variant": "fleishman"})
