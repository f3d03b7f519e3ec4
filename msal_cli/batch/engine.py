"""The interface between a run and what processes its files: worker processes or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from msal_cli.job.settings import NO_LIMITS, Limits

if TYPE_CHECKING:
    from msal_cli.batch.events import Message


class Interrupt(Exception):  # noqa: N818 - it is a message, not a fault
    """Raised by ``Engine.batches`` after ``Engine.interrupt``, when all work is given up."""


class Engine(Protocol):
    """Does many tasks and reports on each; ``worker_pool.WorkerPool`` is one.

    Every task that was begun gets exactly one ``Returned`` or ``Failed``, unless it is interrupted.
    """

    def batches(self) -> Generator[list[Message], None, None]:
        """What happens, as it happens; nothing of the engine is left when the iteration ends.

        Raises
        ------
        Interrupt : after ``interrupt``, once all work is given up.
        UsageError : the engine cannot be used like this; no file was begun.
        ResourceError : it cannot go on; what was given before is whole.
        """
        ...

    def stop(self) -> None:
        """Hand out nothing more; what was handed out goes on, second tries too."""
        ...

    def interrupt(self) -> None:
        """Give up the current tasks and end; may be called from a signal handler."""
        ...


@dataclass(frozen=True)
class Work:
    """What an engine is to do.

    Attributes
    ----------
    tasks : the tasks by their index in the plan; any picklable values.
    function : module-level; called in some process as ``function(task, common, on_progress)``.
    common : picklable second argument of every call.
    jobs : tasks at the same time on this machine.
    cores : cores of this machine to share; workers get their part as ``MSAL_THREADS``.
    folders : folders with a manifest, where outputs go; they exist.
    on_death : called with the process id of a worker of this machine that has ended, and the index
        of its current task, to remove what it left.
    on_loss : called with the index of a task that was lost, before it is tried again or given up;
        returns why it must not be, or an empty string.
    limits : seconds that a task may take, and memory that its worker may use.
    retries : how often a task that was lost with its worker is tried again.
    weights : bytes of memory that the large tasks are expected to need; they go first.
    light_bytes : ... any other task.
    budget_bytes : what all current tasks together may need on this machine; None is no bound.
    reports_first : results are reported before the next tasks are handed out, so that ``stop`` is
        in time for these.
    """

    tasks: dict[int, Any]
    function: Callable[..., Any]
    common: Any
    jobs: int = 1
    cores: int = 1
    folders: tuple[str, ...] = ()
    on_death: Callable[[int, int], None] = lambda pid, index: None
    on_loss: Callable[[int], str] = lambda index: ""
    limits: Limits = NO_LIMITS
    retries: int = 1
    weights: Mapping[int, int] = field(default_factory=dict)
    light_bytes: int = 0
    budget_bytes: int | None = None
    reports_first: bool = False


EngineFactory = Callable[[Work], Engine]
