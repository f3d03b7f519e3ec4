"""Operators over turned one-rings: any mixture of valences, cut into ranges anywhere."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.kernels.operators import AnisotropicLaplacian, RingBilateral

HUB = 3000


def rings(kind):
    """Rings of 1,500 vertices, not of any surface: valences alike, mixed, all different, a hub."""
    random = np.random.default_rng(5)
    n = 1500
    valences = {
        "alike": np.full(n, 6),
        "mixed": random.integers(0, 12, n),
        "different": random.permutation(n) % 300,
        "hub": np.where(np.arange(n) == 700, HUB, 6),
    }[kind]
    start = np.concatenate([[0], np.cumsum(valences)]).astype(np.int32)
    return start, random.integers(0, n, start[-1]).astype(np.int32)


def operator(kind, of=AnisotropicLaplacian):
    random = np.random.default_rng(7)
    start, ring = rings(kind)
    n = len(start) - 1
    normals = random.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    widths = (1.0, 0.8) if of is RingBilateral else (1.0,)
    made = of(normals, start, ring, random.random(n) < 0.9, *widths)
    return made, random.normal(size=(n, 3))


KINDS = pytest.mark.parametrize("kind", ["alike", "mixed", "different", "hub"])
OPERATORS = pytest.mark.parametrize("of", [AnisotropicLaplacian, RingBilateral])


@KINDS
@OPERATORS
def test_one_pass_is_the_two_passes(kind, of):
    made, x = operator(kind, of)
    heights = made(x).move
    offsets = np.linspace(-1.0, 1.0, len(x))
    heights_after, moved = offsets.copy(), np.empty_like(x)
    made.advance(x, x, heights_after, 0.5, 0.25, moved)
    t = offsets + 0.5 * heights - 0.25 * offsets
    assert (heights_after == t).all()
    assert (moved == x + t[:, None] * made.normals).all()
