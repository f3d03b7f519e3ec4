"""The tasks of a run by tiles in worker processes or on a cluster, one stage after another."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from msal_cli import machine
from msal_cli.batch.engine import Work
from msal_cli.batch.events import Failed, Message, Returned, Started
from msal_cli.batch.worker_pool import WorkerPool
from msal_cli.errors import MsalError
from msal_cli.tiles.stages import run_task

if TYPE_CHECKING:
    from msal_cli.batch.engine import Engine, EngineFactory


@dataclass(frozen=True)
class TileTask:
    """A task of ``tiles.stages``; engines know it by its scratch folder, which is no file in
    place."""

    scratch: str
    stage: str
    index: int
    in_place: bool = False

    @property
    def input(self) -> str:
        """What it reads."""
        return self.scratch

    @property
    def output(self) -> str:
        """A name in the folder that it writes to."""
        return os.path.join(self.scratch, self.stage)


@dataclass(frozen=True)
class TileResult:
    """What became of a task: an error, or None; seconds; process, and its memory at the peak."""

    error: MsalError | None
    seconds: float
    pid: int
    peak_bytes: int


def run_tile_task(task: TileTask, common: object, on_progress: object) -> TileResult:
    """Run one task in a worker.  MemoryError is raised, so that it gets its second try alone."""
    started = time.perf_counter()
    error: MsalError | None = None
    try:
        run_task((task.scratch, task.stage, task.index))
    except MsalError as failure:
        if machine.is_want_of_memory(failure):
            raise MemoryError(failure.message) from failure
        error = failure
    seconds = time.perf_counter() - started
    return TileResult(error, seconds, os.getpid(), machine.peak_bytes() or 0)


class TileEngine:
    """Runs the tasks of one stage after another.

    Worker processes stay from stage to stage.

    Parameters
    ----------
    jobs, cores : tasks at the same time, and cores that they share.
    retries : how often a task is tried again whose worker was lost.
    factory : makes the engine; None is that of worker processes.
    """

    def __init__(
        self, *, jobs: int, cores: int, retries: int, factory: EngineFactory | None = None
    ) -> None:
        self._jobs, self._cores, self._retries = jobs, cores, retries
        self._factory = factory
        self._engine: Engine | None = None
        self._batches: Generator[list[Message], None, None] | None = None
        self._n_tasks = 0
        self._is_stopped = False
        # What workers call.
        self.function: Callable[..., TileResult] = run_tile_task

    def run(self, scratch: str, stage: str, indices: list[int]) -> Iterator[Returned | Failed]:
        """Run tasks of a stage, and give the outcome of each; ``index`` is that of the task.

        Raises
        ------
        engine.Interrupt, ResourceError
            see ``engine.Engine.batches``.
        """
        first = self._n_tasks
        tasks = {first + at: TileTask(scratch, stage, index) for at, index in enumerate(indices)}
        self._n_tasks += len(tasks)
        self._begin(tasks, scratch)
        assert self._batches is not None
        waiting = len(tasks)
        begun: set[int] = set()
        for messages in self._batches:
            for message in messages:
                if isinstance(message, Started):
                    begun.add(message.index)
                elif isinstance(message, Returned | Failed):
                    begun.discard(message.index)
                    waiting -= 1
                    index = indices[message.index - first]
                    if isinstance(message, Returned):
                        yield Returned(index, message.result, message.earlier)
                    else:
                        yield Failed(index, message.cause, message.reason, message.hint)
            if not waiting or (self._is_stopped and not begun):
                return

    def _begin(self, tasks: dict[int, TileTask], scratch: str) -> None:
        if self._engine is not None:
            self._engine.add(tasks)
            return
        work = Work(
            tasks,
            self.function,
            None,
            jobs=self._jobs,
            cores=self._cores,
            folders=(scratch,),
            retries=self._retries,
            # Tasks that weigh something are handed out singly.
            weights=dict.fromkeys(tasks, 1),
            stays=True,
        )
        self._engine = (self._factory or WorkerPool)(work)
        self._batches = self._engine.batches()

    def stop(self) -> None:
        """Begin no more tasks of this stage; those that were begun are finished."""
        self._is_stopped = True
        if self._engine is not None:
            self._engine.stop()

    def interrupt(self) -> None:
        """Give up all tasks; ``run`` raises ``engine.Interrupt``.  For signal handlers."""
        if self._engine is not None:
            self._engine.interrupt()

    def close(self) -> None:
        """End all workers."""
        if self._batches is not None:
            self._batches.close()
        self._engine = self._batches = None
