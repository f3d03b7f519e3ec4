"""Choosing method and parameters for one mesh: what the plain command and ``--auto`` do.

``adaptive`` chooses parameters of AL and MSAL, ``search`` among all methods and their mixtures.

A choice depends on the mesh and the wishes alone, never on clocks, threads or other files, so that
the same file comes out the same everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from msal_cli.analysis.noise_estimate import NoiseLevel
    from msal_cli.mesh import Mesh

    OnStep = Callable[[int, int], None]
    """Called as ``on_step(done, total)`` while candidates are looked at."""

NONE = "none"
"""In place of a method: the mesh stays as it is."""

FAMILY, ALL = "family", "all"
"""Among what was chosen: AL and MSAL with the schedules of equation (2), or all methods."""

METHODS = (
    "al",
    "bilateral_non_iterative",
    "bilateral_normal",
    "blend",
    "guided_normal",
    "l0",
    "learned",
    "msal",
    "normal_diffusion",
    "normal_threshold",
    "wiener",
    "windowed_sinc",
)
"""The methods that are ever chosen: memory is set aside for the hungriest of them."""

LARGEST_OF_FAMILY = {"schedule": "wiener"}
"""Parameters of ``al`` that take the most memory of all in the family."""

FAMILY_BYTES = 6_000_000
"""The same as ``BYTES`` for a choice within the family."""

BYTES = 25_000_000
"""Memory that choosing takes at most beyond what methods do, however large the mesh is: candidates
run on a part of it.  Measured by benchmarks/peak_memory.py, as ``auto``."""


@dataclass(frozen=True)
class Wishes:
    """What the user cares for.

    Attributes
    ----------
    prefer : ``balanced``, ``positions``, ``normals`` or ``volume``: what is to come out best.
    keep : ``texture``, ``edges`` or ``shape``, what must not suffer; None if nothing was said.
    strength : -2 to 2, around the automatic choice: greater is smoother.
    budget : most time for choosing and denoising, in default MSAL runs over the same mesh, by what
        candidates are known to cost and not by a clock.
    """

    prefer: str = "balanced"
    keep: str | None = None
    strength: float = 0.0
    budget: float = 60.0


@dataclass(frozen=True)
class Choice:
    """What was chosen for a mesh, and why.

    Attributes
    ----------
    method : name of a method, or ``NONE``.
    parameters : its settled parameters, every one of them; empty for ``NONE``.
    reason : a sentence, such as ``noise 0.11 e; textured; MSAL, K = 0.6, 3 sweeps``.
    surface : ``machined``, ``organic``, ``textured`` or ``clean``; None where that was not asked.
    noise : the estimated noise.
    risk : estimated error of the result, mean edge lengths; None if nothing was estimated.
    tried : candidates that were looked at.
    runners_up : label and risk of the next best, best first, at most 3.
    among : ``ALL`` or ``FAMILY``.
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


def chosen(mesh: Mesh, wishes: Wishes, on_step: OnStep | None = None) -> Choice:
    """The method and the parameters for ``mesh``.

    Vertices that the mesh holds stay where they are.  Where it has trust (``Mesh.trust``) the
    method is one that has a data term, which the trust scales.
    """
    from msal_cli.auto import search

    return search.chosen(mesh, wishes, on_step)
