"""What meshes that are read in pieces are limited by: vertices have 32-bit numbers."""

from __future__ import annotations

from msal_cli.errors import TooLargeError

MOST_VERTICES = 2**32 - 2
"""Vertices, or corners of facets, that unsigned 32-bit numbers can tell apart; the largest such
number stands for none."""


def require_countable(count: int, what: str) -> None:
    """Raise TooLargeError if there are too many vertices, or what ``what`` says."""
    if count > MOST_VERTICES:
        raise TooLargeError(
            f"{count} {what} are more than the {MOST_VERTICES} that can be numbered",
            hint="cut the mesh into parts",
        )
