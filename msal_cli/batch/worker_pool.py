"""Supervised worker processes: whatever happens to one of them costs the file in its hand.

Every worker is a fresh interpreter with one task at a time.  Two threads of the parent listen to
each (one to its answers, one to what it prints) and put what they hear into one queue; all
decisions are made in the thread that iterates.  No signal of the terminal reaches a worker, and a
worker ends when its pipe does, so none outlives the parent.
"""

from __future__ import annotations

import contextlib
import logging
import math
import os
import queue
import re
import subprocess
import time
from collections.abc import Callable, Generator
from typing import Any

from msal_cli.batch import worker_process
from msal_cli.batch.process_status import ending, is_near_memory_limit
from msal_cli.batch.schedule import Schedule
from msal_cli.batch.worker import Assignment
from msal_cli.batch.worker_messages import Advanced, Again, Began, Lost, Message, Returned
from msal_cli.batch.worker_process import Heard, WorkerProcess
from msal_cli.errors import ResourceError
from msal_cli.job.settings import NO_LIMITS, Limits
from msal_cli.machine import oom_kills

_FALSE_STARTS = 3
_GONE_WITHIN_S = 2.0

# Libraries may come from a network disk that everybody reads at once, but not for ever.
_READY_WITHIN_S = 600.0

# A process that does not end so long after it was killed sits in the kernel, on a dead disk.
_ENDS_WITHIN_S = 10.0

_BETWEEN_LOOKS_S = 0.1
_WANT_OF_MEMORY = re.compile(
    r"bad_alloc|out of memory|cannot allocate memory|failed to map segment|MemoryError|"
    r"memory allocation",
    re.IGNORECASE,
)

_STUCK = "the worker does not even end when it is killed; look at the disks that it works on"

_log = logging.getLogger("msal.batch")


class Interrupt(Exception):  # noqa: N818 - it is a message, not a fault
    """Raised by ``Crew.batches`` after ``Crew.interrupt``, when all workers are gone."""


class Crew:
    """Does many tasks in worker processes.

    Parameters
    ----------
    tasks : the tasks by index; any picklable values.
    function : module-level; called in a worker as ``function(task, common, on_progress)``.
    common : picklable second argument of every call.
    jobs : workers at the same time.
    cores : cores to share; each worker is told its part in the environment (``MSAL_THREADS``).
    limits : seconds that a task may take, and memory that a worker may hold.
    schedule : the order of the tasks and who may run beside whom; as they come by default.
    files_per_worker : a worker is replaced after so many tasks.
    growth_bytes : ... or once it holds so much more memory than after its first task.
    on_death : called with the process id of every worker that has ended and the index of the task
        that it had in hand, to clear away what it left.
    on_loss : called with the index of a task that was lost, before it is tried again or given up;
        returns why it cannot be, or an empty string.
    tells_first : results are told before the next tasks are handed out, so that ``stop`` is in
        time for these.
    stays : when all is done the workers wait for what ``add`` brings, until ``interrupt``.
    """

    def __init__(
        self,
        tasks: dict[int, Any],
        function: Callable[..., Any],
        common: Any,
        *,
        jobs: int,
        cores: int,
        limits: Limits = NO_LIMITS,
        schedule: Schedule | None = None,
        files_per_worker: int = 1000,
        growth_bytes: int = 512 << 20,
        on_death: Callable[[int, int], None] = lambda pid, index: None,
        on_loss: Callable[[int], str] = lambda index: "",
        tells_first: bool = False,
        stays: bool = False,
    ) -> None:
        self._tasks = tasks
        self._stays = stays
        self._assignment = Assignment(
            function, common, _log.getEffectiveLevel(), limits.memory_bytes
        )
        self._jobs = max(1, min(jobs, len(tasks)))
        self._cores = cores
        self._limits = limits
        self._files_per_worker = files_per_worker
        self._growth_bytes = growth_bytes
        self._on_death = on_death
        self._on_loss = on_loss
        self._tells_first = tells_first
        self._schedule = Schedule(tasks) if schedule is None else schedule
        self._earlier: dict[int, str] = {}
        self._warnings: set[tuple[str, str]] = set()
        self._workers: list[WorkerProcess] = []
        self._heard: Heard = queue.SimpleQueue()
        self._false_starts = 0

    def stop(self) -> None:
        """Hand out no task that was not begun; those in hand, and second tries, go on."""
        self._schedule.drop()

    def add(self, tasks: dict[int, Any]) -> None:
        """Bring more tasks to a crew that stays; may be called from another thread."""
        self._heard.put((None, ("more", tasks)))

    def interrupt(self) -> None:
        """Give up what is in hand and end; may be called from a signal handler."""
        self._heard.put((None, ()))

    def batches(self) -> Generator[list[Message], None, None]:
        """What happens, in the order in which it is heard; each list is all that was there.

        A task whose worker dies is tried again after all others, alone, in a fresh worker.
        Workers are gone when the iteration ends, however it ends.

        Raises
        ------
        Interrupt : after ``interrupt``; results that had arrived until then were given before.
        ResourceError : no worker can be started.
        """
        try:
            messages = self._staffed()
            while True:
                if messages:
                    yield messages
                if not (self._stays or self._has_work()):
                    return
                messages, is_interrupted = [], False
                for worker, message in self._all_heard():
                    if worker is None and message:
                        self._take(message[1])
                    elif worker is None:
                        is_interrupted = True
                    else:
                        messages += self._understood(worker, message)
                if is_interrupted:
                    yield messages + self._last_messages()
                    raise Interrupt
                messages += self._looked_after()
                if messages and self._tells_first:
                    yield messages
                    messages = []
                # The next tasks go out before anybody deals with the last results.
                messages += self._staffed()
        finally:
            self._end()

    # Handing out

    def _take(self, tasks: dict[int, Any]) -> None:
        if self._has_work():
            self._tasks = self._tasks | tasks
        else:
            # Nothing that is done with is kept, so that a crew can stay for ever.
            self._tasks = tasks
            self._earlier.clear()
            self._schedule.forget()
        self._schedule.extend(tasks)

    def _has_work(self) -> bool:
        return self._is_busy() or not self._schedule.is_empty

    def _is_busy(self) -> bool:
        return any(worker.in_hand is not None for worker in self._workers)

    def _staff(self) -> list[WorkerProcess]:
        return [worker for worker in self._workers if not worker.is_dismissed]

    def _staffed(self) -> list[Message]:
        """Give tasks to the idle and start workers for the rest."""
        if self._schedule.is_next_alone:
            return [] if self._is_busy() else self._staffed_alone()
        cores = max(1, self._cores // self._jobs)
        began: list[Message] = []
        for worker in self._staff():
            if worker.cores != cores and len(self._schedule):
                # It had the machine for itself, with a thread for every core.
                if worker.in_hand is None:
                    worker.dismiss()
            elif worker.is_ready and worker.in_hand is None:
                index = self._schedule.taken(*self._burden(worker))
                began += [] if index is None else self._given(worker, index)
        n_free = sum(worker.in_hand is None for worker in self._staff())
        while (
            len(self._staff()) < self._jobs
            and n_free < len(self._schedule)
            and self._schedule.may_start(*self._burden())
        ):
            try:
                self._start(cores)
            except ResourceError as error:
                if not self._staff():
                    raise
                _log.info("%s; going on with %d workers", error, len(self._staff()))
                break
            n_free += 1
        return began

    def _staffed_alone(self) -> list[Message]:
        """Give a task that must be alone to a fresh worker that has all cores."""
        unused = [one for one in self._staff() if not one.n_done and one.cores >= self._cores]
        alone = unused[0] if unused else self._start(self._cores)
        for worker in self._staff():
            if worker is not alone:
                worker.dismiss()
        return self._given(alone, self._schedule.taken_alone()) if alone.is_ready else []

    def _burden(self, but: WorkerProcess | None = None) -> tuple[list[int], int]:
        """The tasks in hand, and the memory that idle workers hold, one of them left out."""
        staff = [worker for worker in self._staff() if worker is not but]
        in_hand = [worker.in_hand for worker in staff if worker.in_hand is not None]
        return in_hand, sum(worker.held_bytes for worker in staff if worker.in_hand is None)

    def _given(self, worker: WorkerProcess, index: int) -> list[Message]:
        worker.kills_before = oom_kills()
        if not worker.send((index, self._tasks[index])):
            # It died idle; the task never reached it, and the news of its end is on the way.
            self._schedule.put_back(index)
            worker.is_dismissed = True
            return []
        worker.in_hand = index
        if self._limits.timeout_s is not None:
            worker.deadline = time.monotonic() + self._limits.timeout_s
        return [Began(index)]

    # Listening

    def _all_heard(self) -> list[tuple[WorkerProcess | None, tuple[Any, ...]]]:
        heard = []
        with contextlib.suppress(queue.Empty):
            heard.append(self._heard.get(timeout=self._patience_s()))
            while True:
                heard.append(self._heard.get_nowait())
        return heard

    def _patience_s(self) -> float | None:
        """How long to wait for a word; None is for ever."""
        first = min((worker.deadline for worker in self._workers), default=math.inf)
        if self._limits.memory_bytes is not None and self._is_busy():
            first = min(first, time.monotonic() + _BETWEEN_LOOKS_S)
        if os.name == "nt":
            # Windows delivers Ctrl-C to a waiting thread only between two waits.
            first = min(first, time.monotonic() + 0.2)
        return None if first == math.inf else max(0.0, first - time.monotonic())

    def _looked_after(self) -> list[Message]:
        """Kill whoever is overdue, and see who comes near the memory limit."""
        lost: list[Message] = []
        now = time.monotonic()
        for worker in self._workers:
            if self._limits.memory_bytes is not None and worker.in_hand is not None:
                worker.is_near_limit = worker.is_near_limit or is_near_memory_limit(worker.pid)
            if now < worker.deadline:
                continue
            if not worker.is_overdue:
                worker.is_overdue = True
                worker.deadline = now + _ENDS_WITHIN_S
                worker.dismiss()
            elif worker.in_hand is not None:
                # Nobody knows what it will yet do, so the task is not begun a second time.
                lost.append(Lost(worker.in_hand, "timeout", self._overdue_text(), _STUCK))
                worker.in_hand, worker.deadline = None, math.inf
        return lost

    def _understood(self, worker: WorkerProcess, message: tuple[Any, ...]) -> list[Message]:
        kind, *rest = message
        if kind == "ready":
            worker.is_ready = True
            worker.pid = rest[0]
            worker.deadline = math.inf
            self._false_starts = 0
        elif kind == "progress":
            return [Advanced(*rest)]
        elif kind == "log":
            name, level, text = rest
            is_repeated = level >= logging.WARNING and (name, text) in self._warnings
            if level >= logging.WARNING:
                self._warnings.add((name, text))
            # What is wrong with the machine, every worker sees.
            logging.getLogger(name).log(logging.DEBUG if is_repeated else level, "%s", text)
        elif kind == "returned":
            index, result, resident = rest
            self._finish(worker, resident)
            return [Returned(index, result, self._earlier.get(index, ""))]
        elif kind == "raised":
            index, reason = rest
            self._finish(worker, 0)
            return [Lost(index, "exception", reason, "this is a defect of msal; please report it")]
        elif kind == "exhausted":
            # What is left of its heap cannot be trusted with another file: it is replaced too.
            worker.dismiss()
            return self._lost(worker, "memory", *self._want_of_memory("not enough memory"))
        elif kind == "unusable":
            raise ResourceError(
                f"the workers cannot work: {rest[0].strip().splitlines()[-1]}",
                hint="msal or a library that it needs is not installed properly",
            )
        elif kind == "gone":
            return self._buried(worker, rest[0])
        return []

    def _finish(self, worker: WorkerProcess, resident: int) -> None:
        worker.in_hand = None
        worker.deadline = math.inf
        worker.n_done += 1
        worker.held_bytes = resident
        worker.first_bytes = worker.first_bytes or resident
        if (
            worker.n_done >= self._files_per_worker
            or resident - worker.first_bytes > self._growth_bytes
        ):
            worker.dismiss()

    # Losses

    def _buried(self, worker: WorkerProcess, code: int) -> list[Message]:
        self._part_with(worker)
        if worker.in_hand is not None:
            for line in worker.last_words:
                _log.info("worker %d, before it ended: %s", worker.pid, line)
            return self._lost(worker, *self._cause_of_death(worker, code))
        if not worker.is_ready and (worker.is_overdue or not worker.is_dismissed):
            self._false_starts += 1
            if self._false_starts >= _FALSE_STARTS:
                words = worker.last_words[-1] if worker.last_words else "it said nothing"
                raise ResourceError(
                    f"the workers end before they start: the last one {ending(code)}; {words}",
                    hint="there may not be enough memory, or too many processes",
                )
        return []

    def _cause_of_death(self, worker: WorkerProcess, code: int) -> tuple[str, str, str]:
        """Cause, reason and hint for the task that a worker took along."""
        if worker.is_overdue:
            return (
                "timeout",
                self._overdue_text(),
                "raise --timeout, or look at the file: it may be very large, or damaged",
            )
        if code == -9 and oom_kills() > worker.kills_before:
            return (
                "memory",
                "the system killed the worker for want of memory",
                "run fewer jobs at once, or on a machine with more memory",
            )
        words = any(map(_WANT_OF_MEMORY.search, worker.last_words))
        if self._limits.memory_bytes is not None and code != -9 and (worker.is_near_limit or words):
            return "memory", *self._want_of_memory(f"the worker {ending(code)} for want of memory")
        hint = "a library broke on this file; it may be damaged"
        if code == -9:
            hint = "the system may have run out of memory: run fewer jobs at once"
        return "crash", f"the worker {ending(code)}", hint

    def _want_of_memory(self, reason: str) -> tuple[str, str]:
        limit = self._limits.memory_bytes
        if limit is None:
            return reason, "run fewer jobs at once, or on a machine with more memory"
        return (
            f"{reason}, with a limit of {limit / 1e6:,.0f} MB",
            "raise --memory-limit if the machine has more",
        )

    def _overdue_text(self) -> str:
        return f"it was not done within {self._limits.timeout_s:g} s"

    def _lost(self, worker: WorkerProcess, cause: str, reason: str, hint: str) -> list[Message]:
        index = worker.in_hand
        assert index is not None
        worker.in_hand = None
        worker.is_dismissed = True
        objection = self._on_loss(index)
        if objection:
            return [Lost(index, "changed", f"{objection}; {reason}", hint)]
        if self._schedule.lose(index):
            self._earlier[index] = reason
            return [Again(index, reason)]
        tries = self._schedule.losses(index)
        if tries > 1:
            reason += ", as at the first try" if tries == 2 else f" ({tries} tries)"
        return [Lost(index, cause, reason, hint)]

    # Starting and ending processes

    def _start(self, cores: int) -> WorkerProcess:
        worker = worker_process.started(self._assignment, cores, self._heard)
        worker.deadline = time.monotonic() + _READY_WITHIN_S
        self._workers.append(worker)
        return worker

    def _last_messages(self) -> list[Message]:
        """End all workers and hear out what they had sent."""
        for known in self._workers:
            known.dismiss()
        messages: list[Message] = []
        deadline = time.monotonic() + _GONE_WITHIN_S
        while self._workers:
            try:
                worker, message = self._heard.get(timeout=max(0.0, deadline - time.monotonic()))
            except queue.Empty:
                break
            if worker is None:
                continue
            if message[0] == "gone":
                self._part_with(worker)
            elif message[0] == "returned":
                messages += self._understood(worker, message)
        return messages

    def _end(self) -> None:
        for worker in self._workers:
            worker.process.kill()
        deadline = time.monotonic() + _GONE_WITHIN_S
        for worker in list(self._workers):
            try:
                worker.process.wait(timeout=max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                # It sits in the kernel, on a dead network disk perhaps; the kill stays pending.
                _log.warning("worker %d does not end", worker.pid)
                continue
            self._part_with(worker)

    def _part_with(self, worker: WorkerProcess) -> None:
        """Let go of a worker that has ended."""
        self._workers.remove(worker)
        worker.let_go()
        if worker.in_hand is not None:
            self._on_death(worker.pid, worker.in_hand)
