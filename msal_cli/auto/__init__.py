"""Choosing method and parameters for one mesh: what the plain command and ``--auto`` do.

``adaptive`` chooses parameters of AL and MSAL, ``search`` among all methods and their mixtures.

A choice depends on the mesh and the wishes alone, never on clocks, threads or other files, so that
the same file comes out the same everywhere.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msal_cli.auto.wishes import ALL, FAMILY, NONE, Choice, OnStep, Wishes

if TYPE_CHECKING:
    from msal_cli.mesh import Mesh

__all__ = [
    "ALL",
    "BYTES",
    "FAMILY",
    "FAMILY_BYTES",
    "LARGEST_OF_FAMILY",
    "METHODS",
    "NONE",
    "Choice",
    "Wishes",
    "choose_method",
]

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


def choose_method(mesh: Mesh, wishes: Wishes, on_step: OnStep | None = None) -> Choice:
    """The method and the parameters for ``mesh``.

    Vertices that the mesh holds stay where they are.  Where it has trust (``Mesh.trust``) the
    method is one that has a data term, which the trust scales.
    """
    from msal_cli.auto import search

    return search.search(mesh, wishes, on_step)
