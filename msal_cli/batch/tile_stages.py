"""The stages of a run by tiles, one after another, by this process alone or by several together."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from msal_cli import machine
from msal_cli.batch import interrupts
from msal_cli.batch.engine import Interrupt
from msal_cli.batch.events import Failed, Returned
from msal_cli.batch.tile_claims import claim_reduction, run_claimed_task
from msal_cli.batch.tile_progress import TileProgress
from msal_cli.batch.tile_tasks import TileEngine, TileResult
from msal_cli.batch.unfinished import LOSS_CODES
from msal_cli.errors import InternalError, MsalError, ResourceError
from msal_cli.tiles import stages
from msal_cli.tiles.plan import PLAN

if TYPE_CHECKING:
    from msal_cli.batch.tile_options import TileJob
    from msal_cli.tiles.scratch import Scratch
    from msal_cli.tiles.stages import Stage

LOOKS_EVERY_S = 0.2
"""How often it is looked whether other processes have finished what they are at."""

_SECONDS_OF = {
    "open": "read",
    "count": "read",
    "number": "read",
    "faces": "read",
    "weld": "connectivity",
    "choose": "choose",
    "rim": "connectivity",
    "values": "read",
    "pins": "connectivity",
    "prepare": "connectivity",
    "wind": "connectivity",
    "turn": "connectivity",
    "denoise": "sweeps",
    "join": "write",
}
"""Which seconds of a record those of each stage are."""

_log = logging.getLogger("msal.batch")


class StageRunner:
    """Runs the stages that are left, and keeps account of time and memory.

    Parameters
    ----------
    name : of the input, for messages.
    job : what it may use; with a shard, other processes take tasks of the same folder.
    """

    def __init__(self, name: str, job: TileJob) -> None:
        self._name, self._job = name, job
        self._started = time.perf_counter()
        self._received: list[int] = []
        self._peaks: dict[int, int] = {}
        self.seconds: dict[str, float] = {}

    def run(
        self, scratch: Scratch, jobs: int, next_stage: Callable[[Scratch], Stage | None]
    ) -> None:
        """Run stages until ``next_stage`` gives none.

        Raises
        ------
        MsalError
            of the first task that fails, in the order of the file.
        KeyboardInterrupt
            where a signal or another thread asked to end; what is finished is kept.
        """
        job = self._job
        cores = machine.usable_cores()
        engine = TileEngine(jobs=jobs, cores=cores, retries=job.retries, factory=job.engine)
        if job.shard is not None:
            engine.function = run_claimed_task
        cancellation = job.cancellation or interrupts.Cancellation()
        progress = TileProgress(scratch, job.on_progress)

        def on_signal(signum: int) -> None:
            self._received.append(signum)
            engine.interrupt()

        try:
            while (stage := next_stage(scratch)) is not None:
                cancellation.check()
                if stage.todo:
                    with (
                        interrupts.noticed(on_signal),
                        cancellation.noticed(engine.interrupt),
                        self._timed(stage.name),
                    ):
                        self._run_tasks(engine, scratch, stage, progress)
                with self.leading(stage.name):
                    self._reduce(scratch, stage.name)
        except (Interrupt, KeyboardInterrupt) as end:
            _log.warning(
                "%s: finished tasks are kept in %r; the same command goes on from there",
                self._name,
                str(scratch.path),
            )
            if isinstance(end, KeyboardInterrupt):
                raise
            interrupts.raise_for(self._received[0] if self._received else signal.SIGINT)
        finally:
            engine.close()

    def _run_tasks(
        self, engine: TileEngine, scratch: Scratch, stage: Stage, progress: TileProgress
    ) -> None:
        """Run all tasks of a stage that are left, or wait for those that others are at."""
        todo = stage.todo
        if self._job.shard is not None:
            # Each process begins at another place.
            at = len(todo) * (self._job.shard.number - 1) // self._job.shard.count
            todo = todo[at:] + todo[:at]
        self._run_once(engine, scratch, replace(stage, todo=todo), progress)
        while self._job.shard is not None:
            finished = scratch.finished(stage.name)
            left = [index for index in stage.todo if index not in finished]
            if not left:
                return
            self._wait(scratch)
            self._run_once(engine, scratch, replace(stage, todo=left), progress)

    def _run_once(
        self, engine: TileEngine, scratch: Scratch, stage: Stage, progress: TileProgress
    ) -> None:
        failures: dict[int, MsalError] = {}
        progress.begin(stage)
        for message in engine.run(str(scratch.path), stage.name, stage.todo):
            if isinstance(message, Returned):
                result: TileResult = message.result
                self._peaks[result.pid] = max(self._peaks.get(result.pid, 0), result.peak_bytes)
                if result.error is not None:
                    failures[message.index] = result.error
            else:
                failures[message.index] = _failure_of(message)
            if failures:
                engine.stop()
            else:
                progress.step()
                self._check_time()
        if failures:
            # The first in the file, however many tasks ran at the same time.
            raise failures[min(failures)]

    def _reduce(self, scratch: Scratch, stage: str) -> None:
        if self._job.shard is None:
            stages.reduce_stage(scratch, stage)
            return
        while scratch.stage_result(stage) is None:
            with claim_reduction(scratch, stage) as is_mine:
                if is_mine:
                    stages.reduce_stage(scratch, stage)
                    return
            self._wait(scratch)

    def _wait(self, scratch: Scratch) -> None:
        time.sleep(LOOKS_EVERY_S)
        if not scratch.has(PLAN):
            raise ResourceError(f"the scratch folder {str(scratch.path)!r} was removed")
        self._check_time()
        if self._received:
            raise Interrupt

    def _check_time(self) -> None:
        limit = self._job.limits.timeout_s
        if limit is not None and time.perf_counter() - self._started > limit:
            raise ResourceError(
                f"it was not done within {limit:g} s",
                code="E_TIMEOUT",
                hint="finished tasks are kept: the same command goes on from there; or raise "
                "--timeout",
            )

    # Seconds and memory

    @contextmanager
    def leading(self, stage: str) -> Iterator[None]:
        """What this process does itself: signals end it, and it is counted as part of a stage."""
        with (
            interrupts.noticed(interrupts.raise_for),
            interrupts.ended_late(lambda: None),
            self._timed(stage),
        ):
            yield

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        started = time.perf_counter()
        try:
            yield
        finally:
            name = _SECONDS_OF[stage.partition("-")[0]]
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - started

    @property
    def total_seconds(self) -> float:
        """Seconds since it was made."""
        return time.perf_counter() - self._started

    def peak_bytes(self, jobs: int) -> int | None:
        """Memory of this process and of ``jobs`` workers at their peaks."""
        own = machine.peak_bytes()
        workers = sorted(self._peaks.values(), reverse=True)[:jobs]
        return None if own is None else own + sum(workers)


def _failure_of(message: Failed) -> MsalError:
    if message.cause == "exception":
        return InternalError(message.reason, hint=message.hint)
    return ResourceError(
        message.reason,
        code=LOSS_CODES[message.cause],
        hint=f"{message.hint}; finished tasks are kept, and the same command goes on from there",
    )
