"""The interface of engines: their work, the messages they send, and the order of tasks.

A message is a frozen value for one event of one file; a run passes those on, as events, that a user
wants to see.  ``index`` is the task's position in the plan.  A task whose worker died is tried
again, so ``Started`` can come twice for one index; ``Finished`` comes exactly once for every file.
"""

import collections
from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Any, Protocol

from msal_cli.codecs.header import BASE_BYTES
from msal_cli.job import room
from msal_cli.job.records import Failure, MeshRecord
from msal_cli.job.settings import NO_LIMITS, Limits, Settings, Task
from msal_cli.light_dataclass import dataclass, field
from msal_cli.machine import available_bytes


@dataclass(frozen=True, slots=True)
class Started:
    index: int


@dataclass(frozen=True, slots=True)
class Progress:
    """``done`` of ``total`` steps of ``stage`` (such as ``"sweeps"``) of one task are done."""

    index: int
    stage: str
    done: int
    total: int


@dataclass(frozen=True, slots=True)
class Returned:
    """The result of a task; ``earlier`` says why the try before failed, if there was one."""

    index: int
    result: Any
    earlier: str = ""


@dataclass(frozen=True, slots=True)
class Failed:
    """A task has no result.

    Its code is ``E_CRASH``, ``E_MEMORY`` or ``E_TIMEOUT`` after the last try; ``E_INTERNAL``, which
    another try would not avoid; or ``E_CHANGED``, if another try would do harm.
    """

    index: int
    failure: Failure


@dataclass(frozen=True, slots=True)
class Retried:
    index: int
    reason: str


@dataclass(frozen=True, slots=True)
class Finished:
    """A file is finished; its output, where there is one, is whole and in the manifest."""

    index: int
    record: MeshRecord


Message = Started | Progress | Returned | Failed | Retried
Event = Started | Progress | Finished
OnEvent = Callable[[Event], None]


class Interrupt(Exception):  # noqa: N818 - it is a message, not a fault
    """Raised by ``Engine.batches`` after ``Engine.interrupt``, once all work is given up."""


class Engine(Protocol):
    """Does many tasks and reports on each: worker processes or a cluster.

    Unless the engine is interrupted, each started task gets exactly one ``Returned`` or ``Failed``.
    """

    def batches(self) -> Generator[list[Message], None, None]:
        """Messages as they come; when the iteration ends, all processes of the engine are gone.

        Raises
        ------
        Interrupt : after ``interrupt``, once all work is given up.
        UsageError : the engine cannot be used like this; no file was started.
        ResourceError : it cannot go on; results given before are complete.
        """

    def stop(self) -> None:
        """Start no more tasks; second tries of started ones still run."""

    def interrupt(self) -> None:
        """Give up the current tasks and end; may be called from a signal handler."""


@dataclass(frozen=True)
class Work:
    tasks: dict[int, Any]  # picklable values by their index in the plan
    # module-level function, called in some process as ``function(task, common, on_progress)``
    function: Callable[..., Any]
    common: Any
    # jobs, cores: tasks at the same time on this machine, and the cores that they share
    jobs: int = 1
    cores: int = 1
    folders: tuple[str, ...] = ()  # folders with a manifest; they exist
    # called with the process id of a worker of this machine that has ended, and the index of its
    # current task, to remove its temporary files
    on_death: Callable[[int, int], object] = lambda pid, index: None
    # called with the index of a task that was lost, before it is tried again (at most ``retries``
    # times) or given up: returns why it must not be tried again, or an empty string
    on_loss: Callable[[int], str] = lambda index: ""
    limits: Limits = NO_LIMITS
    retries: int = 1
    # weights, light_bytes: bytes of memory expected for the large tasks, and for any other
    weights: Mapping[int, int] = field(default_factory=dict)
    light_bytes: int = 0
    budget_bytes: int | None = None  # what all current tasks may need; None is unlimited
    # report results before the next tasks are handed out, so that ``stop`` is in time for these
    reports_first: bool = False


EngineFactory = Callable[[Work], Engine]


class TaskQueue:
    """The tasks that are not started yet; indices in the order of the plan.

    Those with weights go first, heaviest first, so that none is left to run alone at the end.
    """

    def __init__(self, work: Work) -> None:
        self._weights, self._light_bytes = work.weights, work.light_bytes
        self._budget = work.budget_bytes
        heavy = sorted(self._weights, key=lambda index: -self._weights[index])
        self._heavy = collections.deque(heavy)
        self._light = collections.deque(index for index in work.tasks if index not in self._weights)
        self._retries: collections.deque[int] = collections.deque()

    def __len__(self) -> int:
        """The number of tasks that wait for their first try."""
        return len(self._heavy) + len(self._light)

    @property
    def is_empty(self) -> bool:
        """Whether nothing waits, not even a second try."""
        return not len(self) and not self._retries

    def drop(self) -> None:
        """Give up the tasks that wait for their first try."""
        self._heavy.clear()
        self._light.clear()

    def weight(self, index: int) -> int:
        return self._weights.get(index, self._light_bytes)

    def retry(self, index: int) -> None:
        """Add a task that was lost; it runs alone, after all others."""
        self._retries.append(index)

    def put_back(self, index: int, *, is_retry: bool = False) -> None:
        """Return a task that did not reach its worker; it is next again."""
        waiting = self._heavy if index in self._weights else self._light
        (self._retries if is_retry else waiting).appendleft(index)

    @property
    def is_next_exclusive(self) -> bool:
        """Whether the next task must run alone: no other fits beside it, or it was lost once,
        perhaps because memory ran out."""
        if not len(self):
            return bool(self._retries)
        if not self._heavy or self._budget is None:
            return False
        return self.weight(self._heavy[0]) + self._light_bytes > self._budget

    def pop_exclusive(self) -> int:
        return (self._heavy or self._retries).popleft()

    def pop(self, current: Iterable[int], idle_bytes: int) -> int | None:
        """Take a task that may run beside the ``current`` ones; None if none may start now.

        ``idle_bytes`` is the memory of idle workers.
        """
        queue = self._startable(current, idle_bytes)
        return queue.popleft() if queue else None

    def may_start(self, current: Iterable[int], idle_bytes: int) -> bool:
        return self._startable(current, idle_bytes) is not None

    def _startable(self, current: Iterable[int], idle_bytes: int) -> collections.deque[int] | None:
        running = list(current)
        used = idle_bytes + sum(map(self.weight, running))

        def fits(index: int) -> bool:
            # If nothing runs, any task may start: waiting would free no memory.
            return not running or self._budget is None or used + self.weight(index) <= self._budget

        if self._heavy and fits(self._heavy[0]):
            return self._heavy
        if self._heavy and not any(index in self._weights for index in running):
            # Only light tasks are in its way; if more of them started, it might wait for ever.
            return None
        return self._light if self._light and fits(self._light[0]) else None


def estimate_memory(
    tasks: Mapping[int, Task], settings: Settings, limits: Limits
) -> tuple[dict[int, int], int, int | None]:
    """The expected bytes of memory of each large task and of any other, and the budget of all
    current ones together (None if unknown).  A small file costs one stat."""

    def limited(n_bytes: int) -> int:
        return n_bytes if limits.memory_bytes is None else min(n_bytes, limits.memory_bytes)

    large: dict[int, int] = {}
    largest_light = 0
    # Small files are not looked into.  Most formats need less than 14 bytes per byte, and have more
    # than 24 bytes per face.
    per_byte = 14.0 + room.method_bytes_per_face(settings) / 24.0
    for index, task in tasks.items():
        if (size := room.input_bytes(task)) is None:
            # The file cannot be read, which its reader will report.
            continue
        if size < room.LARGE_BYTES:
            largest_light = max(largest_light, size)
        else:
            large[index] = limited(room.forecast(task, settings).memory_bytes or 0)
    light = limited(BASE_BYTES + int(per_byte * largest_light))
    available = available_bytes()
    # The rest is for what the forecasts miss, and for other programs.
    return large, light, None if available is None else int(0.8 * available)
