"""How far the reading of a mesh in pieces has come."""

from __future__ import annotations

from collections.abc import Callable

OnProgress = Callable[[int, int], None]
"""Called with the numbers of vertices and faces that were read, and that will be in all."""


def unheard(done: int, total: int) -> None:
    """Nobody wants to know."""


class Steps:
    """Counts what was read of ``total`` vertices and faces, and tells ``on_progress``."""

    def __init__(self, on_progress: OnProgress, total: int) -> None:
        self._on_progress = on_progress
        self._total = total
        self._done = 0

    def add(self, count: int) -> None:
        """So many more were read."""
        self._done += count
        self._on_progress(self._done, self._total)
