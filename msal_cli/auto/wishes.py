"""Wishes for the choice of a method, and the choice."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msal_cli.structs import dataclass

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel

OnStep = Callable[[int, int], None]
"""Called as ``on_step(done, total)`` while candidates are looked at."""

NONE = "none"
"""In place of a method: the mesh stays as it is."""

FAMILY, ALL = "family", "all"
"""Among what was chosen: AL and MSAL with the schedules of equation (2), or all methods."""


@dataclass(frozen=True)
class Wishes:
    """What the user asks for.

    Attributes
    ----------
    prefer : ``balanced``, ``positions``, ``normals`` or ``volume``: what is to be most accurate.
    keep : ``texture``, ``edges`` or ``shape``, what must not suffer; None if nothing was said.
    strength : -2 to 2, around the automatic choice: greater is smoother.
    assume : ``noise`` or ``texture``, what the roughness of a mesh is where the estimate is unsure
        of it; None for a choice that is not much worse either way.
    """

    prefer: str = "balanced"
    keep: str | None = None
    strength: float = 0.0
    assume: str | None = None


@dataclass(frozen=True)
class Choice:
    """What was chosen for a mesh, and why.

    Attributes
    ----------
    method : name of a method, or ``NONE``.
    parameters : all of its parameters; empty for ``NONE``.
    reason : a sentence, such as ``noise 0.11 e; textured; MSAL, K = 0.6, 3 sweeps``.
    surface : ``machined``, ``organic``, ``textured`` or ``clean``; None where it was not looked at.
    noise : the noise that it was made for.
    risk : estimated error of the result, mean edge lengths; None if nothing was estimated.
    tried : candidates that were looked at.
    runners_up : label and risk of the next best, best first, at most 3.
    among : ``ALL`` or ``FAMILY``.
    estimate : the estimated noise where nothing was assumed of it; None where that is ``noise``.
    """

    method: str
    parameters: dict[str, Any]
    reason: str
    surface: str | None
    noise: NoiseLevel
    risk: float | None = None
    tried: int = 0
    runners_up: tuple[tuple[str, float], ...] = ()
    among: str = ALL
    estimate: NoiseLevel | None = None
