"""What is mixed into a choice to move vertices farther."""

from __future__ import annotations

import numpy as np
import pytest

from msal_cli.auto.choices import MORE, strengthen


def mean_length(moves):
    return float(np.linalg.norm(moves, axis=1).mean())


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
def test_the_mixture_moves_farther_by_as_much_as_is_asked_for(strength):
    draw = np.random.default_rng(0)
    base = draw.normal(size=(500, 3))
    near, far, less = (
        base + 0.3 * draw.normal(size=(500, 3)),
        3.0 * draw.normal(size=(500, 3)),
        0.5 * base,
    )
    k, weight = strengthen(base, [less, far, near], strength)
    assert k == 2 or strength > 1.0
    mixed = (1.0 - weight) * base + weight * [less, far, near][k]
    ratio = mean_length(mixed) / mean_length(base)
    assert 1.0 + MORE * strength <= ratio < 1.0 + MORE * strength + 0.05


def test_if_none_moves_far_enough_the_farthest_is_mixed_in():
    base = np.ones((10, 3))
    assert strengthen(base, [0.2 * base, 0.9 * base], 2.0) == (1, 1.0)
