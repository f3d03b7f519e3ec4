"""What a run tells while it goes on: one frozen value per thing that happened to one file.

``index`` is the task's place in the plan.  A file whose worker died is tried once more, so
``Started`` can come twice for one index; ``Finished`` comes exactly once for every file dealt with.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from msal_cli.job.records import MeshRecord
    from msal_cli.job.settings import Task


@dataclass(frozen=True, slots=True)
class Started:
    """Work on a file begins."""

    index: int
    task: Task


@dataclass(frozen=True, slots=True)
class Progress:
    """``done`` of ``total`` steps of ``stage`` (such as ``"sweeps"``) of one file are over."""

    index: int
    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Finished:
    """A file is done with; its output, where there is one, is whole and noted in the manifest."""

    index: int
    record: MeshRecord


Event = Started | Progress | Finished

if TYPE_CHECKING:
    OnEvent = Callable[[Event], None]
