"""The choice of method and parameters for one mesh: the plain command and ``--auto``.

``adaptive`` chooses parameters of AL and MSAL, ``search`` among all methods and their blends.

A choice depends only on the mesh and the wishes, not on clocks, threads or other files, so that a
file has the same result everywhere.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from msal_cli.light_dataclass import dataclass

if TYPE_CHECKING:
    from msal_cli.analysis.noise_estimate import NoiseLevel

OnStep = Callable[[int, int], None]
"""Called as ``on_step(done, total)`` while candidates run."""

NONE = "none"
"""The name in place of a method if the mesh is not changed."""

SECONDS = 1.2, 22.0
"""Seconds on one core that a choice among all methods and its result take: for any mesh, and in
addition per million vertices; fitted to the sample meshes and to benchmarks/auto_seconds.py."""

METHODS = (
    "al",
    "bilateral_non_iterative",
    "blend",
    "hc",
    "learned",
    "msal",
    "taubin",
    "wiener",
    "windowed_sinc",
)
"""The methods that can be chosen: memory is reserved for the one that needs most."""

LARGEST_OF_FAMILY = {"schedule": "wiener"}
"""Parameters of ``al`` that need the most memory in the family."""

BYTES, FAMILY_BYTES = 25_000_000, 20_000_000
"""Memory that a choice among all methods and one within the family need beyond that of methods, for
meshes of any size, because candidates run on a part.  Measured by benchmarks/peak_memory.py, as
``auto``."""

LESS, KEEP_TEXTURE = 0.2, 0.9
"""The reduction of displacements, as a share of the choice, for each step of ``Wishes.strength``
below 0; and the share of the choice that is applied to keep texture."""


@dataclass(frozen=True)
class Wishes:
    """The user's preferences."""

    # what to preserve: ``texture``, ``edges`` or ``shape``; None for no preference
    keep: str | None = None
    strength: float = 0.0  # -2 to 2, relative to the automatic choice: greater is smoother
    # what the roughness of a mesh is if the estimate is unsure: ``noise`` or ``texture``; None for
    # a choice that limits the error in both cases
    assume: str | None = None

    @property
    def share(self) -> float:
        """The share of the displacements of the automatic choice that is applied, above 0 to 1."""
        share = 1.0 + LESS * min(self.strength, 0.0)
        return share * (KEEP_TEXTURE if self.keep == "texture" else 1.0)

    @property
    def weaker(self) -> Wishes | None:
        """The wishes with one step less smoothing; None if they ask for no additional smoothing."""
        if self.keep == "shape":
            return dataclasses.replace(self, keep=None)
        if self.strength > 0.0:
            return dataclasses.replace(self, strength=math.ceil(self.strength) - 1.0)
        return None


@dataclass(frozen=True)
class Choice:
    """The method and parameters for a mesh, and the reason."""

    method: str  # name of a method, or ``NONE``
    parameters: dict[str, Any]  # all of its parameters; empty for ``NONE``
    reason: str  # in words, such as ``noise 0.11 e; textured; MSAL, K = 0.6, 3 sweeps``
    # ``machined``, ``organic``, ``textured`` or ``clean``; None if it was not classified
    surface: str | None
    noise: NoiseLevel  # the noise that the choice is for
    # estimated error of the result, mean edge lengths; None if nothing was estimated
    risk: float | None = None
    tried: int = 0  # number of candidates that were compared
    # labels and risks of the next best candidates, best first
    runners_up: tuple[tuple[str, float], ...] = ()
