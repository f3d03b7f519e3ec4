"""Files that do not fit into memory: denoised by tiles where that is possible, refused elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from msal_cli.errors import MsalError, UnsupportedError
from msal_cli.job.records import Failure

if TYPE_CHECKING:
    from msal_cli.batch.memory_budget import MemoryBudget
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.job.settings import Settings, Task


@dataclass(frozen=True)
class Oversized:
    """The files that are not loaded: those to denoise by tiles, and why others cannot be done."""

    by_tiles: tuple[int, ...]
    failures: Mapping[int, Failure]

    def __contains__(self, index: int) -> bool:
        return index in self.by_tiles or index in self.failures


def find_oversized(
    tasks: Mapping[int, Task], settings: Settings, budget: MemoryBudget, job: TileJob | None
) -> Oversized:
    """Which of the files do not fit; ``job`` is None where tiles are no way.

    A limit set by the user replaces what the machine has left, and the machines of another engine
    have their own memory.
    """
    reasons: dict[int, Failure | None] = {}
    if job is None:
        reasons.update(budget.oversized())
    elif job.options.is_forced:
        reasons = dict.fromkeys(tasks)
    elif job.limits.memory_bytes is not None:
        reasons.update(budget.beyond_limit)
    elif job.engine is None:
        reasons.update(budget.oversized())
    by_tiles: list[int] = []
    failures: dict[int, Failure] = {}
    for index, reason in reasons.items():
        objection = None if job is None else _find_objection(tasks[index], settings, job)
        if objection is None and job is not None:
            by_tiles.append(index)
        elif reason is not None and objection is None:
            failures[index] = reason
        elif reason is not None and isinstance(objection, UnsupportedError):
            hint = f"{reason.hint}; it cannot be denoised by tiles: {objection.message}"
            failures[index] = replace(reason, hint=hint)
        elif objection is not None:
            failures[index] = Failure(
                objection.code, objection.message, objection.hint, objection.where
            )
    return Oversized(tuple(by_tiles), failures)


def _find_objection(task: Task, settings: Settings, job: TileJob) -> MsalError | None:
    """Why a file cannot be denoised by tiles; None if it can."""
    from msal_cli.batch.tile_run import estimate

    try:
        estimate(task, settings, job)
    except MsalError as error:
        return error
    return None
