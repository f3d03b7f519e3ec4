"""Files that do not fit into memory: denoised by tiles where that is possible, or refused."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msal_cli.batch.tile_estimate import estimate_tiles
from msal_cli.errors import MsalError, ResourceError, UnsupportedError
from msal_cli.job.records import Failure

if TYPE_CHECKING:
    from msal_cli.batch.memory_budget import MemoryBudget
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.job.settings import Settings, Task
    from msal_cli.tiles.estimates import TileEstimate


@dataclass(frozen=True)
class Oversized:
    """The files that are not loaded: what those take that are denoised by tiles, and why others
    cannot be done."""

    by_tiles: Mapping[int, TileEstimate]
    failures: Mapping[int, Failure]

    def __contains__(self, index: int) -> bool:
        return index in self.by_tiles or index in self.failures


def find_oversized(
    tasks: Mapping[int, Task], settings: Settings, budget: MemoryBudget, job: TileJob
) -> Oversized:
    """Which of the files do not fit."""
    by_tiles: dict[int, TileEstimate] = {}
    failures: dict[int, Failure] = {}
    for index, reason in _find_reasons(tasks, budget, job).items():
        if job.options is None:
            assert reason is not None
            failures[index] = reason
            continue
        try:
            by_tiles[index] = estimate_tiles(tasks[index], settings, job)
        except MsalError as objection:
            failures[index] = _describe(objection, reason)
    return Oversized(by_tiles, failures)


def _find_reasons(
    tasks: Mapping[int, Task], budget: MemoryBudget, job: TileJob
) -> dict[int, Failure | None]:
    """Why files are not loaded; None where that is a wish.

    A limit set by the user replaces what the machine has left, and is enforced by workers, too; the
    machines of another engine have their own memory.
    """
    if job.options is not None and job.options.is_forced:
        return dict.fromkeys(tasks)
    found: Mapping[int, Failure] = {}
    if job.limits.memory_bytes is not None:
        found = {} if job.options is None else budget.beyond_limit
    elif job.engine is None:
        found = budget.oversized()
    return {index: failure for index, failure in found.items() if index in tasks}


def _describe(objection: MsalError, reason: Failure | None) -> Failure:
    """Why a file cannot be done: ``reason`` is why not in memory, if there is one, and
    ``objection`` why not by tiles."""
    if reason is None or not isinstance(objection, UnsupportedError | ResourceError):
        return Failure(objection.code, objection.message, objection.hint, objection.where)
    hint = f"{reason.hint}; it cannot be denoised by tiles: {objection.message}"
    return replace(reason, hint=hint)
