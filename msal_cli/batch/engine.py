"""What a run asks of whoever hands out its files, be it worker processes or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from msal_cli.job.settings import NO_LIMITS, Limits

if TYPE_CHECKING:
    from msal_cli.batch.worker_messages import Message
    from msal_cli.job.settings import Task


class Engine(Protocol):
    """Does many tasks and tells what becomes of each; ``workers.Crew`` is one.

    Every task that was begun gets exactly one ``Returned`` or ``Lost``, unless it is interrupted.
    """

    def batches(self) -> Generator[list[Message], None, None]:
        """What happens, as it happens; nothing of the engine is left when the iteration ends.

        Raises
        ------
        workers.Interrupt : after ``interrupt``, once all work is given up.
        UsageError : the engine cannot be used like this; no file was begun.
        ResourceError : it cannot go on; what was given before is whole.
        """
        ...

    def stop(self) -> None:
        """Hand out nothing more; what was handed out goes on."""
        ...

    def interrupt(self) -> None:
        """Give up what is in hand and end; may be called from a signal handler."""
        ...


@dataclass(frozen=True)
class Work:
    """What an engine is to do.

    Attributes
    ----------
    tasks : the tasks by their index in the plan.
    function : module-level; called in some process as ``function(task, common, on_progress)``.
    common : picklable second argument of every call.
    jobs : tasks at the same time on this machine.
    cores : cores of this machine to share.
    folders : folders with a manifest, where outputs go; they exist.
    on_death : called with the process id of a worker of this machine that has ended, and the index
        of the task that it had in hand, to clear away what it left.
    on_loss : called with the index of a task that was lost, before it is tried again; returns why
        it must not be, or an empty string.
    limits : what one task may take.
    retries : how often a task that was lost with its worker is tried again.
    weights : bytes of memory that the large tasks are foreseen to take; they go first.
    light_bytes : what any other is taken to need.
    budget_bytes : what all tasks in hand may take together on this machine; None is no bound.
    tells_first : ``stop`` must be in time for the task after the one whose end was told.
    """

    tasks: dict[int, Task]
    function: Callable[..., Any]
    common: Any
    jobs: int
    cores: int
    folders: tuple[str, ...] = ()
    on_death: Callable[[int, int], None] = lambda pid, index: None
    on_loss: Callable[[int], str] = lambda index: ""
    limits: Limits = NO_LIMITS
    retries: int = 1
    weights: Mapping[int, int] = field(default_factory=dict)
    light_bytes: int = 0
    budget_bytes: int | None = None
    tells_first: bool = False


EngineFor = Callable[[Work], Engine]


def crew_for(work: Work) -> Engine:
    """Supervised worker processes on this machine."""
    from msal_cli.batch.schedule import Schedule
    from msal_cli.batch.worker_pool import Crew

    return Crew(
        dict(work.tasks),
        work.function,
        work.common,
        jobs=work.jobs,
        cores=work.cores,
        limits=work.limits,
        schedule=Schedule(
            work.tasks,
            weights=work.weights,
            light_bytes=work.light_bytes,
            budget_bytes=work.budget_bytes,
            retries=work.retries,
        ),
        on_death=work.on_death,
        on_loss=work.on_loss,
        tells_first=work.tells_first,
    )
