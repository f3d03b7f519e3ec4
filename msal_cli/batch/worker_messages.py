"""What a crew, or another engine, tells of the tasks in its hands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Began:
    """A worker has taken task ``index`` in hand."""

    index: int


@dataclass(frozen=True, slots=True)
class Advanced:
    """What ``on_progress`` was called with."""

    index: int
    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Returned:
    """The result of task ``index``; ``earlier`` tells what ended the try before, if any did."""

    index: int
    result: Any
    earlier: str = ""


@dataclass(frozen=True, slots=True)
class Lost:
    """Task ``index`` has no result.

    ``cause`` is ``"crash"``, ``"memory"`` or ``"timeout"``, at every try; ``"exception"``, which
    another try would not mend; or ``"changed"``, if another try would do harm.
    """

    index: int
    cause: str
    reason: str
    hint: str = ""


@dataclass(frozen=True, slots=True)
class Again:
    """Task ``index`` was lost with its worker and will be tried again."""

    index: int
    reason: str


Message = Began | Advanced | Returned | Lost | Again
