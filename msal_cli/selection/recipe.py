"""A blend as a method with its parameters, and in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msal_cli import methods
from msal_cli.methods.blend import written
from msal_cli.selection import NONE
from msal_cli.selection.candidates import Candidate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Recipe:
    """What is to be run: a method, or ``NONE``, with its settled parameters, and its label."""

    method: str
    parameters: dict[str, Any]
    label: str


def recipe(members: Sequence[Candidate], weights: Floats, noise_edges: float) -> Recipe:
    """The blend of ``members`` by weights (k,), in hundredths; the largest first.

    ``noise_edges`` is the noise that members are told, mean edge lengths of the mesh.  One member
    of weight 1 is its method by itself, and no weight at all is ``NONE``.
    """
    used = sorted(np.flatnonzero(weights).tolist(), key=lambda k: (-weights[k], k))
    if not used:
        return Recipe(NONE, {}, "left as it is")
    settings = [members[k].settings(noise_edges) for k in used]
    first = members[used[0]]
    if weights[used[0]] == 1.0:
        return Recipe(first.method, methods.find(first.method).settled(settings[0]), first.label)
    listed = [
        (float(weights[k]), members[k].method, given)
        for k, given in zip(used, settings, strict=True)
    ]
    label = " + ".join(f"{weights[k]:.0%} {members[k].label}" for k in used)
    rest = 1.0 - float(weights.sum())
    if rest > 0.005:
        label += f" + {rest:.0%} as it was"
    return Recipe("blend", methods.find("blend").settled({"members": written(listed)}), label)
