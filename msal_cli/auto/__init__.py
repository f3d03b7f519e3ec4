"""Choosing method and parameters for one mesh: what the plain command and ``--auto`` do.

``adaptive`` chooses parameters of AL and MSAL, ``search`` among all methods and their mixtures.

A choice depends on the mesh and the wishes alone, never on clocks, threads or other files, so that
the same file comes out the same everywhere.
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
"""Called as ``on_step(done, total)`` while candidates are looked at."""

NONE = "none"
"""In place of a method: the mesh stays as it is."""

SECONDS = 1.2, 22.0
"""Seconds of one core that a choice among all methods takes with its result, for any mesh and for a
million vertices; fitted to the sample meshes and to benchmarks/auto_seconds.py."""

FAMILY, ALL = "family", "all"
"""Among what was chosen: AL and MSAL with the schedules of equation (2), or all methods."""

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
"""The methods that are ever chosen: memory is reserved for the one that needs most."""

LARGEST_OF_FAMILY = {"schedule": "wiener"}
"""Parameters of ``al`` that take the most memory of all in the family."""

FAMILY_BYTES = 20_000_000
"""The same as ``BYTES`` for a choice within the family."""

BYTES = 25_000_000
"""Memory that choosing takes at most beyond what methods do, however large the mesh is: candidates
run on a part of it.  Measured by benchmarks/peak_memory.py, as ``auto``."""


LESS, KEEP_TEXTURE = 0.2, 0.9
"""By how much less each step of ``Wishes.strength`` below 0 moves vertices, in parts of the choice;
and the share of it that keeps texture."""


@dataclass(frozen=True)
class Wishes:
    """What the user asks for."""

    # ``balanced``, ``positions``, ``normals`` or ``volume``: what is to be most accurate
    prefer: str = "balanced"
    # ``texture``, ``edges`` or ``shape``, what must not suffer; None if nothing was said
    keep: str | None = None
    strength: float = 0.0  # -2 to 2, around the automatic choice: greater is smoother
    # ``noise`` or ``texture``, what the roughness of a mesh is where the estimate is unsure of it;
    # None for a choice that is not much worse either way
    assume: str | None = None

    @property
    def share(self) -> float:
        """How much of a choice without them is asked for, above 0 to 1."""
        share = 1.0 + LESS * min(self.strength, 0.0)
        return share * (KEEP_TEXTURE if self.keep == "texture" else 1.0)

    @property
    def weaker(self) -> Wishes | None:
        """Wishes for the next lesser smoothing; None where no more is asked for than without."""
        if self.keep == "shape":
            return dataclasses.replace(self, keep=None)
        if self.strength > 0.0:
            return dataclasses.replace(self, strength=math.ceil(self.strength) - 1.0)
        return None


@dataclass(frozen=True)
class Choice:
    """What was chosen for a mesh, and why."""

    method: str  # name of a method, or ``NONE``
    parameters: dict[str, Any]  # all of its parameters; empty for ``NONE``
    reason: str  # a sentence, such as ``noise 0.11 e; textured; MSAL, K = 0.6, 3 sweeps``
    # ``machined``, ``organic``, ``textured`` or ``clean``; None where it was not looked at
    surface: str | None
    noise: NoiseLevel  # the noise that it was made for
    # estimated error of the result, mean edge lengths; None if nothing was estimated
    risk: float | None = None
    tried: int = 0  # candidates that were looked at
    # label and risk of the next best, best first, at most 3
    runners_up: tuple[tuple[str, float], ...] = ()
    among: str = ALL  # ``ALL`` or ``FAMILY``
    # the estimated noise where nothing was assumed of it; None where that is ``noise``
    estimate: NoiseLevel | None = None
