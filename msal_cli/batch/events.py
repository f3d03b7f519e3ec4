"""What happens to the files of a run: one frozen value per event of one file.

``index`` is the task's position in the plan.  An engine sends messages; a run passes on what a user
wants to see as events.  A task whose worker died is tried again, so ``Started`` can come twice for
one index; ``Finished`` comes exactly once for every file.
"""

from __future__ import annotations

import collections
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

    from msal_cli.job.records import MeshRecord


@dataclass(frozen=True, slots=True)
class Started:
    """Work on a task begins."""

    index: int


@dataclass(frozen=True, slots=True)
class Progress:
    """``done`` of ``total`` steps of ``stage`` (such as ``"sweeps"``) of one task are over."""

    index: int
    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Returned:
    """The result of a task; ``earlier`` says what ended the try before, if there was one."""

    index: int
    result: Any
    earlier: str = ""


@dataclass(frozen=True, slots=True)
class Failed:
    """A task has no result.

    ``cause`` is ``"crash"``, ``"memory"`` or ``"timeout"``, at every try; ``"exception"``, which
    another try would not avoid; or ``"changed"``, if another try would do harm.
    """

    index: int
    cause: str
    reason: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Retried:
    """A task was lost with its worker and will be tried again."""

    index: int
    reason: str


@dataclass(frozen=True, slots=True)
class Finished:
    """A file is finished; its output, where there is one, is whole and in the manifest."""

    index: int
    record: MeshRecord


Message = Started | Progress | Returned | Failed | Retried
Event = Started | Progress | Finished

if TYPE_CHECKING:
    OnEvent = Callable[[Event], None]


class Losses:
    """The tasks that were lost with their workers: how often each, and why the last time.

    ``retries`` is how often a task is tried again.
    """

    def __init__(self, retries: int) -> None:
        self._retries = retries
        self._counts: collections.Counter[int] = collections.Counter()
        self.reasons: dict[int, str] = {}

    def add(self, index: int, cause: str, reason: str, hint: str) -> Retried | Failed:
        """Count one more loss; what becomes of the task."""
        self._counts[index] += 1
        tries = self._counts[index]
        if tries <= self._retries:
            self.reasons[index] = reason
            return Retried(index, reason)
        if tries > 1:
            reason += ", as at the first try" if tries == 2 else f" ({tries} tries)"
        return Failed(index, cause, reason, hint)
