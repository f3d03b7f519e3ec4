"""Levels of local noise for which a blend has weights of their own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from msal_cli import methods
from msal_cli.arrays import Flags, Floats

if TYPE_CHECKING:
    from collections.abc import Sequence

    from msal_cli.auto.sample_patch import Part
    from msal_cli.auto.wishes import Allowed


QUANTILES = (0.1, 0.5, 0.9)
"""Of local levels, for which weights are chosen."""

LEAST_RATIO, LEAST_GAP = 1.25, 0.01
"""By how much they have to differ, as a ratio and in mean edge lengths."""

FEWEST_JUDGED = 200
"""Vertices that a level of local noise needs for weights of its own."""

EXAMPLE = {"members": "0.5:1*al", "levels": "0:1"}
"""A blend whose weights follow local noise."""


def may_follow(is_allowed: Allowed) -> bool:
    """Whether blends whose weights follow local noise are allowed."""
    blend = methods.find("blend")
    return is_allowed(blend, blend.validate(EXAMPLE))


def spread_levels(local: Floats) -> tuple[float, ...]:
    """Levels of local noise (n,) for quiet, usual and loud places; none if they differ little."""
    found: list[float] = []
    for level in np.quantile(local, QUANTILES).tolist():
        if not found or level > LEAST_RATIO * found[-1] + LEAST_GAP:
            found.append(float(round(level, 3)))
    return tuple(found) if len(found) > 1 else ()


def level_masks(part: Part, local: Floats, levels: Sequence[float]) -> list[Flags]:
    """Which vertices (m,) of a part are judged for each of the levels: those whose local noise,
    ``local`` (n,) over the whole mesh, is nearest to it."""
    own = local if part.numbers is None else local[part.numbers]
    nearest = np.abs(own[:, None] - np.array(levels)).argmin(axis=1)
    return [part.judged & (nearest == level) for level in range(len(levels))]
