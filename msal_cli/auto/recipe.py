"""A blend as a method with its parameters, and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from msal_cli import methods
from msal_cli.arrays import Floats
from msal_cli.auto.candidates import Candidate
from msal_cli.auto.wishes import NONE
from msal_cli.methods.blend import format_levels, format_members


@dataclass(frozen=True)
class Recipe:
    """What is to be run: a method, or ``NONE``, with its settled parameters, and its label."""

    method: str
    parameters: dict[str, Any]
    label: str


def build_recipe(
    members: Sequence[Candidate],
    weights: Floats,
    noise_edges: float,
    levels: Sequence[float] = (),
    relax: int = 0,
) -> Recipe:
    """The blend of ``members`` by weights (k,), in hundredths; the largest first.

    ``noise_edges`` is the noise that members are given, mean edge lengths of the mesh.  With
    ``levels`` of local noise, mean edge lengths, weights are (levels, k).  ``relax`` is how many
    passes even out the triangles before.  One member of weight 1 is its method by itself, and no
    weight at all is ``NONE``.
    """
    rows = np.atleast_2d(weights)
    largest = rows.max(axis=0)
    used = sorted(np.flatnonzero(largest).tolist(), key=lambda k: (-largest[k], k))
    if not used:
        return Recipe(NONE, {}, "left as it is")
    settings = [members[k].settings(noise_edges) for k in used]
    first = members[used[0]]
    if (rows[:, used[0]] == 1.0).all() and not relax:
        return Recipe(first.method, methods.find(first.method).validate(settings[0]), first.label)
    if len(rows) > 1 and (rows == rows[0]).all():
        rows, levels = rows[:1], ()
    listed = [
        (rows[:, k].tolist(), members[k].method, given)
        for k, given in zip(used, settings, strict=True)
    ]
    given = {"members": format_members(listed), "levels": format_levels(levels), "relax": relax}
    label = " + ".join(f"{_percent(rows[:, k])} {members[k].label}" for k in used)
    rest = 1.0 - rows.sum(axis=1)
    if rest.max() > 0.005:
        label += f" + {_percent(rest)} as it was"
    if levels:
        label += " where the noise is " + "/".join(f"{level:.2g}" for level in levels) + " e"
    if relax:
        label += ", after triangles were evened out"
    return Recipe("blend", methods.find("blend").validate(given), label)


def _percent(weights: Floats) -> str:
    """One weight as 40%, more of them as 0/20/60%."""
    if (weights == weights[0]).all():
        return f"{weights[0]:.0%}"
    return "/".join(f"{100.0 * weight:.0f}" for weight in weights) + "%"
