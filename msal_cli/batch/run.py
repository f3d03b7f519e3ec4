"""Many files: carry out a plan, note every finished file, and tell what happens."""

from __future__ import annotations

import functools
import logging
import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from msal_cli import __version__
from msal_cli.batch import (
    interrupts as signals,
)
from msal_cli.batch import (
    manifest_dirs as homes,
)
from msal_cli.batch import (
    temporary_files as temporaries,
)
from msal_cli.batch.events import Finished, Progress, Started
from msal_cli.batch.manifest import FileMark, Manifest, done, intent, settings_hash
from msal_cli.batch.memory_budget import Weights, weighed
from msal_cli.batch.plan import Plan
from msal_cli.batch.resume import restore, standings, undone
from msal_cli.batch.run_history import RunNote
from msal_cli.errors import OutputError, UsageError
from msal_cli.job.pipeline import denoise_file
from msal_cli.job.records import Failure, MeshRecord, MethodUsed
from msal_cli.job.settings import FORECAST, NO_LIMITS, Limits, Settings, Task, least_memory_bytes
from msal_cli.machine import usable_cores

if TYPE_CHECKING:
    from msal_cli.batch.engine import EngineFor
    from msal_cli.batch.events import OnEvent
    from msal_cli.batch.worker_messages import Message

    OnProgress = Callable[[str, int, int], None]
    Denoise = Callable[..., MeshRecord]

LOSS_CODES = {
    "crash": "E_CRASH",
    "memory": "E_MEMORY",
    "timeout": "E_TIMEOUT",
    "exception": "E_INTERNAL",
    "changed": "E_CHANGED",
}
"""The code of a failure by the cause of a ``messages.Lost``."""

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
    engine: EngineFor | None = None,
) -> list[MeshRecord]:
    """One record per task, in the plan's order; the same bytes for any number of jobs.

    What an earlier run has written and is still current is not done again (status
    ``up-to-date``), and neither is what failed through its own fault and would fail again.  A plan
    of one task without limits of time and memory runs in this process, others, and parts of a plan,
    in supervised workers.

    Parameters
    ----------
    jobs : files at the same time; None is one per usable core, as far as memory allows: large
        files go first, and one that fits beside no other runs alone on all cores.
    on_event : called in this thread with events.Started, Progress and Finished.
    dry_run : touch nothing; records are ``planned`` or ``up-to-date``.
    limits : what one file may take; beyond it the file fails with ``E_TIMEOUT``, ``E_MEMORY`` or
        ``E_TOO_LARGE``.
    retries : how often a file that was lost to a crash, memory or time is tried again, alone.
    stop_after_failures : hand out no more files once so many have failed; the rest is ``planned``.
    command : how the run was called, for the manifests and the reports made of them.
    denoise : what does one file, a module-level function; takes ``limits=`` where there are any.
    engine : hands out the files, a single one too; None is ``engine.crew_for``.

    Raises
    ------
    UsageError : another run works on the output folder (``E_LOCKED``), a backup that differs from
        the file to be replaced is in the way, or the engine cannot be used; no file was touched.
    OutputError : the output folder or its manifest cannot be written.
    ResourceError : no worker process can be started.
    KeyboardInterrupt, signals.Terminated : a signal asked to end; all workers are gone, finished
        files are whole and noted, and running the plan again goes on from there.
    """
    if jobs is not None and jobs < 1:
        raise UsageError(f"the number of jobs must be at least 1, not {jobs}")
    if stop_after_failures is not None and stop_after_failures < 1:
        raise UsageError(
            f"the number of failures to stop after must be at least 1, not {stop_after_failures}"
        )
    if retries < 0:
        raise UsageError(f"the number of retries must be at least 0, not {retries}")
    check_limits(limits)
    if limits != NO_LIMITS:
        denoise = functools.partial(denoise, limits=limits)
    with ExitStack() as stack:
        one = _Run(plan, settings, jobs, on_event or (lambda event: None), denoise)
        one.stop_after_failures = stop_after_failures
        one.engine = engine
        one.command = tuple(command)
        one.limits, one.retries = limits, retries
        return one.rehearsed() if dry_run else one.performed(stack)


class _Run:
    def __init__(
        self,
        plan: Plan,
        settings: Settings,
        jobs: int | None,
        on_event: OnEvent,
        denoise: Denoise,
    ) -> None:
        self.stop_after_failures: int | None = None
        self.engine: EngineFor | None = None
        self.command: tuple[str, ...] = ()
        self.limits = NO_LIMITS
        self.retries = 1
        self._plan = plan
        self._settings = settings
        self._cores = usable_cores()
        self._jobs = jobs
        self._on_event = on_event
        self._denoise = denoise
        self._hash = settings_hash(settings)
        self._homes = plan.folders()
        self._manifests: dict[str, Manifest] = {}
        # Those that the start of this run is noted in.
        self._begun: list[Manifest] = []
        self._records: dict[int, MeshRecord] = {}
        self._n_failed = 0
        # Why what was done cannot be noted.
        self._failure: OutputError | None = None
        self._marks: dict[int, FileMark | None] = {}

    def rehearsed(self) -> list[MeshRecord]:
        """What would happen, with nothing touched."""
        with signals.noticed(signals.raise_for):
            self._manifests = {home: homes.manifest_of(home) for home in self._homes}
            for index in self._unsettled():
                self._settle(index, self._planned(index))
        return self._in_order()

    def performed(self, stack: ExitStack) -> list[MeshRecord]:
        """What happened; ``stack`` lets go of locks and manifests, however this ends."""
        note = RunNote.now(self._plan, self._settings, self.command)
        try:
            with signals.noticed(signals.raise_for):
                todo = self._prepared(stack, note)
                weights = self._weighed(todo)
            todo = self._possible(todo, weights)
            if self._is_single() or self._plan.stays_here:
                self._work_here(todo)
            elif todo and self._failure is None and not self._is_given_up():
                self._work_elsewhere(todo, weights)
            if self._failure is not None:
                raise self._failure
        except BaseException:
            # Why it ended matters more than that it cannot be noted.
            with suppress(OutputError):
                self._note_end(note, interrupted=True)
            raise
        self._note_end(note, interrupted=False)
        return self._in_order()

    def _is_single(self) -> bool:
        is_part = self._plan.shard is not None
        is_limited = (self.limits.timeout_s, self.limits.memory_bytes) != (None, None)
        is_alone = len(self._plan.tasks) == 1 and not is_part
        return is_alone and self.engine is None and not is_limited

    def _note_end(self, note: RunNote, *, interrupted: bool) -> None:
        for manifest in self._begun:
            manifest.append([note.end(interrupted=interrupted)])

    def _prepared(self, stack: ExitStack, note: RunNote) -> list[int]:
        """Take hold of the folders, settle what is current; the indices of what is to be done."""
        shard = self._plan.shard
        for home in self._homes:
            homes.hold(home, stack, shard)
            manifest = homes.manifest_of(home, shard)
            stack.callback(manifest.close)
            self._manifests[home] = manifest
        temporaries.sweep(homes.folders(self._plan.tasks, self._homes))
        restored: list[Task] = []
        todo = self._unsettled(restored)
        for manifest in self._manifests.values():
            manifest.open()
            manifest.append([note.line()])
            self._begun.append(manifest)
        for task in restored:
            restore(task)
        tasks = self._plan.tasks
        self._note(
            (index, intent(key, tasks[index].input, tasks[index].output))
            for index, key in self._keys(todo)
        )
        for index in todo:
            if self._plan.tasks[index].in_place:
                self._marks[index] = FileMark.of(self._plan.tasks[index].input)
        return todo

    # What is to be done

    def _unsettled(self, restored: list[Task] | None = None) -> list[int]:
        """Settle what is current already; the indices of the rest."""
        todo: list[int] = []
        obstacles: list[str] = []
        with closing(
            standings(self._plan, self._manifests, self._hash, threads=self._cores)
        ) as everything:
            for one in everything:
                if one.objection:
                    obstacles.append(one.objection)
                elif one.record is not None:
                    self._settle(one.index, one.record)
                else:
                    todo.append(one.index)
                    if one.restores and restored is not None:
                        restored.append(self._plan.tasks[one.index])
        if obstacles:
            more = f" and {len(obstacles) - 1} more" if len(obstacles) > 1 else ""
            raise UsageError(
                f"the backup {obstacles[0]!r}{more} exists and is not the file to be replaced",
                hint="the original is in it: move it back, or choose another --backup suffix",
                path=obstacles[0],
            )
        return todo

    def _keys(self, indices: Iterable[int]) -> list[tuple[int, str]]:
        homes = self._plan.homes
        return [(index, self._plan.key(index)) for index in indices if homes[index] is not None]

    # The work

    def _work_here(self, todo: list[int]) -> None:
        def clean() -> None:
            for index in todo:
                self._clear_away(os.getpid(), index)

        with signals.noticed(signals.raise_for), signals.ended_late(clean):
            for index in todo:
                task = self._plan.tasks[index]
                self._on_event(Started(index, task))
                try:
                    record = self._denoise(
                        task,
                        self._settings,
                        lambda stage, n, total: self._on_event(Progress(0, stage, n, total)),
                    )
                except Exception as error:
                    _log.exception("internal error at %r", task.input)
                    record = self._lost(index, "exception", f"{type(error).__name__}: {error}")
                self._finish([(index, record)])
                if self._failure is not None:
                    return

    def _weighed(self, todo: list[int]) -> Weights:
        tasks = {index: self._plan.tasks[index] for index in todo}
        return weighed(tasks, self._settings, self.limits)

    def _possible(self, todo: list[int], weights: Weights) -> list[int]:
        """The files for which there is memory; the others fail before they are loaded.

        Whoever sets a limit has thought of the memory, and other machines have their own.
        """
        if self.engine is not None or self.limits.memory_bytes is not None:
            return todo
        beyond = weights.beyond()
        for index, failure in beyond.items():
            self._on_event(Started(index, self._plan.tasks[index]))
            record = replace(self._planned(index), output=None, status="failed", error=failure)
            self._finish([(index, record)])
        return [index for index in todo if index not in beyond]

    def _work_elsewhere(self, todo: list[int], weights: Weights) -> None:
        from msal_cli.batch.engine import Work, crew_for
        from msal_cli.batch.worker_pool import Interrupt

        received: list[int] = []
        tasks = {index: self._plan.tasks[index] for index in todo}
        work = Work(
            tasks,
            do_one,
            (self._denoise, self._settings),
            jobs=self._jobs or self._cores,
            cores=self._cores,
            folders=tuple(str(one) for one in homes.folders((), self._homes)),
            on_death=self._clear_away,
            on_loss=self._set_right,
            limits=self.limits,
            retries=self.retries,
            weights={index: one for index, one in weights.large.items() if index in tasks},
            light_bytes=weights.light,
            # Whoever says how many files at once has thought of the memory.
            budget_bytes=weights.budget if self._jobs is None else None,
            tells_first=self.stop_after_failures is not None,
        )
        engine = (self.engine or crew_for)(work)

        def on_signal(signum: int) -> None:
            received.append(signum)
            engine.interrupt()

        with signals.noticed(on_signal), closing(engine.batches()) as batches:
            try:
                for messages in batches:
                    self._hear(messages)
                    # What the workers have begun they finish, and that is reported, too.
                    if self._failure is not None or self._is_given_up():
                        engine.stop()
            except Interrupt:
                signals.raise_for(received[0])

    def _hear(self, messages: list[Message]) -> None:
        from msal_cli.batch.worker_messages import Advanced, Again, Began, Lost, Returned

        finished: list[tuple[int, MeshRecord]] = []
        for message in messages:
            index = message.index
            if isinstance(message, Began):
                self._on_event(Started(index, self._plan.tasks[index]))
            elif isinstance(message, Advanced):
                self._on_event(Progress(index, message.stage, message.done, message.total))
            elif isinstance(message, Returned):
                record: MeshRecord = message.result
                if message.earlier:
                    which = "the second try" if self.retries == 1 else "a later try"
                    before = "at the first" if self.retries == 1 else "at the one before"
                    note = f"done at {which}: {message.earlier} {before}"
                    record = replace(record, warnings=(*record.warnings, note))
                finished.append((index, record))
            elif isinstance(message, Lost):
                lost = self._lost(index, message.cause, message.reason, message.hint)
                finished.append((index, lost))
            elif isinstance(message, Again):
                name = self._plan.tasks[index].input
                _log.warning("%r: %s; it will be tried again", name, message.reason)
        self._finish(finished)

    def _is_given_up(self) -> bool:
        return self.stop_after_failures is not None and self._n_failed >= self.stop_after_failures

    # What came of it

    def _finish(self, finished: list[tuple[int, MeshRecord]]) -> None:
        """Note files in the manifests, then report, also what could not be noted."""
        records, tasks = dict(finished), self._plan.tasks
        try:
            self._note(
                (
                    index,
                    done(key, self._hash, records[index], tasks[index].input, tasks[index].output),
                )
                for index, key in self._keys(records)
            )
        except OutputError as error:
            self._failure = self._failure or error
        for index, record in finished:
            # What an earlier run has failed at is no reason to give up this one.
            self._n_failed += record.status == "failed"
            self._settle(index, record)

    def _note(self, lines: Iterable[tuple[int, dict[str, Any]]]) -> None:
        by_home: dict[str, list[dict[str, Any]]] = {}
        for index, line in lines:
            by_home.setdefault(str(self._plan.homes[index]), []).append(line)
        for home, some in by_home.items():
            self._manifests[home].append(some)

    def _settle(self, index: int, record: MeshRecord) -> None:
        self._records[index] = record
        self._on_event(Finished(index, record))

    def _in_order(self) -> list[MeshRecord]:
        return [
            self._records.get(index) or self._planned(index)
            for index in range(len(self._plan.tasks))
        ]

    def _planned(self, index: int) -> MeshRecord:
        task = self._plan.tasks[index]
        return MeshRecord(
            input=task.input,
            output=task.output,
            status="planned",
            version=__version__,
            method=MethodUsed(self._settings.method, dict(self._settings.parameters)),
        )

    def _lost(self, index: int, cause: str, reason: str, hint: str = "") -> MeshRecord:
        failure = Failure(LOSS_CODES[cause], reason, hint)
        return replace(self._planned(index), output=None, status="failed", error=failure)

    def _set_right(self, index: int) -> str:
        """Undo what a lost worker did in place; why the file must not be tried again, if so."""
        try:
            return undone(self._plan.tasks[index], self._marks.get(index))
        except OutputError as error:
            return error.message

    def _clear_away(self, pid: int, index: int) -> None:
        for folder in homes.folders([self._plan.tasks[index]]):
            temporaries.sweep_after(pid, folder)


def do_one(task: Task, common: tuple[Denoise, Settings], on_progress: OnProgress) -> MeshRecord:
    """One file, in a worker.  Memory that ran out is raised again, so that the file gets its
    second try alone and the worker, whose heap is in pieces, is replaced.  Memory that was foreseen
    to run out would do so again."""
    denoise, settings = common
    record = denoise(task, settings, on_progress)
    error = record.error
    if error is not None and error.code == "E_MEMORY" and error.where != FORECAST:
        raise MemoryError(error.message)
    return record


def check_limits(limits: Limits) -> None:
    """Refuse limits within which no file can be denoised; UsageError."""
    if limits.timeout_s is not None and not limits.timeout_s > 0.0:
        raise UsageError(f"a file cannot be done within {limits.timeout_s:g} s")
    if limits.max_faces is not None and limits.max_faces < 1:
        raise UsageError(f"no file has {limits.max_faces} faces at most")
    least = least_memory_bytes()
    if limits.memory_bytes is not None and limits.memory_bytes < least:
        raise UsageError(
            f"a memory limit of {limits.memory_bytes / 1e6:.0f} MB is not enough for any file",
            hint=f"msal itself takes {least / 1e6:.0f} MB",
        )
