"""Carry out a plan for many files, record every finished file, and report what happens."""

from __future__ import annotations

import functools
import logging
import numbers
import os
import signal
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from msal_cli.batch import interrupts, schedule
from msal_cli.batch.plan import Plan, output_folders
from msal_cli.batch.schedule import EngineFactory, Finished, Message, OnEvent, Progress, Started
from msal_cli.codecs.header import BASE_BYTES
from msal_cli.errors import OutputError, UsageError
from msal_cli.job.pipeline import denoise_file, start_record
from msal_cli.job.records import MeshRecord
from msal_cli.job.room import foresee
from msal_cli.job.settings import NO_LIMITS, Limits, Settings
from msal_cli.light_dataclass import dataclass
from msal_cli.machine import megabytes, usable_cores
from msal_cli.storage.atomic import sweep
from msal_cli.storage.urls import is_url

if TYPE_CHECKING:
    from msal_cli.batch.manifest import Manifest
    from msal_cli.batch.resume import Journal
    from msal_cli.batch.workers import Denoise


_log = logging.getLogger("msal.batch")


def run(
    plan: Plan,
    settings: Settings,
    *,
    jobs: int | None = None,
    on_event: OnEvent | None = None,
    dry_run: bool = False,
    limits: Limits = NO_LIMITS,
    retries: int = 1,
    stop_after_failures: int | None = None,
    command: Sequence[str] = (),
    denoise: Denoise = denoise_file,
    engine: EngineFactory | None = None,
    cancellation: interrupts.Cancellation | None = None,
    manifests: Mapping[str, Manifest] | None = None,
) -> list[MeshRecord]:
    """Carry out a plan: one record per task, in its order; the same bytes for any number of jobs.

    Outputs of earlier runs that are still current are not made again (status ``up-to-date``), and
    files that failed by their own fault are not tried again.  A single task without limits of time
    and memory, a tile set and ``memory://`` objects run in this process, all else in supervised
    workers.

    Parameters
    ----------
    jobs : files at the same time; None is one per usable core, as far as memory allows: large
        files go first, and a file that fits beside no other runs alone on all cores.
    on_event : called in this thread with schedule.Started, Progress and Finished.
    dry_run : touch nothing; records are ``planned`` or ``up-to-date``.
    limits : what one file may use; beyond it the file fails with ``E_TIMEOUT`` or ``E_MEMORY``.
    retries : how often a file that was lost to a crash, memory or time is tried again, alone.
    stop_after_failures : start no more files after so many failures; the rest is ``planned``.
    command : the command line, for the manifests and the reports made of them.
    denoise : the module-level function that does one file; gets ``limits=`` if there are any.
    engine : processes the files, even a single one; None is ``workers.WorkerPool``.
    cancellation : lets another thread end the run.  A single file then runs in a worker, too, which
        can be killed at any time.
    manifests : of output folders that the caller has opened, and locked, for several runs.

    Raises
    ------
    UsageError : another run works on the output folder (``E_LOCKED``), a backup that differs from
        the file to be replaced is in the way, or the engine cannot be used; no file was touched.
    OutputError : the output folder or its manifest cannot be written.
    ResourceError : no worker process can be started.
    KeyboardInterrupt, interrupts.Terminated : a signal or ``cancellation`` asked to end; all
        workers are gone, finished files are whole and recorded, and running the plan again
        continues from there.
    """
    check_options(limits, jobs, retries, stop_after_failures)
    if limits != NO_LIMITS:
        denoise = functools.partial(denoise, limits=limits)
    options = (jobs, limits, retries, stop_after_failures, engine, cancellation)
    batch_run = _BatchRun(plan, settings, denoise, on_event or (lambda event: None), *options)
    if dry_run:
        return batch_run.dry_run()
    with ExitStack() as stack:
        return batch_run.execute(stack, manifests or {}, tuple(command))


@dataclass()
class _BatchRun:
    plan: Plan
    settings: Settings
    denoise: Denoise
    on_event: OnEvent
    jobs: int | None
    limits: Limits
    retries: int
    stop_after_failures: int | None
    engine: EngineFactory | None
    cancellation: interrupts.Cancellation | None

    def __post_init__(self) -> None:
        self._cores = usable_cores()
        # None if no output has a manifest.
        self._journal: Journal | None = None
        folders = self.plan.folders()
        self._local_folders = [folder for folder in folders if not is_url(folder)]
        if folders:
            from msal_cli.batch.resume import Journal

            self._journal = Journal(self.plan, self.settings, self._cores)
        self._records: dict[int, MeshRecord] = {}
        self._n_failed = 0
        # The first failure to record finished files.
        self._failure: OutputError | None = None

    def dry_run(self) -> list[MeshRecord]:
        """Records of what would be done; nothing is touched."""
        todo = list(range(len(self.plan.tasks)))
        with interrupts.catch_signals():
            if self._journal is not None:
                self._journal.read()
                todo = self._journal.find_outdated(self._emit_finished)[0]
            if self.plan.is_set and todo:
                from msal_cli.batch.tile_set import SetRun

                set_run = SetRun(self.plan.tasks, self.settings, limits=self.limits)
                records = set_run.survey()
            else:
                options = (self.settings, self.limits)
                records = {
                    index: foresee(self._planned_record(index), self.plan.tasks[index], *options)
                    for index in todo
                }
            for index, record in records.items():
                self._emit_finished(index, record)
        return self._in_order()

    def execute(
        self, stack: ExitStack, opened: Mapping[str, Manifest], command: tuple[str, ...]
    ) -> list[MeshRecord]:
        """Carry out the plan; ``stack`` releases locks and manifests, however this ends."""
        is_limited = (self.limits.timeout_s, self.limits.memory_bytes) != (None, None)
        is_alone = len(self.plan.tasks) == 1 and self.plan.shard is None
        is_single = is_alone and not (self.engine or is_limited or self.cancellation)
        try:
            with interrupts.catch_signals():
                folders = {*output_folders(self.plan.tasks), *map(Path, self._local_folders)}
                sweep(folders)
                todo = list(range(len(self.plan.tasks)))
                if self._journal is not None:
                    todo = self._journal.begin(stack, opened, command, self._emit_finished)
            if self.plan.is_set and todo:
                from msal_cli.batch.tile_set import SetRun

                set_run = SetRun(self.plan.tasks, self.settings, self.on_event, self.limits)
                with self._end_on_signals():
                    records = set_run.denoise(self.stop_after_failures)
                self._finish(records)
            elif is_single or self.plan.is_in_process:
                self._run_in_process(todo)
            elif todo:
                self._run_engine(todo)
            if self._failure is not None:
                raise self._failure
        except BaseException:
            # Why it ended matters more than a failure to record the end.
            with suppress(OutputError):
                if self._journal is not None:
                    self._journal.end(interrupted=True)
            raise
        if self._journal is not None:
            self._journal.end(interrupted=False)
        return self._in_order()

    # The work

    @contextmanager
    def _end_on_signals(self) -> Iterator[None]:
        """Let a signal end the run while this process itself denoises, even within a kernel."""

        def clean() -> None:
            sweep(output_folders(self.plan.tasks), os.getpid())

        with interrupts.catch_signals(), interrupts.end_if_late(clean):
            yield

    def _run_in_process(self, todo: list[int]) -> None:
        with self._end_on_signals():
            for index in todo:
                task = self.plan.tasks[index]
                self.on_event(Started(index))
                record = self.denoise(
                    task, self.settings, lambda *step: self.on_event(Progress(0, *step))
                )
                self._finish({index: record})
                if self._failure is not None:
                    return

    def _run_engine(self, todo: list[int]) -> None:
        from msal_cli.batch.workers import WorkerPool, denoise_in_worker

        received: list[int] = []
        tasks = {index: self.plan.tasks[index] for index in todo}
        with interrupts.catch_signals():
            weights, light_bytes, budget_bytes = schedule.estimate_memory(
                tasks, self.settings, self.limits
            )
        work = schedule.Work(
            tasks,
            denoise_in_worker,
            (self.denoise, self.settings),
            jobs=self.jobs or self._cores,
            cores=self._cores,
            folders=tuple(self._local_folders),
            on_death=lambda pid, index: sweep(output_folders([tasks[index]]), pid),
            on_loss=lambda index: self._journal.roll_back(index) if self._journal else "",
            limits=self.limits,
            retries=self.retries,
            weights=weights,
            light_bytes=light_bytes,
            # A number of jobs set by the user replaces the budget.
            budget_bytes=budget_bytes if self.jobs is None else None,
            reports_first=self.stop_after_failures is not None,
        )
        engine = (self.engine or WorkerPool)(work)

        def on_signal(signum: int) -> None:
            received.append(signum)
            engine.interrupt()

        cancelled = (self.cancellation or interrupts.Cancellation()).notify(engine.interrupt)
        with interrupts.catch_signals(on_signal), cancelled, closing(engine.batches()) as batches:
            try:
                for messages in batches:
                    self._handle_messages(messages)
                    # Tasks that have started are finished and reported.
                    max_failures = self.stop_after_failures
                    has_too_many_failures = (
                        max_failures is not None and self._n_failed >= max_failures
                    )
                    if self._failure is not None or has_too_many_failures:
                        engine.stop()
            except schedule.Interrupt:
                interrupts.raise_for(received[0] if received else signal.SIGINT)

    def _handle_messages(self, messages: list[Message]) -> None:
        finished: dict[int, MeshRecord] = {}
        for message in messages:
            if isinstance(message, Started | Progress):
                self.on_event(message)
            elif isinstance(message, schedule.Returned):
                record: MeshRecord = message.result
                if message.earlier:
                    which = "the second try" if self.retries == 1 else "a later try"
                    before = "at the first" if self.retries == 1 else "at the one before"
                    note = f"done at {which}: {message.earlier} {before}"
                    record = replace(record, warnings=(*record.warnings, note))
                finished[message.index] = record
            elif isinstance(message, schedule.Failed):
                # The task was lost outside of the pipeline, so it has no record yet.
                name = self.plan.tasks[message.index].input
                finished[message.index] = start_record(name, self.settings, error=message.failure)
            elif isinstance(message, schedule.Retried):
                name = self.plan.tasks[message.index].input
                _log.warning("%r: %s; it will be tried again", name, message.reason)
        self._finish(finished)

    # The results

    def _finish(self, finished: dict[int, MeshRecord]) -> None:
        """Record files in the manifests, then emit them, even where they could not be recorded."""
        finished = {n: _warn_of_memory(record, self.limits) for n, record in finished.items()}
        try:
            if self._journal is not None:
                self._journal.note_done(finished)
        except OutputError as error:
            self._failure = self._failure or error
        for index, record in finished.items():
            # Failures of earlier runs do not count for --max-failures.
            self._n_failed += record.status == "failed"
            self._emit_finished(index, record)

    def _emit_finished(self, index: int, record: MeshRecord) -> None:
        self._records[index] = record
        self.on_event(Finished(index, record))

    def _in_order(self) -> list[MeshRecord]:
        indices = range(len(self.plan.tasks))
        return [self._records.get(index) or self._planned_record(index) for index in indices]

    def _planned_record(self, index: int) -> MeshRecord:
        task = self.plan.tasks[index]
        return start_record(task.input, self.settings, status="planned", output=task.output)


def _warn_of_memory(record: MeshRecord, limits: Limits) -> MeshRecord:
    """The record, with a warning if more memory was used than the limit."""
    limit, peak = limits.memory_bytes, record.peak_memory_bytes
    if limit is None or peak is None or peak <= limit:
        return record
    note = f"{megabytes(peak)} of memory were used, more than --memory-limit {megabytes(limit)}"
    return replace(record, warnings=(*record.warnings, note))


def check_options(
    limits: Limits,
    jobs: int | None = None,
    retries: int = 1,
    stop_after_failures: int | None = None,
) -> None:
    """Raise UsageError for limits that are too small for any file, and for invalid numbers."""
    given = {"timeout": limits.timeout_s, "memory_limit": limits.memory_bytes, "jobs": jobs}
    given |= {"retries": retries, "max_failures": stop_after_failures}
    minimums = {"jobs": 1, "retries": 0, "max_failures": 1}
    for name, value in given.items():
        if not isinstance(value, numbers.Real | None):
            raise UsageError(
                f"{name} is {value!r}, and must be a number",
                hint="a timeout is in seconds, a memory limit in bytes",
            )
        if value is not None and value < minimums.get(name, value):
            raise UsageError(f"{name} is {value}, and must be at least {minimums[name]}")
    if limits.timeout_s is not None and not limits.timeout_s > 0.0:
        raise UsageError(f"a file cannot be done within {limits.timeout_s:g} s")
    if limits.memory_bytes is not None and limits.memory_bytes < BASE_BYTES:
        raise UsageError(
            f"a memory limit of {limits.memory_bytes / 1e6:g} MB is not enough for any file",
            hint=f"msal itself takes {BASE_BYTES / 1e6:.0f} MB",
        )
